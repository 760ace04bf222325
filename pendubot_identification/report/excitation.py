# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The predicted motion and accuracy of an excitation, as text for a terminal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.excitation.design import Experiment, Predicted
from pendubot_identification.model.parameters import NAMES, UNITS, Parameters

from .table import Table, number


def motion_lines(found: Predicted, experiment: Experiment) -> list[str]:
    """Return, in words, the pulses and the motion that they are predicted to make."""
    train = found.train
    speed, turns = found.speed, found.angle / (2 * np.pi)
    return [
        f'pulses: every {train.period:g} s, {100 * train.width:g} % of it, from {train.amplitude_min:g} to '
        f'{train.amplitude_max:g} N m, a new torque every {train.hold:g} s, seed {train.seed}',
        f'simulated, {experiment.duration:g} s from hanging: shoulder up to {speed[0]:.1f} rad/s and {turns[0]:.2f} '
        f'turns away, elbow up to {speed[1]:.1f} rad/s and {turns[1]:.2f} turns away',
    ]


def excitation_table(
    parameters: Parameters, std_error: NDArray[np.float64] | None, paper: Predicted, found: Predicted
) -> Table:
    """Return a row a parameter: its standard error now, after the paper's pulses, and after those found.

    In % of its value or, where that is 0, in its unit. Parameters that are 0 and not identifiable are left out.
    ``std_error`` is that of the present estimate, shape (D,); None where it is not known.
    """
    theta = parameters.vector()
    nothing = theta == 0
    scale = np.where(nothing, 1.0, np.abs(theta) / 100)
    columns = {"paper's pulses": paper.std_error / scale, 'these': found.std_error / scale}
    if std_error is not None:
        columns = {'now': std_error / scale, **columns}
    rows = []
    for k, name in enumerate(NAMES[: len(theta)]):
        if nothing[k] and not np.isfinite(found.std_error[k]):
            continue
        unit = '' if not nothing[k] else ' N m/N m' if UNITS[k] == '1' else f' {UNITS[k]}'
        ratio = _shown(paper.std_error[k] / (found.std_error[k] or np.nan), '.1f')
        rows.append([name, *(f'{_shown(errors[k], ".2g")}{unit}' for errors in columns.values()), ratio])
    worst = [float(np.max(errors[np.isfinite(errors) & ~nothing], initial=0.0)) for errors in columns.values()]
    ratio = _shown(worst[-2] / (worst[-1] or np.nan), '.1f')
    rows.append(['the worst', *(_shown(value, '.2g') for value in worst), ratio])
    notes = [
        'from this motion alone, followed for 2 s at a time, as far as the rounding of the encoders sets them:',
        'where the model itself errs they are larger, and the ratio is what counts',
    ]
    return Table(['standard error, %', *columns, 'ratio'], rows, notes)


def _shown(value: float, format: str) -> str:
    return number(value if np.isfinite(value) else None, format)
