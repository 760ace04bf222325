# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Samples of a motion in; smoothed states, splines of time, and data checks out. No file is known here."""
