# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The model of the pendubot: parameters, dynamics, simulation with sensitivities, and Kalman filters.

The compiled kernel runs the long loops; without a compiler, numpy does.
"""

#: Number of parameters of each model, from the first on.
MODELS = {'viscous': 7, 'coulomb': 9, 'rotor': 10, 'geared': 14}
