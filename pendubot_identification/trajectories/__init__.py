# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Trajectories: smoothed states, splines of time, unit conversion, and data checks. Nothing here reads a file."""
