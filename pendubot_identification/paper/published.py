# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What the paper prints in its Tables 4 and 7. Its Table 8 is :data:`.model.parameters.PAPER`."""

from __future__ import annotations

from typing import NamedTuple


class Row(NamedTuple):
    """A cell of Table 4: errors over 10 runs, and the time of one [s]."""

    best: float
    worst: float
    average: float
    deviation: float
    time: float


TABLE_4 = {
    ('Sphere', 'PSO'): Row(2.30e-5, 0.0028, 8.06e-4, 8.35e-4, 0.1910),
    ('Sphere', 'DE'): Row(3.09e-6, 9.60e-6, 6.59e-6, 2.46e-6, 0.0763),
    ('Sphere', 'HDE'): Row(2.21e-8, 7.58e-6, 2.85e-6, 2.44e-6, 0.2091),
    ('Sphere', 'MDE'): Row(4.38e-7, 5.56e-6, 3.03e-6, 1.82e-6, 0.0837),
    ('Griewank', 'PSO'): Row(0.0081, 0.0811, 0.0461, 0.0260, 0.1961),
    ('Griewank', 'DE'): Row(2.41e-6, 0.0020, 5.48e-4, 6.44e-4, 0.1453),
    ('Griewank', 'HDE'): Row(7.76e-6, 2.91e-4, 7.19e-5, 1.06e-4, 0.5689),
    ('Griewank', 'MDE'): Row(1.55e-7, 7.48e-6, 2.56e-6, 2.83e-6, 0.3522),
    ('Ackley', 'PSO'): Row(0.0026, 0.1291, 0.0273, 0.0379, 0.2263),
    ('Ackley', 'DE'): Row(3.54e-5, 0.0012, 5.49e-4, 5.00e-4, 0.1791),
    ('Ackley', 'HDE'): Row(5.12e-7, 4.68e-4, 1.31e-4, 1.32e-4, 0.5263),
    ('Ackley', 'MDE'): Row(2.15e-6, 9.97e-6, 6.58e-6, 2.93e-6, 0.1797),
    ('Rastrigin', 'PSO'): Row(1.41e-5, 0.9950, 0.1159, 0.3116, 0.1455),
    ('Rastrigin', 'DE'): Row(8.64e-6, 0.5830, 0.0609, 0.1835, 0.1020),
    ('Rastrigin', 'HDE'): Row(1.50e-6, 2.89e-4, 4.99e-5, 8.79e-5, 0.2884),
    ('Rastrigin', 'MDE'): Row(2.22e-6, 8.88e-6, 4.87e-6, 2.28e-6, 0.1182),
}
#: J over 10 runs: training best, worst, average; validation average.
TRAINING = (2.37e-3, 2.39e-3, 2.37e-3)
VALIDATION_AVERAGE = 3.03e-3
