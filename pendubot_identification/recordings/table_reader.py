# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a motion from a file with columns."""

from __future__ import annotations

import hashlib
import math
import re
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
#: Usual names and endings of a column that holds a motor current, which is no torque.
CURRENT = re.compile(r'i|i_?[1mq]|amps?|amperes?|.*(current|strom|courant|corriente)\d?|.*[\[(]m?a[\])]', re.IGNORECASE)


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
            constant = '' if likely.get('tau1') or not self._current else ' --torque-constant K'
            if constant and 'tau1' in likely:
                likely['tau1'] = self._current
            named = {**self.conversion.columns, **{name: column or 'NAME' for name, column in likely.items()}}
            columns = ','.join(f'{name}={column}' for name, column in named.items())
            known = all(likely.values())
            raise TableError(
                f'{self.path} has no column {self.conversion.names[missing[0]]!r} for {missing[0]}; its columns are '
                f'{", ".join(table.names)}: name the right one with --columns {columns}{constant}',
                **({'columns': columns} if known and not constant else {}),
            )
        if CURRENT.fullmatch(taken['tau1'].strip()) and not self.conversion.torque_constant:
            raise TableError(
                f'{self.path}: the column {taken["tau1"]!r} seems to hold a motor current, and a torque is expected: '
                "give the motor's constant with --torque-constant K [N m per unit of that column], or "
                '--torque-constant 1 if it is a torque'
            )
        return taken

    @property
    def _current(self) -> str | None:
        """The only column whose name is that of a motor current, if there is one."""
        found = [c for c in self.table.names if CURRENT.fullmatch(c.strip())]
        return found[0] if len(found) == 1 else None

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
