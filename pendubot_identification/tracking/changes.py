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

from .filter import Estimate
from .settings import TrackerSettings

Array = NDArray[np.float64]

#: Unknowns beside theta, in this order: the delay of the effort [s]; P4 and P5 along the horizontal, not 0 under a tilt
#: of the base; the dead zone of the motor [N m]; the rate of all torque [1/s].
DELAY, TILT, DEAD_ZONE, RATE = 'delay', ('P4 horizontal', 'P5 horizontal'), 'dead zone', 'rate'
PAYLOAD, SEVERAL, DRIFT = 'payload on link 2', 'several', 'motor: gradual change of all torque'


class ChangeType(NamedTuple):
    """A kind of change: its name, and the directions in which theta may step, shape (D, F)."""

    name: str
    directions: Array


class StepChange(NamedTuple):
    """A step of theta: its kind, the step, shape (D,), its standard errors, and the ratio that speaks for it."""

    kind: ChangeType
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
    likelihood: float  #: logarithm of the rows' likelihood, but for a constant.
    predicted: Array  #: the rows' R factor times the step, in units of what they may be off, shape (D, D).
    off: Array  #: how far they are off, in the same units, shape (D,).

    @classmethod
    def of(cls, estimate: Estimate, rows: Sequence[Array]) -> Window:
        """Compare a determined estimate with blocks' rows of noise 1, each of shape (N, D+1)."""
        together: Array = np.concatenate(rows)
        size = together.shape[1] - 1
        together[:, -1] -= together[:, :-1] @ estimate.mean
        made: Array = np.asarray(np.linalg.qr(together, mode='r'))
        if len(made) < size:
            made = np.concatenate([made, np.zeros((size - len(made), size + 1))])
        phi = made[:size, :size]
        unsure = np.linalg.cholesky(np.eye(size) + phi @ estimate.covariance @ phi.T)
        whitened: Array = np.asarray(np.linalg.solve(unsure, made[:size]), dtype=float)
        left = float(made[size, size] ** 2) / (len(together) - size) if len(together) > size else 0.0
        ratio = float(whitened[:, -1] @ whitened[:, -1])
        likelihood = -ratio / 2 - float(np.log(np.diag(unsure)).sum())
        return cls(ratio, left, likelihood, whitened[:, :-1], whitened[:, -1])

    @property
    def evidence(self) -> float:
        """The ratio in units of what any step leaves: more than noise, under a change or unmodelled effects."""
        return self.ratio / max(1.0, self.left)

    def step_change(self, kinds: Sequence[ChangeType], theta: Array, settings: TrackerSettings) -> StepChange | None:
        """Return the simplest kind of step from ``theta``, in units of its scale, that explains the window.

        It is None where only nonsense does: free motion says nothing of the size of P1 to P5, so that none at all would
        explain it.
        """
        found = [self._along(kind) for kind in kinds]
        enough = [
            step_change
            for step_change in found
            if self.ratio - step_change.ratio < max(settings.leaves, settings.part * self.ratio)
        ]
        size = theta[:5]
        least = settings.least * size - 0.1
        likely = [
            step_change
            for step_change in enough or found
            if (size + step_change.step[:5] >= least).all() and not step_change.no_payload
        ]
        price = settings.simpler * max(1.0, self.left)
        return max(
            likely,
            key=lambda step_change: step_change.ratio - price * step_change.kind.directions.shape[1],
            default=None,
        )

    def _along(self, kind: ChangeType) -> StepChange:
        phi = self.predicted @ kind.directions
        inverse = np.linalg.pinv(phi, rcond=1e-9)
        size = inverse @ self.off
        to_step = kind.directions @ inverse
        explained = self.off - phi @ size
        return StepChange(
            kind,
            kind.directions @ size,
            np.sqrt((to_step**2).sum(axis=1)),
            self.ratio - float(explained @ explained),
        )


def kinds(names: Sequence[str], theta: Array) -> Iterator[ChangeType]:
    """Return what may change in a rig with these unknowns, shape (D,), the rate the last of them; first the simplest.

    A payload m at a distance d from the elbow adds m l1^2, m d^2, m l1 d, m l1 and m d to P1 to P5, l1 being P3 / P5.
    """
    size = len(names)
    yield ChangeType('motor: all torque', np.where(np.isin(names, (DELAY, DEAD_ZONE, RATE)), 0.0, theta)[:, None])
    yield _axes('delay of the effort', names, (DELAY,))
    yield _axes('dead zone of the motor', names, (DEAD_ZONE,))
    inertia = np.where(np.isin(names, ('P1', 'P2', 'P3', 'J2')), theta, 0.0)
    viscous = np.where(np.isin(names, ('b1', 'b2')), theta, 0.0)
    yield ChangeType('time: all rates', np.column_stack([inertia, viscous]))
    yield _axes('friction of the shoulder', names, ('b1', 'Fc1', 'Fs1', 'k1'))
    yield _axes('friction of the elbow', names, ('b2', 'Fc2', 'Fs2', 'k2'))
    yield _axes('payload on link 1', names, ('P1', 'P4'))
    length = theta[2] / theta[4] if theta[4] > 0 else 0.0
    payload = np.zeros((size, 3))
    payload[:5] = np.array([[length**2, 0, 0, length, 0], [0, 0, length, 0, 1], [0, 1, 0, 0, 0]]).T
    yield ChangeType(PAYLOAD, payload)
    yield _axes('tilt of the base', names, ('P4', 'P5', *TILT))
    yield _axes(SEVERAL, names, names[:-1])


def _axes(name: str, names: Sequence[str], which: Sequence[str]) -> ChangeType:
    return ChangeType(name, np.eye(len(names))[:, [k for k, each in enumerate(names) if each in which]])
