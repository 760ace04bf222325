# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Tracking of a moving rig: its current parameters, their uncertainty, and their changes."""
