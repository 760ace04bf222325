# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A guided identification in the browser, on this computer alone.

The server stores files and starts a worker for each task, which uses the Python interface. A task is one request; its
answer is a stream of JSON lines, and the worker ends with the request.
"""
