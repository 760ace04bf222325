"""How far the energy criterion's exact minimum lies from the truth: ``python -m test.benchmark.criterion``.

On the virtual rig with no model error at all: 900 samples of the paper's experiment for each of 20 seeds. Prints, for
each parameter, the median over the seeds of the error's size in per cent, and that of the worst parameter.
"""

import numpy as np

from pendubot_identification.core.energy import energy_regression
from pendubot_identification.core.excitation import PulseTrain
from pendubot_identification.core.parameters import NAMES, PAPER, default_bounds
from pendubot_identification.core.quadratic import Quadratic
from pendubot_identification.core.simulation import quantised, simulate

SEEDS = range(20)
#: rate [Hz], counts per turn (0: exact), smoothing [s], sliding window [s]
VARIANTS = (
    (100, 4000, 0.02, None),
    (100, 0, 0.02, None),
    (100, 4000, 0.05, None),
    (100, 4000, 0.02, 0.1),
    (100, 4000, 0.02, 0.5),
    (100, 4000, 0.05, 0.5),
    (1000, 4000, 0.0, None),
    (1000, 4000, 0.02, None),
    (1000, 0, 0.02, None),
    (1000, 4000, 0.02, 0.5),
)


def recording(rate, seed):
    t = np.arange(9 * rate) / rate
    pulses = PulseTrain(seed=seed)
    return simulate(PAPER, t, np.column_stack([[pulses.torque(x) for x in t], np.zeros(len(t))]))


def main():
    """Print the table."""
    motions = {rate: [recording(rate, seed) for seed in SEEDS] for rate in {v[0] for v in VARIANTS}}
    print('| rate | counts per turn | differentiator | energy over | ' + ' | '.join(NAMES) + ' | worst |')
    print('|' + '---|' * (len(NAMES) + 5))
    for rate, counts, smoothing, sliding in VARIANTS:
        errors = []
        for motion in motions[rate]:
            regression = energy_regression(quantised(motion, counts) if counts else motion, sliding, smoothing)
            theta = Quadratic.reduce(regression.phi, regression.y).minimum(default_bounds())
            errors.append(abs(theta / PAPER.vector() - 1) * 100)
        central = smoothing * rate < 4
        cells = [
            f'{rate} Hz',
            f'{counts or "exact"}',
            'central differences' if central else f'{smoothing:g} s',
            'all' if sliding is None else f'{sliding:g} s',
            *(f'{value:.1f}' for value in np.median(errors, axis=0)),
            f'{np.median(np.max(errors, axis=1)):.0f}',
        ]
        print('| ' + ' | '.join(cells) + ' |')


if __name__ == '__main__':
    main()
