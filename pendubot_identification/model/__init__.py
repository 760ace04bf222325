# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The pendubot as equations: parameters and a state in; accelerations, energy, simulated motion, sensitivities out.

The compiled kernel beside it does the long loops; without a compiler numpy does the same work.
"""
