# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The criteria that are quadratic in theta, energy and weak: exact minimum, MDE beside it, uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.energy import Residuals, energy_residuals
from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.criteria.weak import balance_weights, estimate_delay, weak_regression, weak_residuals
from pendubot_identification.model.parameters import MODELS, repaired
from pendubot_identification.optimizers.mde import mde
from pendubot_identification.trajectories.motion import AnyMotion, Motion
from pendubot_identification.trajectories.signals import SMOOTHING

from .covariance import correlations
from .estimate import REACHED, Effort, Estimate, Progress
from .settings import Settings
from .uncertainty import BLOCK, Blocks, bootstrap_covariance

Array = NDArray[np.float64]

UNITS = {'energy': 'J^2', 'weak': '(N m)^2'}


class Linear(NamedTuple):
    """A quadratic criterion made of recordings.

    Attributes:
        residuals: of each recording.
        blocks: the same reduced.
        delay: of the effort [s].
        weights: of the weak criterion's three balances, shape (3,); empty for ``energy``.
    """

    residuals: list[Residuals]
    blocks: Blocks
    delay: float
    weights: Array

    @property
    def criterion(self) -> Quadratic:
        """The pooled criterion."""
        return self.blocks.criterion


def linear(
    name: str, motions: Sequence[AnyMotion], model: str, settings: Settings, like: Linear | None = None
) -> Linear:
    """Make the criterion ``name`` of recordings, with the delay and the weights that suit them or those of another.

    Delay and weights suit motions that are held: long ones take them from another.
    """
    if name == 'energy':
        smoothing = SMOOTHING if settings.smoothing is None else settings.smoothing
        residuals = [energy_residuals(m.recorded, settings.sliding, smoothing, model) for m in motions]
        block = BLOCK if settings.sliding else np.inf
        return Linear(residuals, Blocks.of(residuals, block), 0.0, np.empty(0))
    delay, weights = _suited(motions, model, settings) if like is None else (like.delay, like.weights)
    residuals = [weak_residuals(m, model, delay, weights) for m in motions]
    return Linear(residuals, Blocks.of(residuals), delay, weights)


def _suited(motions: Sequence[AnyMotion], model: str, settings: Settings) -> tuple[float, Array]:
    """Return the effort's delay [s] and the weights of the weak criterion's balances with which motions agree best."""
    bounds = settings.bounds.of(MODELS[model])
    low, high = settings.delays
    held = [m for m in motions if isinstance(m, Motion)]
    delay = low if low == high else estimate_delay(held, model, bounds, low, high)
    weights = balance_weights([weak_regression(m, model, delay, weights=(1, 1, 1)) for m in held], bounds)
    if low < high:
        delay = estimate_delay(held, model, bounds, low, high, weights=weights)
    return delay, weights


def estimate_linear(
    name: str,
    made: Linear,
    model: str,
    settings: Settings,
    hold: str,
    progress: Progress | None = None,
    validation: Linear | None = None,
) -> Estimate:
    """Minimise a quadratic criterion, by MDE unless ``lsq`` is asked for, and hold it against its exact minimum."""
    criterion, bounds = made.criterion, settings.bounds.of(MODELS[model])
    exact = criterion.minimum(bounds)
    J_exact = float(criterion(exact))
    theta, runs, steps = exact, None, ['exact bounded least squares']
    if settings.optimizer != 'lsq':
        how, count = settings.search(name, model)

        def tell(generation: int, best: float) -> None:
            if progress is not None:
                progress(f'{name}: MDE', generation, how.generations, best)

        runs = mde(Penalised.of(criterion), bounds, how, runs=count, seed=settings.seed, progress=tell)
        theta = repaired(runs.x)[runs.best]
        reached = int((runs.value <= J_exact * (1 + REACHED)).sum())
        steps = [
            f'MDE: {reached} of {count} runs reached the exact minimum to a relative {REACHED:g}, '
            f'J = {runs.value.min():.6e}, exact {J_exact:.6e}'
        ]
    free = ~bounds.at_bound(theta, tolerance=1e-7)
    covariance = bootstrap_covariance(made.blocks, theta, free, seed=settings.seed)
    present = bounds.present
    off = covariance if free.all() else bootstrap_covariance(made.blocks, theta, present, seed=settings.seed)
    judge = None if validation is None else validation.criterion
    return Estimate(
        criterion=name,
        model=model,
        theta=theta,
        free=free,
        covariance=covariance,
        correlation=correlations(criterion.phi.T @ criterion.phi, free),
        std_error=np.sqrt(np.where(free, np.diag(covariance), np.diag(off))),
        uncertainty=f'block bootstrap over blocks of {made.blocks.length:.3g} s',
        effort=Effort(hold if name == 'weak' else 'zero', made.delay),
        J=float(criterion(theta)),
        unit=UNITS[name],
        residuals=criterion.count,
        condition_number=criterion.condition_number(present),
        converged=True,
        steps=tuple(steps),
        unexplained=float(criterion(theta)) / max(float(criterion(np.zeros_like(theta))), np.finfo(float).tiny),
        J_exact=J_exact,
        runs=runs,
        J_validation=np.nan if judge is None else float(judge(theta)),
        J_validation_runs=np.empty(0) if judge is None or runs is None else judge(repaired(runs.x)),
        absent=bounds.absent,
    )
