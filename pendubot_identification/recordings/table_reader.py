# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a motion from a file with columns."""

from __future__ import annotations

import hashlib
import math
from functools import cached_property
from pathlib import Path

import numpy as np

from pendubot_identification.errors import TableError
from pendubot_identification.trajectories.conventions import OPTIONAL, REQUIRED, TIME_UNITS
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.trajectory import Trajectory

from .tables import Table, read_table

#: Longest interval of samples [s], above which the unit of time is wrong, and the usual interval [s].
LONGEST_INTERVAL, USUAL_INTERVAL = 0.1, 0.005
#: Usual names of columns, in lower case.
ALIASES = {
    't': ('t', 'time', 'times', 'timestamp', 'stamp', 'sec', 'seconds', 'time_s', 't_s', 'zeit', 'tout'),
    'q1': ('q1', 'q_1', 'theta1', 'theta_1', 'th1', 'phi1', 'alpha', 'shoulder', 'shoulder_angle', 'angle1', 'pos1'),
    'q2': ('q2', 'q_2', 'theta2', 'theta_2', 'th2', 'phi2', 'beta', 'elbow', 'elbow_angle', 'angle2', 'pos2'),
    'tau1': ('tau1', 'tau_1', 'tau', 'torque', 'torque1', 'u', 'u1', 'effort', 'effort1', 'shoulder_torque'),
}


class TableReader:
    """A file with columns, with the attributes of :class:`.bag_reader.BagReader` that a result needs."""

    closed, note = True, ''

    def __init__(self, path: Path, conversion: Conversion) -> None:
        self.path, self.conversion = path, conversion

    @cached_property
    def content_hash(self) -> str:
        """The SHA-256 of the file in hexadecimal."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()

    @cached_property
    def table(self) -> Table:
        """The columns of the file."""
        return read_table(self.path)

    @cached_property
    def taken(self) -> dict[str, str]:
        """The columns to use, by quantity.

        Raises:
            TableError: a required or named column is missing.
        """
        table = self.table
        taken = {name: column for name, column in self.conversion.names.items() if table.has(column)}
        missing = [name for name in (*REQUIRED, *self.conversion.columns) if name not in taken]
        if missing:
            likely = {name: self._alias(name) for name in missing}
            named = {**self.conversion.columns, **{name: column or 'NAME' for name, column in likely.items()}}
            columns = ','.join(f'{name}={column}' for name, column in named.items())
            known = all(likely.values())
            raise TableError(
                f'{self.path} has no column {self.conversion.names[missing[0]]!r} for {missing[0]}; its columns are '
                f'{", ".join(table.names)}: name the right one with --columns {columns}',
                **({'columns': columns} if known else {}),
            )
        return taken

    def _alias(self, name: str) -> str | None:
        """Return the only column with a usual name of a quantity, if there is one."""
        found = [
            c
            for c in self.table.names
            if c.lower() in ALIASES.get(name, ()) and c not in self.conversion.names.values()
        ]
        return found[0] if len(found) == 1 else None

    @cached_property
    def motion(self) -> Trajectory:
        """The complete motion, t from the first sample.

        Raises:
            TableError: the file cannot be read, a column is missing, a value is no number, stamps do not increase.
        """
        table, conversion = self.table, self.conversion
        comma, skip = conversion.decimal == 'comma', conversion.skip_missing
        values = {n: table.numbers(column, comma=comma, skip=skip) for n, column in self.taken.items()}
        complete = np.isfinite(np.column_stack(list(values.values()))).all(axis=1)
        if not complete.any():
            raise TableError(f'{self.path} holds no row of numbers; export the recording again')
        values = {name: numbers[complete] for name, numbers in values.items()}
        t = values['t'] * conversion.seconds
        wrong = np.flatnonzero(np.diff(t) <= 0)
        if wrong.size:
            before, time = values['t'][wrong[0] : wrong[0] + 2]
            raise TableError(
                f'{table.where(int(np.flatnonzero(complete)[wrong[0] + 1]))}: the time {time:.12g} '
                f'{"repeats" if time == before else "runs back"}, after {before:.12g}; every row needs a later one: '
                'export more digits, or correct or remove that row'
            )
        zeros = np.zeros_like(t)
        q, tau = (np.column_stack([values[a], values.get(b, zeros)]) for a, b in (('q1', 'q2'), ('tau1', 'tau2')))
        qd = np.column_stack([values[name] for name in OPTIONAL[1:]]) if {'dq1', 'dq2'} <= values.keys() else None
        motion = conversion.motion(t - t[0], q, tau, qd, str(self.path))
        if len(t) > 1 and motion.interval > LONGEST_INTERVAL * (1 + 1e-6):
            apart = f'{self.path}: its rows are {motion.interval:g} s apart, which no recording of a pendubot is'
            units = {unit: motion.interval / conversion.seconds * size for unit, size in TIME_UNITS.items()}
            unit = min(units, key=lambda each: abs(math.log(units[each] / USUAL_INTERVAL)))
            if unit == conversion.time_unit:
                raise TableError(f'{apart}; record at a higher rate')
            raise TableError(f'{apart}; its times may be in {unit}: add --time-unit {unit}', time_unit=unit)
        return motion
