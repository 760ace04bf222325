# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The estimate of one criterion, and its covariance, for residuals that are correlated in time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fdtrc, stdtrit

from pendubot_identification.arrays import Array, Flags, Indices
from pendubot_identification.criteria.energy import Regression
from pendubot_identification.criteria.prediction_error import Prediction
from pendubot_identification.level import NORMAL_95, POOR, Level
from pendubot_identification.model.parameters import NAMES
from pendubot_identification.optimizers.mde import OptimizationResult

#: Callback: activity, amount done, total amount (0: unknown), and the best J so far.
Progress = Callable[[str, int, int, float], None]

#: A run has found the minimum if its J exceeds the exact minimum by at most this fraction.
REACHED = 1e-6
#: Share of all other parts in the information along a direction, below which it comes from one part alone.
NEGLIGIBLE = 1e-3
#: Half-width of an interval, as a fraction of the value, above which the value is not reliable.
WIDE = 0.5


@dataclass(frozen=True, slots=True)
class IntervalSettings:
    """Settings of the variance by the influence of parts of the data."""

    #: degrees of freedom of the common factor; with 2, the variance of two recordings, which has a single degree of
    #: freedom, is as certain as the variance of four.
    prior: float = 2.0
    #: level of the test whether recordings differ by more in one parameter than in the others.
    significance: float = 0.05


SETTINGS = IntervalSettings()


@dataclass(frozen=True, slots=True)
class Effort:
    """The hold and the delay of the recorded effort."""

    hold: str  #: ``zero`` or ``linear``, see :class:`.settings.Settings`.
    delay: float = 0.0  #: input delay [s]: the effort recorded at t - delay acts at t.
    std_error: float = np.nan  #: of the delay [s]; NaN if it was not estimated.


@dataclass(frozen=True, slots=True)
class Zeros:
    """The zero errors of recordings: the recorded position minus the true one."""

    recordings: tuple[str, ...]  #: names of the recordings.
    angles: Array  #: of both joints [rad], shape (2, R); NaN if they were not estimated.
    std_error: Array  #: [rad], shape (2, R).


@dataclass(frozen=True, slots=True)
class Estimate:
    """The answer of one criterion."""

    criterion: str  #: ``energy``, ``weak`` or ``likelihood``.
    model: str  #: the name of one of :data:`.parameters.MODELS`.
    theta: Array  #: the estimate, shape (D,).
    free: Flags  #: which parameters are neither on a bound nor fixed, shape (D,).
    covariance: Array  #: shape (D, D); NaN in the rows and columns of parameters on a bound.
    #: of the errors by the information matrix at theta, shape (D, D), because the covariance of few recordings is
    #: singular. NaN in the rows and columns of parameters that are on a bound or not identifiable.
    correlation: Array
    std_error: Array  #: shape (D,); without the bound for a parameter on its bound; NaN if it is not in the model.
    uncertainty: str  #: the method for the covariance, in words.
    effort: Effort  #: hold and delay of the effort.
    J: float  #: the criterion on the training data.
    residuals: int  #: number of residuals that J averages.
    condition_number: float  #: of the scaled information.
    converged: bool  #: whether the optimiser found a minimum.
    fixed: Flags  #: which parameters were fixed at a value, shape (D,).
    steps: tuple[str, ...] = ()  #: the result of each step of the optimisation, in words.
    unexplained: float = np.nan  #: J over J with all parameters zero; NaN for ``likelihood``.
    J_exact: float = np.nan  #: the exact minimum of a quadratic criterion within the bounds; NaN for others.
    runs: OptimizationResult | None = None  #: results of the runs of MDE; None without MDE.
    J_validation: float = np.nan  #: the criterion on validation data; NaN without them.
    #: the same for each run of MDE, shape (runs,); empty without.
    J_validation_runs: Array = field(default_factory=lambda: np.empty(0))
    prediction: Prediction = field(default_factory=Prediction.none)  #: of validation data.
    zeros: Zeros | None = None  #: of the recordings' positions; None where the criterion does not estimate them.
    exact: bool = False  #: whether the residual is at the quantization level.
    absent: tuple[str, ...] = ()  #: the parameters that are not in the model of this rig, 0 in theta.
    #: degrees of freedom of the standard errors, infinite where they are normal, shape (D,) or ().
    freedom: Array = field(default_factory=lambda: np.array(math.inf))
    level: Level = Level.OK  #: OK, WARN or ERROR.
    warnings: tuple[str, ...] = ()  #: reasons of the level, in sentences for the user.
    #: other findings, if the warnings contain a severe fault of the recordings as their cause.
    consequences: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()  #: motions that would determine the poorly determined parameters.

    @property
    def present(self) -> Flags:
        """Which parameters are in the model of this rig, shape (D,)."""
        return ~np.isin(NAMES[: len(self.theta)], self.absent)

    @property
    def half_width(self) -> Array:
        """Half-width of the 95 % intervals, shape (D,)."""
        return np.asarray(self.std_error * student_quantile(self.freedom))

    @property
    def intervals(self) -> Array:
        """95 % intervals, shape (D, 2), cut where friction or inertia would be negative and the estimate is not."""
        reach = self.half_width
        low = np.where(self.theta >= 0, np.maximum(self.theta - reach, 0.0), self.theta - reach)
        return np.column_stack([low, self.theta + reach])

    @property
    def determined(self) -> Flags:
        """Whether this motion determines each parameter: its standard error is below half its value, shape (D,)."""
        return np.asarray(self.free & (self.std_error <= POOR * np.abs(self.theta)))

    @property
    def not_covered(self) -> dict[str, str]:
        """The parameters that the level does not cover, because they are poorly determined, and why, by name."""
        reasons = {}
        for k in np.flatnonzero(self.present & ~self.fixed):
            value, reach = abs(self.theta[k]), self.half_width[k]
            if not self.free[k]:
                reasons[NAMES[k]] = 'on its bound'
            elif not np.isfinite(reach):
                reasons[NAMES[k]] = 'not identifiable from this motion'
            elif reach >= value:
                reasons[NAMES[k]] = 'its 95 % interval reaches 0'
            elif reach > WIDE * value:
                reasons[NAMES[k]] = f'its 95 % interval is +-{100 * reach / value:.0f} %'
        return reasons

    @property
    def J_runs(self) -> Array:
        """J of every run of MDE on the training data, or J alone, shape (runs,)."""
        return np.array([self.J]) if self.runs is None else self.runs.value

    @property
    def runs_at_minimum(self) -> int:
        """The number of runs of MDE within a relative 1e-6 of the exact minimum; 1 without MDE."""
        if self.runs is None:
            return 1
        return int((self.J_runs <= self.J_exact * (1 + REACHED)).sum())


def student_quantile(freedom: ArrayLike) -> Array:
    """Return the half-width of 95 % intervals in standard errors; infinite degrees of freedom are normal."""
    n = np.asarray(freedom, dtype=float)
    return np.where(np.isfinite(n), stdtrit(np.where(np.isfinite(n), n, 1.0), 0.975), NORMAL_95)


def influence_covariance(
    information: Array,
    slopes: Array,
    informations: Array,
    owner: Indices,
    free: Flags,
    difference: Array,
    *,
    exact: bool,
) -> tuple[Array, Array, Array, str]:
    """Return the covariance of the minimum of a composite criterion, by the influence of parts of the data.

    The parts share data, so that the inverse curvature V understates the variance. The variance W by the influence of
    each recording is shrunk towards c V, where c is the mean of W over V (Smyth 2004). A parameter in which recordings
    differ by more than in the others (F test) has its own variance. Blocks of time take the place of recordings if
    there is one, or if the residual is at the quantization level.
    ``docs/method.md`` has the formulas.

    Args:
        information: the inverse of V, for errors of unit variance, shape (D, D).
        slopes: g of each block of time at the minimum, shape (B, D).
        informations: of each block of time, shape (B, D, D).
        owner: index of the recording of each block, shape (B,).
        free: which unknowns lie on no bound, shape (D,).
        difference: to the estimate of the shortest interval, shape (D,), which adds to the standard error: an
            unmodelled effect biases all recordings in the same way (Hausman 1978).
        exact: whether the residual is at the quantization level.

    Returns:
        Covariance, shape (D, D), NaN for unknowns on a bound; standard errors, shape (D,), of these without the bound;
        degrees of freedom, shape (D,); the method, in words.
    """
    size, count = len(free), int(owner.max(initial=-1)) + 1
    inverse, lost = _inverted(information, free)
    curvature = np.sqrt(np.diag(inverse))
    covariance, std_error, freedom = inverse, curvature, np.full(size, math.inf)
    words = 'curvature of the likelihood'
    if len(owner) > 1:
        by_block = exact or count == 1
        recordings = _summed(slopes, owner), _summed(informations, owner)
        parts = (slopes, informations) if by_block else recordings
        # Blocks of one recording contain no information on differences between recordings.
        n = 0.0 if count == 1 and not exact else len(parts[0]) - 1.0
        words = f'influence of {len(owner)} blocks of time' if by_block else f'influence of {count} recordings'
        spread = _spread(*parts, inverse)
        total, known = float(np.trace(information @ spread)), max(int((curvature > 0).sum()), 1)
        covariance = (SETTINGS.prior * max(total / known, 1.0) * inverse + n * spread) / (SETTINGS.prior + n)
        variance, freedom = np.diag(covariance).copy(), np.full(size, SETTINGS.prior + n)
        if count > 1:
            between = _spread(*recordings, inverse)
            odd = _differ(np.diag(between), np.diag(spread), np.diag(inverse), total, n, count - 1)
            variance[odd] = np.maximum(np.diag(between)[odd], variance[odd])
            freedom[odd] = count - 1
            words += f' and of {count} recordings' if by_block and odd.any() else ''
        std_error = np.sqrt(variance + difference**2)
        wide = curvature * NORMAL_95 > std_error * student_quantile(freedom)
        std_error, freedom = np.where(wide, curvature, std_error), np.where(wide, math.inf, freedom)
        covariance = covariance + np.outer(difference, difference)
        scale = std_error / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        covariance = covariance * scale * scale[:, None]
        words += ', and the difference to the estimate of the shortest interval' if difference.any() else ''
    std_error = np.where(lost, np.inf, std_error)
    others = free & ~lost
    ratio = np.median(std_error[others] / curvature[others]) if others.any() else 1.0
    for k in np.flatnonzero(~free & (np.diag(information) > 0)):
        released = free.copy()
        released[k] = True
        std_error[k] = ratio * math.sqrt(_inverted(information, released)[0][k, k])
    covariance = covariance.copy()
    covariance[lost, lost] = np.inf
    covariance[~free], covariance[:, ~free] = np.nan, np.nan
    return covariance, std_error, freedom, words


def regression_covariance(
    residuals: Sequence[Regression], theta: Array, free: Flags
) -> tuple[Array, Array, Array, str]:
    """Return the covariance of a least-squares estimate, see :func:`influence_covariance`.

    Residuals that are integrals over overlapping intervals of time are far from independent, so that the textbook
    covariance is many times too small. The blocks of time are about 1 s long.

    Args:
        residuals: of each recording.
        theta: the estimate, shape (D,).
        free: which parameters lie on no bound, shape (D,).
    """
    slopes, informations, owner = list[Array](), list[Array](), list[int]()
    errors = [r.phi @ theta - r.y for r in residuals]
    variance = max(float(np.mean(np.concatenate(errors) ** 2)), np.finfo(float).tiny)
    for number, (r, error) in enumerate(zip(residuals, errors, strict=True)):
        count = min(max(1, round(float(np.ptp(r.t)))), len(r.y))
        for rows in np.array_split(np.arange(len(r.y)), count):
            slopes.append(r.phi[rows].T @ error[rows] / variance)
            informations.append(r.phi[rows].T @ r.phi[rows] / variance)
            owner.append(number)
    parts = np.array(slopes), np.array(informations), np.array(owner)
    return influence_covariance(parts[1].sum(axis=0), *parts, free, np.zeros_like(theta), exact=False)


def _summed(blocks: Array, owner: Indices) -> Array:
    """Return the sums of the blocks of each recording, shape (R, ...)."""
    return np.array([blocks[owner == k].sum(axis=0) for k in range(int(owner.max()) + 1)])


def _spread(slopes: Array, informations: Array, inverse: Array) -> Array:
    """Return the covariance of the minimum by the influence of parts, without bias for few parts, shape (D, D).

    At the minimum, the slope of a part with much information is too small (CR2: Bell and McCaffrey, Survey Methodology
    28, 2002).
    """
    scale = np.sqrt(np.where(np.diag(inverse) > 0, np.diag(inverse), 1.0))
    values, vectors = np.linalg.eigh(inverse / scale / scale[:, None])
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    share, axes = np.linalg.eigh(root.T @ informations @ root)
    reduced = np.sqrt(np.maximum(1.0 - share, NEGLIGIBLE))
    moves = np.einsum('mij,mj,mkj,mk->mi', axes, 1 / reduced, axes, slopes @ root) @ root.T
    return np.asarray(moves.T @ moves)


def _differ(by_recording: Array, spread: Array, inverse: Array, total: float, n: float, between: int) -> Flags:
    """Return the parameters in which recordings vary more than in all others, relative to the curvature."""
    known = inverse > 0
    others = max(int(known.sum()) - 1, 1)
    scale = np.where(known, inverse, 1.0)
    rest = np.maximum((total - spread / scale) / others, 1.0)
    chance = fdtrc(between, n * others, by_recording / scale / rest)
    return np.asarray(known & (chance * (others + 1) < SETTINGS.significance))


def correlations(information: Array, free: Flags) -> Array:
    """Return the correlations of errors by an information matrix, shape (D, D).

    Rows and columns of unknowns that are not free or not identifiable are NaN.
    """
    covariance, lost = _inverted(information, free)
    deviation = np.sqrt(np.where(free & ~lost, np.diag(covariance), np.nan))
    return np.asarray(covariance / deviation / deviation[:, None])


def scaled_condition_number(information: Array, free: Flags) -> float:
    """Return the condition number of the residuals' derivative by the free unknowns, columns scaled to one."""
    scaled, scale = _scaled(information[np.ix_(free, free)])
    return float(np.sqrt(np.linalg.cond(scaled))) if np.isfinite(scale).all() and scaled.size else float('inf')


def _inverted(information: Array, free: Flags) -> tuple[Array, Flags]:
    """Return the pseudo-inverse for the free unknowns, shape (D, D), and which of them are not identifiable.

    Those have a component in a direction without information. Rows and columns of other unknowns are 0.
    """
    inverse, lost = np.zeros_like(information), free & (np.diag(information) <= 0)
    scaled, scale = _scaled(information[np.ix_(free, free)])
    values, vectors = np.linalg.eigh(scaled)
    identifiable = values > len(values) * 4 * np.finfo(float).eps * values.max(initial=0.0)
    values, vectors = values[identifiable], vectors[:, identifiable]
    inverse[np.ix_(free, free)] = (vectors / values) @ vectors.T / scale / scale[:, None]
    lost[free] |= (vectors**2).sum(axis=1) < 1 - 1e-6
    return inverse, lost


def _scaled(information: Array) -> tuple[Array, Array]:
    """Return the matrix scaled to ones on its diagonal, and the scale, infinite without information."""
    diagonal = np.diag(information)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, np.inf))
    scaled = information / scale / scale[:, None]
    np.fill_diagonal(scaled, 1.0)
    return scaled, scale
