# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Detection and classification of steps of the unknowns, by the innovations of consecutive blocks.

The generalised likelihood ratio (Willsky and Jones, IEEE Transactions on Automatic Control 21, 1976) compares no change
with any constant step of the unknowns from the first block on. Without a change it is a chi-square variable. A change
of parameters explains all blocks by one step; a push by hand does not, as its torque is no function of the motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from pendubot_identification.arrays import Array

from .filter import Innovations

#: Unknowns beside theta, in this order: the delay of the effort [s]; P4 and P5 along the horizontal, not 0 if the
#: base is tilted; the dead zone of the motor [N m]; the rate of all torque [1/s].
DELAY, TILT, DEAD_ZONE, RATE = 'delay', ('P4 horizontal', 'P5 horizontal'), 'dead zone', 'rate'
PAYLOAD, SEVERAL, DRIFT = 'payload on link 2', 'several', 'motor: gradual change of all torque'
#: Smallest ratio of P1 to P5 after and before a step: without torque, zero parameters fit any motion, and time at twice
#: the rate gives 0.25.
SMALLEST = 0.24
#: Largest fraction of the likelihood ratio that a step leaves unexplained.
UNEXPLAINED = 0.05


class ChangeType(NamedTuple):
    """A type of change: its name, and the directions of its steps, of about the size of the scale, shape (D, F)."""

    name: str
    directions: Array


class StepChange(NamedTuple):
    """A step of the unknowns, shape (D,), its type, its standard errors, and its likelihood ratio."""

    kind: ChangeType
    step: Array
    std_error: Array
    ratio: float

    @classmethod
    def of(cls, kind: ChangeType, innovations: Innovations) -> StepChange:
        """Return the most likely step of a type."""
        phi = innovations.regressor @ kind.directions
        inverse = np.linalg.pinv(phi, rcond=1e-9)
        size, to_step = inverse @ innovations.innovation, kind.directions @ inverse
        ratio = innovations.ratio - float(np.square(innovations.innovation - phi @ size).sum())
        return cls(kind, kind.directions @ size, np.sqrt((to_step**2).sum(axis=1)), ratio)

    def possible(self, x: Array, scale: Array) -> bool:
        """Return whether this step from the unknowns x, shape (D,), is physically possible."""
        highest = x + self.step + 3 * self.std_error
        if (highest < SMALLEST * x)[:5].any() or (highest < -scale / 10)[5:-5].any():
            return False
        # A payload adds both mass and inertia about the elbow, or removes both.
        significant = np.abs(self.step) > 3 * self.std_error
        return not (self.kind.name == PAYLOAD and significant[1] and significant[3] and self.step[1] * self.step[3] < 0)

    def significant(self, names: Sequence[str]) -> dict[str, tuple[float, float]]:
        """Return step and standard error of each unknown that changed by more than three standard errors."""
        steps = zip(names, self.step.tolist(), self.std_error.tolist(), strict=True)
        return {name: (step, error) for name, step, error in steps if abs(step) > 3 * error}


def most_likely_step(innovations: Innovations, names: Sequence[str], x: Array, scale: Array) -> StepChange | None:
    """Return the possible step of the unknowns x, shape (D,), that the Bayesian information criterion prefers."""
    penalty = max(1.0, innovations.residual) * math.log(innovations.rows)
    unexplained = max(penalty * len(x), UNEXPLAINED * innovations.ratio)
    steps = (StepChange.of(kind, innovations) for kind in change_types(names, x, scale))
    return max(
        (step for step in steps if innovations.ratio - step.ratio <= unexplained and step.possible(x, scale)),
        key=lambda step: step.ratio - penalty * step.kind.directions.shape[1],
        default=None,
    )


def change_types(names: Sequence[str], x: Array, scale: Array) -> Iterator[ChangeType]:
    """Return the types of changes of the unknowns x, shape (D,), whose last one is the rate.

    A payload m at a distance d from the elbow adds m l1^2, m d^2, m l1 d, m l1 and m d to P1 to P5, where l1 is
    P3 / P5.
    """

    def axes(name: str, *changing: str) -> ChangeType:
        return ChangeType(name, np.diag(scale)[:, np.isin(names, changing)])

    def proportional(*groups: Sequence[str]) -> Array:
        return np.column_stack([np.where(np.isin(names, group), x, 0.0) for group in groups])

    yield ChangeType('motor: all torque', proportional([n for n in names if n not in (DELAY, DEAD_ZONE, RATE)]))
    yield axes('delay of the effort', DELAY)
    yield axes('dead zone of the motor', DEAD_ZONE)
    yield ChangeType('time: all rates', proportional(['P1', 'P2', 'P3', 'J2'], ['b1', 'b2']))
    yield axes('friction of the shoulder', 'b1', 'Fc1', 'Fs1', 'k1')
    yield axes('friction of the elbow', 'b2', 'Fc2', 'Fs2', 'k2')
    yield axes('payload on link 1', 'P1', 'P4')
    length = x[2] / x[4] if x[4] > 0 else 0.0
    payload = np.zeros((len(names), 3))
    payload[:5] = np.array([[length**2, 0, 0, length, 0], [0, 0, length, 0, 1], [0, 1, 0, 0, 0]]).T
    yield ChangeType(PAYLOAD, payload / np.maximum(np.abs(payload / scale[:, None]).max(axis=0), 1e-9))
    yield axes('tilt of the base', 'P4', 'P5', *TILT)
    yield axes(SEVERAL, *names[:-1])
