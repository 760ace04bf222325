# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The ``pendubot`` command line: identification without ROS."""
