# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A Kalman filter of unknowns that are random walks, and the detection of their steps by its innovations.

The measurements are the R factors of blocks. The last unknown is the drift rate of the motor's gain.

The generalised likelihood ratio (Willsky and Jones, IEEE Transactions on Automatic Control 21, 1976) compares no change
with any constant step of the unknowns from the first block on. Without a change it is a chi-square variable. A change
of parameters explains all blocks by one step; a push by hand does not, as its torque is no function of the motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from pendubot_identification.arrays import Array

from .blocks import Block

T = TypeVar('T', float, Array)
#: Unknowns beside theta, in this order: the delay of the effort [s]; P4 and P5 along the horizontal, not 0 if the
#: base is tilted; the dead zone of the motor [N m]; the rate of all torque [1/s].
DELAY, TILT, DEAD_ZONE, RATE = 'delay', ('P4 horizontal', 'P5 horizontal'), 'dead zone', 'rate'
PAYLOAD, SEVERAL, DRIFT = 'payload on link 2', 'several', 'motor: gradual change of all torque'
#: Smallest ratio of P1 to P5 after and before a step: without torque, zero parameters fit any motion, and time at twice
#: the rate gives 0.25.
SMALLEST = 0.24
#: Largest fraction of the likelihood ratio that a step leaves unexplained.
UNEXPLAINED = 0.05


class Estimate(NamedTuple):
    """The unknowns, shape (D,), and a square root of their covariance, shape (D, D).

    Differences of covariances lose their sign to rounding errors; square roots do not (Bierman, Factorization Methods
    for Discrete Sequential Estimation, 1977).
    """

    mean: Array
    root: Array

    @property
    def std_error(self) -> Array:
        """The standard error of each unknown, shape (D,)."""
        return np.asarray(np.sqrt(np.square(self.root).sum(axis=1)))

    def time_update(self, steps: Array, transition: Array | None = None) -> Estimate:
        """Return the estimate after a linear transition, shape (D, D), and independent random steps.

        The steps have the deviation 1 along the columns of ``steps``, shape (D, F).
        """
        transition = np.eye(len(self.mean)) if transition is None else transition
        return Estimate(transition @ self.mean, _triangular_root(transition @ self.root, steps))

    def measurement_update(self, innovations: Innovations) -> Estimate:
        """Return the estimate after the measurements of its innovations."""
        phi, y = innovations.rows[:, :-1], innovations.rows[:, -1]
        information = _triangular_root(np.eye(len(phi)), (phi @ self.root).T)
        root = np.linalg.solve(information, self.root.T).T
        return Estimate(self.mean + root @ (root.T @ (phi.T @ y)), root)

    def information_root(self, count: int) -> Array:
        """Return W, where W'W is the information on the first unknowns alone, shape (count, count)."""
        return np.asarray(np.linalg.inv(_triangular_root(self.root[:count])))


def _triangular_root(*roots: Array) -> Array:
    """Return the lower triangular square root of a sum of covariances with square roots (D, F), shape (D, D)."""
    return np.asarray(np.transpose(np.linalg.qr(np.hstack(roots).T, mode='r')), dtype=float)


class Innovations(NamedTuple):
    """Errors of the prediction of consecutive blocks, whitened by their covariance."""

    ratio: float  #: likelihood ratio of any step of the unknowns: the normalised innovation squared.
    residual: float  #: mean square of the rows after the best step; 0 for a single block.
    log_likelihood: float  #: of the rows, up to a constant.
    regressor: Array  #: of a step, shape (D, D).
    innovation: Array  #: shape (D,).
    rows: Array  #: R factor of the rows, without the residual, shape (D, D+1).
    number: int  #: of rows.

    @classmethod
    def of(cls, estimate: Estimate, rows: Sequence[Array]) -> Innovations:
        """Compare an estimate with the rows of blocks, of standard deviation 1, each of shape (D, D+1)."""
        stacked: Array = np.concatenate(rows)
        count, size = len(stacked), len(estimate.mean)
        stacked[:, -1] -= stacked[:, :-1] @ estimate.mean
        r_factor = np.zeros((size + 1, size + 1))
        r_factor[: min(count, size + 1)] = stacked if count <= size else np.linalg.qr(stacked, mode='r')
        reduced = r_factor[:-1]
        root = _triangular_root(np.eye(size), reduced[:, :-1] @ estimate.root)
        whitened: Array = np.asarray(np.linalg.solve(root, reduced), dtype=float)
        ratio = float(np.square(whitened[:, -1]).sum())
        log_likelihood = -ratio / 2 - float(np.log(np.abs(np.diag(root))).sum())
        residual = float(r_factor[-1, -1] ** 2) / max(count - size, 1)
        return cls(ratio, residual, log_likelihood, whitened[:, :-1], whitened[:, -1], reduced, count)


@dataclass(frozen=True)
class Noise:
    """Running means over blocks, which give the variance of the rows of their R factors.

    Whitened rows have a variance near 1, except in directions in which other errors than quantization matter.
    Neighbouring blocks overlap, so that their errors correlate.
    """

    memory: int  #: largest number of blocks in a mean.
    count: int  #: number of blocks so far, at most the memory.
    residual: float  #: least mean square of the rows over all unknowns.
    conditional: float  #: the same with the estimated tilt and dead zone.
    square: Array  #: of the innovation of each row, in units of the residual, shape (D-1,).
    product: Array  #: of the innovations of neighbours, shape (D-1,).
    last: Array  #: innovations of the newest block, shape (D-1,).

    @classmethod
    def of(cls, blocks: Sequence[Block], x: Array, memory: int) -> Noise:
        """Return the noise of first blocks, from which the unknowns x, shape (D-1,), were estimated."""
        residual = float(np.mean([block.residual() for block in blocks]))
        conditional = float(np.mean([block.residual(x[-3:]) for block in blocks]))
        none = np.zeros_like(x)
        begin = cls(memory, len(blocks), residual, conditional, none, none, none)
        errors = np.array([begin._errors(block, x) for block in blocks])
        square, product = (errors**2).mean(axis=0), (errors[1:] * errors[:-1]).mean(axis=0)
        return replace(begin, square=square, product=product, last=errors[-1])

    @property
    def excess(self) -> float:
        """The ratio of the RMS residual to the quantization level."""
        return math.sqrt(self.conditional)

    def rows(self, block: Block) -> Array:
        """Return a block's rows with standard deviation 1, and a column for the rate, shape (D-1, D+1)."""
        deviation = np.sqrt(np.maximum(self.square + 2 * np.maximum(self.product, 0.0), 1e-12))
        return np.insert(block.r_factor[:-1] / (self._scale(block) * deviation[:, None]), -1, 0.0, axis=1)

    def updated(self, block: Block, before: Estimate) -> Noise:
        """Return the noise after a block, given the estimate before it."""
        phi, count = self.rows(block)[:, :-1], min(self.count + 1, self.memory)
        # The variance of an innovation includes the variance of the estimate.
        innovation = self._errors(block, before.mean[:-1]) / np.sqrt(1 + np.square(phi @ before.root).sum(axis=1))

        def averaged(old: T, new: T) -> T:
            return old + (new - old) / count

        return replace(
            self,
            count=count,
            residual=averaged(self.residual, block.residual()),
            conditional=averaged(self.conditional, block.residual(before.mean[-4:-1])),
            square=averaged(self.square, innovation**2),
            product=averaged(self.product, innovation * self.last),
            last=innovation,
        )

    def _scale(self, block: Block) -> float:
        return math.sqrt(max(block.residual(), self.residual))

    def _errors(self, block: Block, x: Array) -> Array:
        return np.asarray(block.r_factor[:-1] @ np.append(-x, 1.0) / self._scale(block))


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
    def of(cls, kind: ChangeType, innovations: Innovations, scale: Array) -> StepChange:
        """Return the most likely step of a type, for unknowns of the size of ``scale``, shape (D,)."""
        phi = innovations.regressor @ kind.directions
        left, singular, right = np.linalg.svd(phi, full_matrices=False)
        # Without torque, all columns of a type may be rounding errors: compare them with all unknowns.
        visible = singular > 1e-9 * np.linalg.norm(innovations.regressor * scale)
        inverse = right[visible].T / singular[visible] @ left[:, visible].T
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
    penalty = max(1.0, innovations.residual) * math.log(innovations.number)
    unexplained = max(penalty * len(x), UNEXPLAINED * innovations.ratio)
    steps = (StepChange.of(kind, innovations, scale) for kind in change_types(names, x, scale))
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
