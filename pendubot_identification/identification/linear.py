# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The criteria that are quadratic in theta, energy and weak: exact minimum, MDE, uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.energy import Regression, energy_regression
from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.criteria.weak import estimate_delay, residual_weights, weak_regression
from pendubot_identification.model.parameters import repaired
from pendubot_identification.optimizers.mde import mde
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import SMOOTHING

from .estimate import REACHED, Effort, Estimate, Progress
from .settings import Settings
from .uncertainty import correlations, regression_covariance


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

    @classmethod
    def of(cls, residuals: list[Regression], delay: float, weights: Array) -> Linear:
        """Pool the residuals of recordings."""
        return cls(residuals, Quadratic.pool([Quadratic.reduce(r.phi, r.y) for r in residuals]), delay, weights)


def linear(name: str, motions: Sequence[Motion], model: str, settings: Settings, like: Linear | None = None) -> Linear:
    """Return the criterion ``name`` of recordings, with estimated delay and weights, or with those in ``like``."""
    if name == 'energy':
        smoothing = SMOOTHING if settings.smoothing is None else settings.smoothing
        residuals = [energy_regression(m.recorded, settings.sliding, smoothing, model) for m in motions]
        return Linear.of(residuals, 0.0, np.empty(0))
    if like is not None:
        delay, weights = like.delay, like.weights
    else:
        bounds, (low, high) = settings.box(model), settings.delays
        delay = low if low == high else estimate_delay(motions, model, bounds, low, high)
        weights = residual_weights([weak_regression(m, model, delay, weights=(1, 1, 1)) for m in motions], bounds)
        if low < high:
            delay = estimate_delay(motions, model, bounds, low, high, weights=weights)
    residuals = [weak_regression(m, model, delay, weights=weights) for m in motions]
    return Linear.of(residuals, delay, weights)


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
