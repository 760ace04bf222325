# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The content of a file with columns, and probable mistakes in its units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from pendubot_identification.trajectories.trajectory import Trajectory

from .regularity import regularity
from .table_reader import TableReader

#: A median speed [rad/s] and a torque [N m] above these are in other units.
FAST, STRONG = 30.0, 30.0
#: Negligible angle [rad] and fraction of the torque, and the number of samples at rest.
LITTLE, RESTING = 0.05, 3
UNITS = {'q1': 'rad', 'q2': 'rad', 'dq1': 'rad/s', 'dq2': 'rad/s', 'tau1': 'N m', 'tau2': 'N m'}


def survey(reader: TableReader) -> dict[str, Any]:
    """Return the motion of a file in numbers: times in seconds, rates in Hz, quantities in rad and N m.

    Raises:
        TableError: it cannot be read.
    """
    motion = reader.motion
    times = regularity(np.rint(motion.t * 1e9).astype(np.int64))
    columns = {'q1': motion.q[:, 0], 'q2': motion.q[:, 1], 'tau1': motion.tau[:, 0], 'tau2': motion.tau[:, 1]}
    if motion.qd is not None:
        columns |= {'dq1': motion.qd[:, 0], 'dq2': motion.qd[:, 1]}
    return {
        'file': str(reader.path),
        'columns': reader.taken,
        'not_taken': [name for name in reader.table.names if name not in reader.taken.values()],
        'read_with': reader.conversion.options(),
        'samples': len(motion),
        'left_out': len(reader.table.cells[0]) - len(motion),
        'duration': motion.duration,
        'rate': (len(motion) - 1) / motion.duration if motion.duration else 0.0,
        # JSON has no NaN.
        **{key: None if value != value else value for key, value in asdict(times).items()},
        'quantities': {
            name: {'least': float(x.min()), 'greatest': float(x.max()), 'first': float(x[0]), 'last': float(x[-1])}
            for name, x in columns.items()
            if name in reader.taken
        },
        'guesses': list(guesses(motion)),
    }


def guesses(motion: Trajectory) -> Iterator[str]:
    """Yield probable mistakes, each with the option that corrects it."""
    if len(motion) < 2:
        return
    speed = np.abs(np.diff(motion.q, axis=0)).max(axis=1) / np.diff(motion.t)
    if np.median(speed) > FAST:
        yield 'angles that change so fast look like degrees: --degrees?'
    torque = np.abs(motion.tau[:, 0])
    if torque.max() > STRONG:
        yield 'torques so large look like mN m: --torque-unit mNm?'
    if not torque.any():
        yield 'the torque is zero throughout: is it another column? --columns tau1=NAME'
    rotation = np.ptp(motion.q[:RESTING], axis=0).max()
    if torque[0] <= LITTLE * torque.max() and rotation < LITTLE and abs(motion.q[0, 0]) < LITTLE:
        yield 'at rest without torque link 1 hangs, and q1 is 0 there: --zero hanging?'


def as_text(found: dict[str, Any]) -> str:
    """Return a survey as text."""
    left_out = f', {found["left_out"]} left out' if found['left_out'] else ''
    lines = [f'{found["samples"]} samples{left_out}, {found["duration"]:.3f} s, {found["rate"]:.1f} Hz']
    taken = ', '.join(name if name == column else f'{name} = {column}' for name, column in found['columns'].items())
    lines.append(f'taken     {taken}' + (f'; not {", ".join(found["not_taken"])}' if found['not_taken'] else ''))
    if found['read_with']:
        lines.append(f'read      {" ".join(found["read_with"])}')
    if found['period'] is not None:
        gaps = f'{found["gaps"]} gaps, the first after {found["first_gap"]:.3f} s' if found['gaps'] else 'no gaps'
        lines.append(
            f'jitter    {1e3 * found["jitter"]:.3f} ms; {gaps}; longest interval {1e3 * found["longest"]:.3f} ms'
        )
    lines.append(f'{"":12}{"least":>12}{"greatest":>12}{"first":>12}{"last":>12}')
    for name, values in found['quantities'].items():
        lines.append(f'{f"{name} [{UNITS[name]}]":12}' + ''.join(f'{value:12.4g}' for value in values.values()))
    return '\n'.join([*lines, *(f'looks odd {guess}' for guess in found['guesses'])])
