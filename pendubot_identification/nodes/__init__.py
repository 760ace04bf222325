# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The ROS nodes: thin programs around the core, with parameters in, one call, and messages out."""
