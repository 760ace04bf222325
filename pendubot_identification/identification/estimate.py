# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The estimate of one criterion with its uncertainty, and the estimators of the quadratic criteria, energy and weak."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.criteria.energy import Regression, energy_regression
from pendubot_identification.criteria.prediction_error import Prediction
from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.criteria.weak import estimate_delay, residual_weights, weak_regression
from pendubot_identification.level import POOR, Level
from pendubot_identification.model.parameters import NAMES, repaired
from pendubot_identification.optimizers.mde import mde
from pendubot_identification.optimizers.optimizer import OptimizationResult
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import SMOOTHING

from .settings import Settings
from .uncertainty import correlations, regression_covariance, student_quantile

#: Callback: activity, amount done, total amount (0: unknown), and the best J so far.
Progress = Callable[[str, int, int, float], None]

#: A run has found the minimum if its J exceeds the exact minimum by at most this fraction.
REACHED = 1e-6
#: Half-width of an interval, as a fraction of the value, above which the value is not reliable.
WIDE = 0.5
#: Eigenvalue of a correlation matrix below which it is a rounding error.
INDEPENDENT = 1e-10


@dataclass(frozen=True, slots=True)
class Effort:
    """The hold and the delay of the recorded effort.

    Attributes:
        hold: ``zero`` or ``linear``, see :class:`.settings.Settings`.
        delay: input delay [s]: the effort recorded at t - delay acts at t.
        std_error: of the delay [s]; NaN if it was not estimated.
    """

    hold: str
    delay: float = 0.0
    std_error: float = np.nan


@dataclass(frozen=True, slots=True)
class Zeros:
    """The zero errors of recordings: the recorded position minus the true one.

    Attributes:
        recordings: names of the recordings.
        angles: of both joints [rad], shape (2, R); NaN if they are not identifiable.
        std_error: [rad], shape (2, R).
    """

    recordings: tuple[str, ...]
    angles: Array
    std_error: Array


@dataclass(frozen=True, slots=True)
class Estimate:
    """The answer of one criterion.

    Attributes:
        criterion: ``energy``, ``weak`` or ``likelihood``.
        model: the name of one of :data:`.parameters.MODELS`.
        theta: the estimate, shape (D,).
        free: which parameters are neither on a bound nor fixed, shape (D,).
        covariance: shape (D, D); NaN in the rows and columns of parameters on a bound.
        correlation: of the errors by the information matrix at theta, shape (D, D), because the covariance of few
            recordings is singular. NaN in the rows and columns of parameters that are on a bound or not identifiable.
        std_error: shape (D,); without the bound for a parameter on its bound; NaN if it is not in the model.
        freedom: degrees of freedom of the standard errors, infinite where they are normal, shape (D,) or ().
        uncertainty: the method for the covariance, in words.
        effort: hold and delay of the effort.
        J: the criterion on the training data.
        residuals: number of residuals that J averages.
        condition_number: of the scaled information.
        converged: whether the optimiser found a minimum.
        steps: the result of each step of the optimisation, in words.
        unexplained: J over J with all parameters zero; NaN for ``likelihood``.
        J_exact: the exact minimum of a quadratic criterion within the bounds; NaN for others.
        runs: results of the runs of MDE; None without MDE.
        J_validation: the criterion on validation data; NaN without them.
        J_validation_runs: the same for each run of MDE, shape (runs,); empty without.
        prediction: of validation data.
        zeros: of the recordings' positions; None where the criterion does not estimate them.
        exact: whether the residual is at the quantization level.
        fixed: which parameters were fixed at a value, shape (D,).
        absent: the parameters that are not in the model of this rig, 0 in theta.
        level: OK, WARN or ERROR.
        warnings: reasons of the level, in sentences for the user.
        consequences: other findings, if the warnings contain a severe fault of the recordings as their cause.
        advice: motions that would determine the poorly determined parameters.
    """

    criterion: str
    model: str
    theta: Array
    free: Flags
    covariance: Array
    correlation: Array
    std_error: Array
    uncertainty: str
    effort: Effort
    J: float
    residuals: int
    condition_number: float
    converged: bool
    fixed: Flags
    steps: tuple[str, ...] = ()
    unexplained: float = np.nan
    J_exact: float = np.nan
    runs: OptimizationResult | None = None
    J_validation: float = np.nan
    J_validation_runs: Array = field(default_factory=lambda: np.empty(0))
    prediction: Prediction = field(default_factory=Prediction.none)
    zeros: Zeros | None = None
    exact: bool = False
    absent: tuple[str, ...] = ()
    freedom: Array = field(default_factory=lambda: np.array(math.inf))
    level: Level = Level.OK
    warnings: tuple[str, ...] = ()
    consequences: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()

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
    def covariance_rank(self) -> int:
        """The rank of the covariance without parameters on a bound: with few recordings or blocks, it is singular."""
        variance = np.diag(self.covariance)
        known = np.isfinite(variance) & (variance > 0)
        deviation = np.sqrt(variance[known])
        scaled = self.covariance[np.ix_(known, known)] / deviation / deviation[:, None]
        return int(np.linalg.matrix_rank(scaled, tol=INDEPENDENT, hermitian=True)) if known.any() else 0

    @property
    def J_runs(self) -> Array:
        """J of every run of MDE on the training data, or J alone, shape (runs,)."""
        return np.array([self.J]) if self.runs is None else self.runs.value

    @property
    def runs_at_minimum(self) -> int:
        """The number of runs of MDE within a relative 1e-6 of the exact minimum, or else of the best run."""
        if self.runs is None:
            return 1
        least = self.J_runs.min() if np.isnan(self.J_exact) else self.J_exact
        return int((self.J_runs <= least * (1 + REACHED)).sum())


class Linear(NamedTuple):
    """A quadratic criterion of recordings.

    Attributes:
        residuals: of each recording.
        criterion: pooled over the recordings.
        delay: of the effort [s].
        weights: of the three weak-form residuals, shape (3,); empty for ``energy``.
    """

    residuals: list[Regression]
    criterion: Quadratic
    delay: float
    weights: Array


def linear(name: str, motions: Sequence[Motion], model: str, settings: Settings, like: Linear | None = None) -> Linear:
    """Return the criterion ``name`` of recordings, with estimated delay and weights, or with those in ``like``."""
    if name == 'energy':
        delay, weights = 0.0, np.empty(0)
        smoothing = SMOOTHING if settings.smoothing is None else settings.smoothing
        residuals = [energy_regression(m.recorded, settings.sliding, smoothing, model) for m in motions]
    else:
        delay, weights = _delay_and_weights(motions, model, settings) if like is None else (like.delay, like.weights)
        residuals = [weak_regression(m, model, delay, weights=weights) for m in motions]
    return Linear(residuals, Quadratic.pool([Quadratic.reduce(r.phi, r.y) for r in residuals]), delay, weights)


def _delay_and_weights(motions: Sequence[Motion], model: str, settings: Settings) -> tuple[float, Array]:
    bounds, (low, high) = settings.box(model), settings.delays
    delay = low if low == high else estimate_delay(motions, model, bounds, low, high)
    weights = residual_weights([weak_regression(m, model, delay) for m in motions], bounds)
    if low < high:
        delay = estimate_delay(motions, model, bounds, low, high, weights=weights)
    return delay, weights


def estimate_linear(
    name: str, problem: Linear, model: str, settings: Settings, hold: str, progress: Progress, assess: Linear | None
) -> Estimate:
    """Minimise a quadratic criterion, by MDE unless the optimizer is ``lsq``, and compare the exact minimum."""
    criterion, bounds = problem.criterion, settings.box(model)
    theta = criterion.minimum(bounds)
    J_exact, runs, step = float(criterion(theta)), None, 'exact bounded least squares'
    if settings.optimizer != 'lsq':
        mde_settings, count = settings.search(name, model)
        runs = mde(
            Penalised.of(criterion),
            bounds,
            mde_settings,
            runs=count,
            seed=settings.seed,
            progress=lambda generation, best: progress(f'{name}: MDE', generation, mde_settings.generations, best),
        )
        theta = repaired(runs.x)[runs.best]
        reached = int((runs.value <= J_exact * (1 + REACHED)).sum())
        step = (
            f'MDE: {reached} of {count} runs reached the exact minimum to a relative {REACHED:g}, '
            f'J = {runs.value.min():.6e}, exact {J_exact:.6e}'
        )
    J, J_zero = float(criterion(theta)), float(criterion(np.zeros_like(theta)))
    free, estimated = ~bounds.at_bound(theta, tolerance=1e-7), bounds.present & ~bounds.fixed
    covariance, std_error, freedom, method = regression_covariance(problem.residuals, theta, free)
    validation_quadratic = None if assess is None else assess.criterion
    return Estimate(
        criterion=name,
        model=model,
        theta=theta,
        free=free,
        covariance=covariance,
        correlation=correlations(criterion.phi.T @ criterion.phi, free),
        std_error=np.where(bounds.fixed, 0.0, np.where(bounds.present, std_error, np.nan)),
        freedom=freedom,
        uncertainty=method,
        effort=Effort(hold if name == 'weak' else 'zero', problem.delay),
        J=J,
        residuals=criterion.count,
        condition_number=criterion.condition_number(estimated),
        converged=True,
        steps=(step,),
        unexplained=J / max(J_zero, np.finfo(float).tiny),
        J_exact=J_exact,
        runs=runs,
        J_validation=np.nan if validation_quadratic is None else float(validation_quadratic(theta)),
        J_validation_runs=np.empty(0)
        if validation_quadratic is None or runs is None
        else validation_quadratic(repaired(runs.x)),
        absent=bounds.absent,
        fixed=bounds.fixed,
    )
