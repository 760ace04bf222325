"""What an excitation would do and tell, as text for a terminal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.core.design import Experiment, Foreseen
from pendubot_identification.core.parameters import NAMES, Parameters

from .tables import table


def motion_lines(found: Foreseen, experiment: Experiment) -> list[str]:
    """Return, in words, the pulses and the motion that they are foreseen to make."""
    train = found.train
    speed, turns = found.speed, found.angle / (2 * np.pi)
    return [
        f'pulses: every {train.period:g} s, {100 * train.width:g} % of it, from {train.amplitude_min:g} to '
        f'{train.amplitude_max:g} N m, a new torque every {train.hold:g} s, seed {train.seed}',
        f'simulated, {experiment.duration:g} s from hanging: shoulder up to {speed[0]:.1f} rad/s and {turns[0]:.2f} '
        f'turns away, elbow up to {speed[1]:.1f} rad/s and {turns[1]:.2f} turns away',
    ]


def excitation_table(
    parameters: Parameters, std_error: NDArray[np.float64] | None, paper: Foreseen, found: Foreseen
) -> str:
    """Return a row a parameter: its standard error in % now, after the paper's pulses, and after those found.

    Args:
        parameters: of the rig.
        std_error: of the present estimate, shape (D,); None where it is not known.
        paper: what the paper's pulses tell.
        found: what the others tell.
    """
    theta = parameters.vector()
    head = ['standard error, %', *(['now'] if std_error is not None else []), "paper's pulses", 'these', 'ratio']
    rows = []
    for k, value in enumerate(theta):
        unit = abs(value) / 100 or 1.0
        now = [] if std_error is None else [f'{std_error[k] / unit:.2g}']
        errors = paper.std_error[k], found.std_error[k]
        rows.append([NAMES[k], *now, *(f'{error / unit:.2g}' for error in errors), f'{errors[0] / errors[1]:.1f}'])
    relative = [np.max(each.std_error / np.maximum(np.abs(theta), 1e-300)) for each in (paper, found)]
    worst = [f'{100 * each:.2g}' for each in relative]
    rows.append(['the worst', *([''] if std_error is not None else []), *worst, f'{relative[0] / relative[1]:.1f}'])
    return '\n'.join(
        [
            table(head, rows),
            'from this motion alone, as far as the rounding of the encoders sets them; where the model itself errs',
            'they are larger, and the ratio is what counts',
        ]
    )
