# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings as files: reads trajectories from bags and tables; writes and repairs bags."""
