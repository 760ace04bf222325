# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Excitation of a rig within its limits: the pulse train of the paper, and optimal designs."""
