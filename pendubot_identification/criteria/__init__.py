# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The criteria energy, weak and likelihood, the open-loop prediction error, and their minima."""
