# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Samples of a rig that moves in; what its parameters are now, how sure, and what changed out."""
