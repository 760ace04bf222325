# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Conversion of a recording to a motion: units, order, signs and zeros, and their correction."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ParameterError, TrajectoryError
from pendubot_identification.setting import flag

from .conventions import CONVERSION, JOINT_NAMES, OPTIONAL, REQUIRED, TIME_UNITS, TOPIC, TORQUE_UNITS, current_name
from .trajectory import LARGEST, Trajectory

#: Quantities that can be negated or have an offset.
QUANTITIES = ('q1', 'q2', 'tau1', 'tau2')
#: A wrapped angle jumps by more than (1 - WRAPPED) turns.
WRAPPED = 0.15
_EXCHANGED = np.eye(2)[::-1]
#: Map from two angles with the same zero to q1 and the relative angle q2.
_ABSOLUTE = np.array([[1.0, 0.0], [-1.0, 1.0]])


class Affine(NamedTuple):
    """An affine map: positions become Q q + c, velocities Q qd, and efforts T tau + d."""

    Q: Array  #: shape (2, 2).
    c: Array  #: [rad], shape (2,).
    T: Array  #: shape (2, 2).
    d: Array  #: [N m], shape (2,).

    @classmethod
    def of(cls, Q: Any = None, c: Any = (0, 0), T: Any = None, d: Any = (0, 0)) -> Affine:
        """Return the map with these coefficients; the default is the identity."""
        Q, T = (np.eye(2) if M is None else M for M in (Q, T))
        return cls(*(np.array(values, dtype=float) for values in (Q, c, T, d)))

    def after(self, first: Affine) -> Affine:
        """Return the map that applies ``first`` and then this one."""
        return Affine(self.Q @ first.Q, self.Q @ first.c + self.c, self.T @ first.T, self.T @ first.d + self.d)


@dataclass(frozen=True)
class Conversion:
    """The settings of :data:`.conventions.CONVERSION`. Raises ParameterError: a value is invalid."""

    topic: str = TOPIC.default
    joints: tuple[str, ...] = JOINT_NAMES
    columns: Mapping[str, str] = field(default_factory=dict)
    skip_rows: int = 0
    sheet: str = ''
    encoding: str = ''
    decimal: str = 'point'
    time_unit: str = 's'
    skip_missing: bool = False
    unwrap: bool = False
    degrees: bool = False
    torque_unit: str = 'Nm'
    swap: str = 'nothing'
    torque_constant: float = 0.0  #: [torque_unit/A]; 0: efforts are torques, not currents.
    gear: float = 1.0
    negate: tuple[str, ...] = ()
    elbow: str = 'relative'
    zero: str = 'horizontal'
    offset: Mapping[str, float] = field(default_factory=dict)  #: [rad] and [N m].

    def __post_init__(self) -> None:
        for setting in CONVERSION:
            setting.check(getattr(self, setting.name))
        for option, names, known in (
            ('columns', self.columns, REQUIRED + OPTIONAL),
            ('negate', self.negate, QUANTITIES),
            ('offset', self.offset, QUANTITIES),
        ):
            if unknown := [name for name in names if name not in known]:
                raise ParameterError(f'--{option}: there is no quantity {unknown[0]!r}; use {", ".join(known)}')
        if len(self.joints) != 2 or len(set(self.joints)) != 2:
            raise ParameterError(
                f'--joints {",".join(self.joints)} names {len(set(self.joints))} joints; two are expected, such as '
                f'{",".join(JOINT_NAMES)}'
            )
        if self.gear != 1 and not self.torque_constant:
            raise ParameterError(
                f'--gear {self.gear:g} multiplies a torque constant, and none is given; add --torque-constant K'
            )
        for name, column in self.columns.items():
            if other := next((other for other, its in self.names.items() if other != name and its == column), None):
                raise ParameterError(
                    f'column {column!r} stands for both {name} and {other}; name one column for each: {other}=NAME'
                )

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Conversion:
        """Return the conversion for some options, given as texts or YAML values; all others have their defaults.

        Raises:
            ParameterError: a name is unknown or a value is invalid.
        """
        known = {option.name: option for option in CONVERSION}
        if unknown := given.keys() - known.keys():
            raise ParameterError(f'{min(unknown)!r} is no option of the conversion; use one of {", ".join(known)}')
        return cls(**{name: known[name].parse(value) for name, value in given.items()})

    def words(self) -> dict[str, str]:
        """Return the options that differ from their defaults, as texts for :meth:`of`."""
        texts = {}
        for option in fields(self):
            value = getattr(self, option.name)
            if not value or value == option.default:
                continue
            if option.name == 'offset':
                angles = {name: math.degrees(amount) for name, amount in value.items() if name.startswith('q')}
                value = {name: f'{angles[name]:.9g}deg' if name in angles else f'{x:.9g}' for name, x in value.items()}
            if isinstance(value, Mapping):
                value = tuple(f'{name}={text}' for name, text in value.items())
            if isinstance(value, tuple):
                value = ','.join(value)
            texts[option.name] = 'true' if value is True else str(value)
        return texts

    def options(self) -> list[str]:
        """Return the options that differ from their defaults, as options of the command line."""
        return options(self.words())

    @property
    def names(self) -> dict[str, str]:
        """The column name of each quantity."""
        return {name: self.columns.get(name, name) for name in REQUIRED + OPTIONAL}

    @property
    def seconds(self) -> float:
        """The unit of the times in a file [s]."""
        return TIME_UNITS[self.time_unit]

    @property
    def effort_names(self) -> list[str]:
        """The names of the two entries of a JointState whose efforts become tau1 and tau2, before any swap."""
        names = list(self.joints)
        if self.torque_constant:
            names[self.swap in ('joints', 'efforts')] = current_name(self.joints[0])
        return names

    @property
    def affine(self) -> Affine:
        """The map of positions, velocities and efforts."""
        signs = [-1.0 if name in self.negate else 1.0 for name in QUANTITIES]
        Q, T = np.diag(signs[:2]), np.diag(signs[2:])
        if self.swap in ('joints', 'positions'):
            Q = Q @ _EXCHANGED
        if self.swap in ('joints', 'efforts'):
            T = T @ _EXCHANGED
        if self.torque_constant:
            T = np.diag([self.torque_constant * self.gear, 1.0]) @ T
        if self.elbow == 'absolute':
            # Both angles have the same zero, so it must not be shifted first.
            Q = _ABSOLUTE @ Q
        if self.degrees:
            Q = Q * (math.pi / 180)
        off = np.array([self.offset.get(name, 0.0) for name in QUANTITIES])
        c = np.array([-math.pi / 2 if self.zero == 'hanging' else 0.0, 0.0])
        return Affine(Q, c - off[:2], T * TORQUE_UNITS[self.torque_unit], -off[2:])

    def motion(self, t: Array, q: Array, tau: Array, qd: Array | None, name: str) -> Trajectory:
        """Return the motion of samples, t in seconds. May raise TrajectoryError."""
        if self.skip_missing:
            values = np.column_stack([t, q, tau] if qd is None else [t, q, tau, qd])
            complete = (np.abs(values) < LARGEST).all(axis=1)
            t, q, tau, qd = t[complete], q[complete], tau[complete], None if qd is None else qd[complete]
        if self.unwrap:
            q = self.unwrapped(q, q[:0])
        elif len(t):
            self._refuse_wrapped(t, q, name)
        Q, c, T, d = self.affine
        if self.words():
            # Without options, avoid a copy: the recording may last an hour.
            q, tau, qd = q @ Q.T + c, tau @ T.T + d, None if qd is None else qd @ Q.T
        return Trajectory(t, q, tau, qd, name)

    def unwrapped(self, q: Array, before: Array) -> Array:
        """Return recorded angles without jumps by a turn, as they follow the row or no row of ``before``.

        Rows that are not finite stay as they are.
        """
        q, finite = q.copy(), np.isfinite(q).all(axis=1)
        q[finite] = np.unwrap(np.concatenate([before, q[finite]]), period=self._turn, axis=0)[len(before) :]
        return q

    @property
    def _turn(self) -> float:
        """One turn, in the unit of the recorded angles."""
        return 360.0 if self.degrees else 2 * math.pi

    def _refuse_wrapped(self, t: Array, q: Array, name: str) -> None:
        """Raise TrajectoryError if an angle stays within one turn, in its unit or in degrees, and jumps by a turn."""
        span = np.ptp(q, axis=0)
        for period in dict.fromkeys((self._turn, 360.0)):
            suspect = (span > (1 - WRAPPED) * period) & (span <= period * (1 + 1e-6))
            if not suspect.any():
                continue  # the steps of an hour take as much memory as its angles
            jumps = np.argwhere((np.abs(np.diff(q, axis=0)) > (1 - WRAPPED) * period) & suspect)
            if jumps.size:
                k, joint = jumps[0]
                remedy = {'unwrap': 'true'} | ({'degrees': 'true'} if period != self._turn else {})
                raise TrajectoryError(
                    f'{name}: q{joint + 1} jumps by {q[k + 1, joint] - q[k, joint]:.4g} at {t[k + 1]:.3f} s, as an '
                    f'angle that was wrapped into one turn: add {" ".join(options(remedy))}',
                    **remedy,
                )

    def then(self, change: Affine) -> Conversion | None:
        """Return the conversion that also applies a change to the motion; None if no options can express it.

        Of several conversions, the one with the fewest changed options is returned.
        """
        target, before = change.after(self.affine), set(self.options())
        # Without units and torque constant, entries are -1, 0 and 1; an absolute elbow has a third entry other than 0.
        degrees = bool(np.abs(target.Q).max() < 0.5)
        Q = target.Q * (180 / math.pi) if degrees else target.Q
        T = target.T / [[self.torque_constant * self.gear or 1.0], [1.0]]
        absolute = int((np.abs(Q) > 0.5).sum()) == 3
        Q = np.linalg.inv(_ABSOLUTE) @ Q if absolute else Q
        exchanged = [bool(abs(M[0, 1]) > abs(M[0, 0])) for M in (Q, T)]
        same = replace(
            self,
            swap=('nothing', 'efforts', 'positions', 'joints')[2 * exchanged[0] + exchanged[1]],
            elbow='absolute' if absolute else 'relative',
            degrees=degrees,
            torque_unit=min(TORQUE_UNITS, key=lambda unit: abs(TORQUE_UNITS[unit] - np.abs(T).max())),
            negate=tuple(n for n, sign in zip(QUANTITIES, [*Q.sum(axis=1), *T.sum(axis=1)], strict=True) if sign < 0),
            offset={},
        )
        candidates = []
        for zero in ('horizontal', 'hanging'):
            other = replace(same, zero=zero)
            Q, c, T, d = other.affine
            if not (np.allclose(Q, target.Q, atol=1e-9) and np.allclose(T, target.T, atol=1e-9)):
                return None
            turns = np.remainder(c - target.c + math.pi, 2 * math.pi) - math.pi
            offset = dict(zip(QUANTITIES, [*turns, *(d - target.d)], strict=True))
            candidates.append(replace(other, offset={name: float(x) for name, x in offset.items() if abs(x) > 1e-9}))
        return min(candidates, key=lambda c: len(c.offset) + len(before.symmetric_difference(c.options())))


def options(words: Mapping[str, str]) -> list[str]:
    """Return the result of :meth:`Conversion.words` as options of the command line, quoted for a shell."""
    return [flag(name) + ('' if value == 'true' else f' {shlex.quote(value)}') for name, value in words.items()]
