# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What was recorded, as files: bags and CSV files in and out as trajectories; bags written, read and repaired."""
