# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A rig's limits in; the torques that make it move, the paper's pulses or designed ones, out."""
