# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters and samples in; the torque that swings the rig up and balances it out. Nothing but its node imports it."""
