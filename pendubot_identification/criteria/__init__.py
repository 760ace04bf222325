# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A trajectory and a model in; what is minimised (energy, weak, likelihood) and its minimum out."""
