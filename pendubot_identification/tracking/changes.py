# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Whether parameters jumped: a generalised likelihood ratio over the last blocks, and what the jump is called.

What was believed before a window of blocks foresees their rows. The ratio (Willsky and Jones, IEEE Transactions on
Automatic Control 21, 1976) compares that with any constant step of theta from the window's begin on: without a change
it is the square of D standard normal numbers. A change of parameters explains all blocks of its window by the same
step; a hand does not, for its torque is no function of the motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.model.parameters import NAMES

from .filter import Belief

Array = NDArray[np.float64]

#: A ratio beyond which a window speaks of a change. Were rows normal, far less would do; the noise of real rows has
#: outliers, so the rate of false alarms is the one that docs/tracking.md tells as measured.
CHANGED = 300.0
#: A block whose ratio is above this is not learned from before others have confirmed it. One in some thousands of real
#: ones is, without any cause; where as many in a row as a window holds are, that is no chance either.
DOUBTED = 100.0
#: What the step leaves of the rows under it, in the mean of their squares, where it explains them.
EXPLAINED = 4.0
#: A kind of change that has one more unknown must explain so much more of the ratio.
SIMPLER = 12.0
#: A kind is the cause where it leaves no more than this of the ratio, or no more than this part of it.
LEAVES, PART = 40.0, 0.05
#: Of each of P1 to P5 at least this part stays, but for a little of its scale. Free motion says nothing of their size,
#: so that none at all would explain it.
LEAST, LITTLE = 0.3, 0.1
#: A kind that is no payload where it adds mass and takes inertia away.
PAYLOAD = 'payload on link 2'
#: The last of what is tracked.
DELAY = 'delay'
#: The kind of what has no other name. So many blocks must agree on it: a hand may look like it for a while.
SEVERAL, AGREEING = 'several', 4


class Kind(NamedTuple):
    """A kind of change: its name, and the directions in which theta may step, shape (D, F)."""

    name: str
    directions: Array


class Jump(NamedTuple):
    """A step of theta: its kind, the step, shape (D,), its standard errors, and the ratio that speaks for it."""

    kind: Kind
    step: Array
    std_error: Array
    ratio: float

    @property
    def no_payload(self) -> bool:
        """Whether it is called one, but adds mass and takes inertia about the elbow away, or the other way round."""
        sure = (np.abs(self.step) > 3 * self.std_error) & (self.kind.name == PAYLOAD)
        return bool(sure[1] and sure[3] and self.step[1] * self.step[3] < 0)


class Window(NamedTuple):
    """Rows of consecutive blocks against what was believed before them."""

    ratio: float  #: for any step.
    left: float  #: mean square of what it leaves of the rows; without a window of several blocks, 0.
    foreseen: Array  #: the rows' triangle times the step, in units of what they may be off, shape (D, D).
    off: Array  #: how far they are off, in the same units, shape (D,).

    @classmethod
    def of(cls, belief: Belief, rows: Sequence[Array]) -> Window:
        """Compare what was believed, with a covariance, with blocks' rows of noise 1, each of shape (D, D+1)."""
        together: Array = np.concatenate(rows)
        size = together.shape[1] - 1
        together[:, -1] -= together[:, :-1] @ belief.mean
        made: Array = np.asarray(np.linalg.qr(together, mode='r'))
        phi = made[:size, :size]
        unsure = np.linalg.cholesky(np.eye(size) + phi @ belief.covariance @ phi.T)
        whitened: Array = np.asarray(np.linalg.solve(unsure, made[:size]), dtype=float)
        left = float(made[size, size] ** 2) / (len(together) - size) if len(together) > size else 0.0
        return cls(float(whitened[:, -1] @ whitened[:, -1]), left, whitened[:, :-1], whitened[:, -1])

    @property
    def doubtful(self) -> bool:
        """Whether so much is hardly chance."""
        return self.ratio > DOUBTED

    @property
    def explained(self) -> bool:
        """Whether one step explains all blocks."""
        return self.left < EXPLAINED

    def jump(self, kinds: Sequence[Kind], theta: Array) -> Jump | None:
        """Return the simplest kind of step from ``theta``, in units of its scale, that explains the window.

        It is None where only nonsense does.
        """
        found = [self._along(kind) for kind in kinds]
        enough = [jump for jump in found if self.ratio - jump.ratio < max(LEAVES, PART * self.ratio)]
        size = theta[:5]
        likely = [
            jump
            for jump in enough or found
            if (size + jump.step[:5] >= LEAST * size - LITTLE).all() and not jump.no_payload
        ]
        return max(likely, key=lambda jump: jump.ratio - SIMPLER * jump.kind.directions.shape[1], default=None)

    def _along(self, kind: Kind) -> Jump:
        phi = self.foreseen @ kind.directions
        inverse = np.linalg.pinv(phi, rcond=1e-9)
        size = inverse @ self.off
        to_step = kind.directions @ inverse
        explained = self.off - phi @ size
        return Jump(
            kind,
            kind.directions @ size,
            np.sqrt((to_step**2).sum(axis=1)),
            self.ratio - float(explained @ explained),
        )


def kinds(theta: Array) -> Iterator[Kind]:
    """Return what may change in a rig with these parameters and a delay, shape (D,); first what has fewest unknowns.

    A payload m at a distance d from the elbow adds m l1^2, m d^2, m l1 d, m l1 and m d to P1 to P5, l1 being P3 / P5.
    """
    size = len(theta)
    names = (*NAMES[: size - 1], DELAY)
    yield Kind('motor: all torque', np.append(theta[:-1], 0.0)[:, None])
    yield _axes('delay of the effort', names, (DELAY,))
    inertia = np.where(np.isin(names, ('P1', 'P2', 'P3', 'J2')), theta, 0.0)
    viscous = np.where(np.isin(names, ('b1', 'b2')), theta, 0.0)
    yield Kind('time: all rates', np.column_stack([inertia, viscous]))
    yield _axes('friction of the shoulder', names, ('b1', 'Fc1', 'Fs1', 'k1'))
    yield _axes('friction of the elbow', names, ('b2', 'Fc2', 'Fs2', 'k2'))
    yield _axes('payload on link 1', names, ('P1', 'P4'))
    length = theta[2] / theta[4] if theta[4] > 0 else 0.0
    payload = np.zeros((size, 3))
    payload[:5] = np.array([[length**2, 0, 0, length, 0], [0, 0, length, 0, 1], [0, 1, 0, 0, 0]]).T
    yield Kind(PAYLOAD, payload)
    yield Kind(SEVERAL, np.eye(size))


def _axes(name: str, names: Sequence[str], which: Sequence[str]) -> Kind:
    return Kind(name, np.eye(len(names))[:, [k for k, each in enumerate(names) if each in which]])
