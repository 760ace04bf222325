"""From motions to parameters: the criterion reduced, minimised, checked against its exact minimum, and judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .energy import Regression, energy_regression
from .judgement import judge, missing_samples, require_excitation
from .level import Level
from .mde import MDE
from .optimizer import OptimizationResult, Progress, minimize
from .parameters import Parameters
from .quadratic import Quadratic
from .settings import Settings
from .trajectory import Trajectory
from .uncertainty import jackknife_covariance

Array = NDArray[np.float64]

#: A run has found the minimum when its J exceeds the exact one by no more than this fraction.
REACHED = 1e-6


@dataclass(frozen=True, slots=True)
class Validation:
    """The criterion on data that the estimate has not seen.

    Attributes:
        J: its value for the estimate or, where recordings were left out in turn, for each from the others [J^2].
        J_runs: its value for every run of the optimiser, shape (runs,); empty where recordings were left out in turn.
        method: in words.
    """

    J: float
    J_runs: Array
    method: str


@dataclass(frozen=True, slots=True)
class Identification:
    """A parameter vector and everything that says how far to trust it.

    Attributes:
        parameters: the estimate.
        covariance: shape (7, 7); NaN for parameters on a bound.
        settings: what was asked for.
        J: the criterion on the training data [J^2].
        J_exact: its exact minimum within the bounds [J^2].
        exact: where that is.
        runs: what the optimiser's runs found; None for ``lsq``.
        validation: None where no data was left for it.
        condition_number: of the regressor with columns scaled to one.
        residuals: how many residuals J averages.
        level: the worst of what the warnings say.
        warnings: sentences for the user.
    """

    parameters: Parameters
    covariance: Array
    settings: Settings
    J: float
    J_exact: float
    exact: Parameters
    runs: OptimizationResult | None
    validation: Validation | None
    condition_number: float
    residuals: int
    level: Level
    warnings: tuple[str, ...]

    @property
    def std_error(self) -> Array:
        """Standard errors, shape (7,); NaN for parameters on a bound."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def J_runs(self) -> Array:
        """J of every run on the training data, shape (runs,)."""
        return np.array([self.J]) if self.runs is None else self.runs.value

    @property
    def runs_at_minimum(self) -> int:
        """How many runs reached the exact minimum to a relative 1e-6."""
        return _reached(self.J_runs, self.J_exact)


def identify(
    training: Sequence[Trajectory],
    validation: Sequence[Trajectory] = (),
    settings: Settings | None = None,
    progress: Progress | None = None,
    notes: Sequence[str] = (),
) -> Identification:
    """Estimate the parameters of a rig from one or more of its motions.

    Args:
        training: the motions that estimate; their residuals are pooled.
        validation: motions that only judge. Without any, and with several for training, each of these is foreseen
            from the others in turn.
        settings: see :class:`Settings`.
        progress: called with generations done and best J so far.
        notes: warnings that come with the data, such as a bag that was never closed.

    Raises:
        TrajectoryError: a motion that is too short or has gaps.
        ExcitationError: a motion from which some parameters cannot be told.
    """
    settings = settings or Settings()
    regressions = [_regression(motion, settings) for motion in training]
    parts = [Quadratic.reduce(r.phi, r.y) for r in regressions]
    criterion = Quadratic.pool(parts)
    require_excitation(training, criterion)

    exact = criterion.minimum(settings.bounds)
    runs = None
    theta = exact
    if settings.optimizer == 'mde':
        optimizer = MDE(settings.bounds, settings.mde, runs=settings.runs, seed=settings.seed)
        runs = minimize(optimizer, criterion, progress)
        theta = runs.x[runs.best]
    free = ~settings.bounds.at_bound(theta, tolerance=1e-7)
    J, J_exact = float(criterion(theta)), float(criterion(exact))
    covariance = jackknife_covariance(regressions, theta, free)
    judged = _validate(validation, parts, theta if runs is None else runs.x, theta, settings)
    condition_number = criterion.condition_number()
    values = np.array([J]) if runs is None else runs.value
    level, warnings = judge(
        theta=theta,
        std_error=np.sqrt(np.diag(covariance)),
        free=free,
        bounds=settings.bounds,
        condition_number=condition_number,
        unexplained=J / float(criterion(np.zeros_like(theta))),
        foreseen=judged.J / J if judged is not None and J > 0 else None,
        reached=(_reached(values, J_exact), len(values)),
        notes=[*notes, *missing_samples([*training, *validation])],
    )
    return Identification(
        parameters=Parameters.from_vector(theta),
        covariance=covariance,
        settings=settings,
        J=J,
        J_exact=J_exact,
        exact=Parameters.from_vector(exact),
        runs=runs,
        validation=judged,
        condition_number=condition_number,
        residuals=criterion.count,
        level=level,
        warnings=warnings,
    )


def _reached(values: Array, exact: float) -> int:
    return int((values <= exact * (1 + REACHED)).sum())


def _regression(motion: Trajectory, settings: Settings) -> Regression:
    return energy_regression(motion.require_samples(), settings.sliding, settings.smoothing)


def _validate(
    validation: Sequence[Trajectory], parts: Sequence[Quadratic], x: Array, theta: Array, settings: Settings
) -> Validation | None:
    if validation:
        regressions = [_regression(motion, settings) for motion in validation]
        judge = Quadratic.pool([Quadratic.reduce(r.phi, r.y) for r in regressions])
        return Validation(float(judge(theta)), judge(np.atleast_2d(x)), 'on data that was not used for estimation')
    if len(parts) < 2:
        return None
    total = 0.0
    for left_out, part in enumerate(parts):
        others = Quadratic.pool([p for k, p in enumerate(parts) if k != left_out])
        total += float(part(others.minimum(settings.bounds))) * part.count
    J = total / sum(part.count for part in parts)
    return Validation(J, np.empty(0), 'each recording foreseen from the others')
