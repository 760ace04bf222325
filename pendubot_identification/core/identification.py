"""From motions to parameters: the criterion reduced, minimised, checked against its exact minimum, and judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .energy import Regression, energy_regression
from .errors import ExcitationError, ParameterError
from .level import Level
from .mde import MDE, MDESettings
from .optimizer import OptimizationResult, Progress, minimize
from .parameters import NAMES, UNITS, Bounds, Parameters, default_bounds
from .quadratic import Quadratic
from .signals import SMOOTHING
from .trajectory import Trajectory
from .uncertainty import jackknife_covariance

Array = NDArray[np.float64]

CRITERIA = ('energy',)
MODELS = ('viscous',)
OPTIMIZERS = ('mde', 'lsq')

#: A run has found the minimum when its J exceeds the exact one by no more than this fraction.
REACHED = 1e-6
#: Parameters to which the residuals respond this much less than to the strongest are not told by the motion.
SILENT = 1e-6
#: A condition number (columns scaled to one) beyond which small errors of the data become large ones of theta.
ILL_CONDITIONED = 1e3
#: Motion of either joint below this [rad] is noise.
STILL = 0.02


@dataclass(frozen=True, slots=True)
class Settings:
    """What is minimised, and how.

    Attributes:
        criterion: ``energy``, the paper's.
        model: ``viscous``, the paper's seven parameters.
        optimizer: ``mde``, or ``lsq``: the exact bounded least-squares answer alone.
        sliding: length [s] of the energy balance's sliding window; None: cumulative.
        smoothing: the differentiator's window [s].
        mde: population, generations and the rest.
        runs: independent runs of MDE.
        seed: of its random numbers.
        bounds: the search box.

    Raises:
        ParameterError: a name that is not known, or a number that makes no sense.
    """

    criterion: str = 'energy'
    model: str = 'viscous'
    optimizer: str = 'mde'
    sliding: float | None = None
    smoothing: float = SMOOTHING
    mde: MDESettings = field(default_factory=MDESettings)
    runs: int = 10
    seed: int = 1
    bounds: Bounds = field(default_factory=default_bounds)

    def __post_init__(self) -> None:
        for kind, chosen, known in (
            ('criterion', self.criterion, CRITERIA),
            ('model', self.model, MODELS),
            ('optimizer', self.optimizer, OPTIMIZERS),
        ):
            if chosen not in known:
                raise ParameterError(f'there is no {kind} {chosen!r}; choose one of {", ".join(known)}')
        if self.sliding is not None and not (np.isfinite(self.sliding) and self.sliding > 0):
            raise ParameterError(f'the sliding window is {self.sliding:g} s; a time above 0 is expected')
        if not (np.isfinite(self.smoothing) and self.smoothing >= 0):
            raise ParameterError(f'the smoothing window is {self.smoothing:g} s; 0 or a time above 0 is expected')


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
        return int((self.J_runs <= self.J_exact * (1 + REACHED)).sum())


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
    _require_excitation(training, criterion)

    exact = criterion.minimum(settings.bounds)
    runs = None
    theta = exact
    if settings.optimizer == 'mde':
        optimizer = MDE(settings.bounds, settings.mde, runs=settings.runs, seed=settings.seed)
        runs = minimize(optimizer, criterion, progress)
        theta = runs.x[runs.best]
    free = ~settings.bounds.at_bound(theta, tolerance=1e-7)
    result = Identification(
        parameters=Parameters.from_vector(theta),
        covariance=jackknife_covariance(regressions, theta, free),
        settings=settings,
        J=float(criterion(theta)),
        J_exact=float(criterion(exact)),
        exact=Parameters.from_vector(exact),
        runs=runs,
        validation=_validate(validation, parts, theta if runs is None else runs.x, theta, settings),
        condition_number=criterion.condition_number(),
        residuals=criterion.count,
        level=Level.OK,
        warnings=(),
    )
    return _judged(result, free, notes)


def _regression(motion: Trajectory, settings: Settings) -> Regression:
    return energy_regression(motion.require_samples(), settings.sliding, settings.smoothing)


def _require_excitation(training: Sequence[Trajectory], criterion: Quadratic) -> None:
    moved = np.max([np.ptp(motion.q, axis=0) for motion in training], axis=0)
    names = ', '.join(motion.name for motion in training)
    if (moved < STILL).all():
        raise ExcitationError(
            f'{names}: the joints moved by only {moved[0]:.3g} and {moved[1]:.3g} rad, so none of {", ".join(NAMES)} '
            'can be told; excite the rig and record again, or choose a window in which it moves'
        )
    silent = criterion.undetermined(SILENT)
    if silent.any():
        still = [
            f'the {joint} moved by only {m:.3g} rad'
            for joint, m in zip(('shoulder', 'elbow'), moved, strict=True)
            if m < STILL
        ]
        raise ExcitationError(
            f'{names}: {", ".join(np.array(NAMES)[silent])} cannot be told apart from this motion'
            f'{" (" + still[0] + ")" if still else ""}; excite both joints at changing speeds, or choose another window'
        )


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


def _judged(result: Identification, free: NDArray[np.bool_], notes: Sequence[str]) -> Identification:
    theta, error = result.parameters.vector(), result.std_error
    unphysical = result.parameters.unphysical()
    warnings = [f'not physical: {problem}' for problem in unphysical] + list(notes)
    if result.condition_number > ILL_CONDITIONED:
        warnings.append(
            f'ill-conditioned: condition number {result.condition_number:.3g} (above {ILL_CONDITIONED:g}); this motion '
            'hardly tells some parameters apart: excite both joints more'
        )
    bounds = result.settings.bounds
    for k in np.flatnonzero(~free):
        bound = min(bounds.lower[k], bounds.upper[k], key=lambda side: abs(side - theta[k]))
        warnings.append(f'{NAMES[k]} lies on its bound {bound:g} {UNITS[k]}: the data ask for a value beyond')
    poor = [NAMES[k] for k in np.flatnonzero(free) if error[k] > 0.5 * abs(theta[k])]
    if poor:
        warnings.append(f'poorly determined: the standard error of {", ".join(poor)} exceeds half the value')
    if result.runs is not None and result.runs_at_minimum < len(result.J_runs):
        warnings.append(
            f'only {result.runs_at_minimum} of {len(result.J_runs)} runs reached the exact minimum of J; give more '
            'generations or a larger population'
        )
    if result.validation is not None and result.validation.J > 10 * result.J:
        warnings.append(
            f'J on validation is {result.validation.J / result.J:.0f} times J on training: these parameters do not '
            'foresee data that they have not seen'
        )
    level = Level.ERROR if unphysical else Level.WARN if warnings else Level.OK
    return replace(result, level=level, warnings=tuple(warnings))
