# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A guided identification in the browser, on this computer alone.

The server stores files and starts programs: a worker for each task, which uses the Python interface, and the watcher of
the running rig. A task is one request; its answer is a stream of JSON lines, and the program ends with the request.
"""
