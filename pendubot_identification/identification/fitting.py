# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The estimator: composite innovations likelihood, then prediction error with it as prior, or an exact fit.

If the residual is at the quantization level, the rig is exact, and the last step is one filter on all samples. Else it
is the prediction error; but with an accepted unmodelled effect, the likelihood is the last step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.criteria.likelihood import (
    SHARED,
    FilterData,
    Likelihood,
    LikelihoodFit,
    LikelihoodSettings,
    bounded_step,
    fit,
)
from pendubot_identification.criteria.prediction_error import refine, state_scale
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.parameters import MODELS, NAMES, Bounds, Parameters, repaired
from pendubot_identification.model.simulation import substeps
from pendubot_identification.trajectories.motion import Motion, root_mean_square_torque
from pendubot_identification.trajectories.signals import choose_smoothing
from pendubot_identification.trajectories.trajectory import Trajectory

from .effects import DetectedEffect, EffectSettings, Problem, find_effects, vuong
from .estimate import Linear, Progress, linear
from .settings import Settings

GEARED = MODELS['geared']


@dataclass(frozen=True, slots=True)
class FittingSettings:
    """Settings of the minimisation of the likelihood, and limits of an exact rig.

    Attributes:
        shortest: shortest recording that is fitted [s].
        least_share: least fraction of P1, and of P2, in their sum at the start: a start on a bound cannot move.
        noise: torque noise at the start, averaged over 0.1 s, as a fraction of the effort.
        louder: factor of the initial noise after a filter has diverged.
        smaller: factor of P1 to P5 in a third attempt.
        held_step: sampling interval [s] above which held and measured torque differ by more than a delay.
        quiet: largest torque noise of an exact rig over 0.1 s over the effort, at shoulder and elbow: the geometric
            mean of the largest of simulated rigs, 6e-4 and 3e-3, and the least of real ones, .07 and .16.
        quantized: largest noise of the positions over their quantization.
        variance: largest mean of the squared innovations over their expected variances, in every recording.
        least: least unexplained fraction of the variance of the innovations that shows an effect: 1 - 1 / variance.
        fine: Runge-Kutta step [s] of the exact fit where a joint is slower than ``slow`` [rad/s].
        slow: six widths of the change of sign of dry friction [rad/s], within which short steps are needed.
        between: longest step of the exact fit [s] if, by the delay, the torque changes between samples, by more than a
            tenth of this: steps use the mean torque.
        search: duration of the excerpt [s] in which faults, hold and effects are searched; all data confirm effects.
    """

    shortest: float = 1.0
    least_share: float = 0.05
    noise: float = 0.1
    louder: float = 10.0
    smaller: float = 0.7
    held_step: float = 0.004
    quiet: tuple[float, float] = (6e-3, 2e-2)
    quantized: float = 1.15
    variance: float = 1.25
    least: float = 0.2
    fine: float = 0.0005
    slow: float = 0.3
    between: float = 0.001
    search: float = 150.0


SETTINGS = FittingSettings()


@dataclass(frozen=True, slots=True)
class TrainingData:
    """Prepared training recordings.

    Attributes:
        motions: the recordings with states and torques.
        smoothing: smoothing window of the states [s].
        hold: of the torque between samples: ``zero`` or ``linear``.
        scale: the states' standard deviations, shape (4,).
        settings: of the identification.
    """

    motions: tuple[Motion, ...]
    smoothing: float
    hold: str
    scale: Array
    settings: Settings

    @classmethod
    def prepare(cls, trajectories: Sequence[Trajectory], settings: Settings) -> TrainingData:
        """Select the smoothing, and prepare the recordings.

        Raises:
            TrajectoryError: all recordings are too short for the criteria.
        """
        longest, shortest = max(trajectories, key=lambda t: t.duration), SETTINGS.shortest
        if settings.criteria != ('energy',) and longest.duration < shortest:
            raise TrajectoryError(
                f'{longest.name}: {longest.duration:.3f} s are too short for the criteria weak and likelihood, which '
                f'need {shortest:g} s; choose a longer window, or the criterion energy alone'
            )
        smoothing = choose_smoothing(trajectories) if settings.smoothing is None else settings.smoothing
        hold = 'zero' if settings.hold == 'auto' else settings.hold
        motions = tuple(Motion.prepare(t, smoothing, hold) for t in trajectories)
        return cls(motions, smoothing, hold, state_scale(motions), settings)

    @property
    def searched(self) -> float:
        """The fraction of the recordings in which the hold and effects are searched."""
        return min(1.0, SETTINGS.search / sum(m.end - m.start for m in self.motions))

    def excerpt(self) -> TrainingData:
        """Return the fraction :attr:`searched` of every recording, from its middle."""
        share = self.searched
        return self if share == 1 else replace(self, motions=tuple(m.middle(share) for m in self.motions))

    def held(self, hold: str) -> TrainingData:
        """Return the data with another hold of the torque, ``zero`` or ``linear``."""
        motions = tuple(Motion.prepare(m.recorded, self.smoothing, hold) for m in self.motions)
        return replace(self, motions=motions, hold=hold)

    def linear(self, criterion: str, model: str) -> Linear:
        """Return a quadratic criterion with estimated delay and weights, from a cache."""
        key = criterion, model, self.hold, tuple(m.name for m in self.motions)
        return self.motions[0].once(key, lambda: linear(criterion, self.motions, model, self.settings))


@dataclass(frozen=True, slots=True)
class Composite:
    """The estimate from recordings of one rig, with the contribution of each block of time.

    Attributes:
        data: the fitted data, with the selected hold.
        model: the name of one of :data:`.parameters.MODELS`.
        theta: shape (14,).
        free: which parameters are estimated and not on a bound, shape (14,).
        delay: of the effort [s], and ``delay_std_error``; NaN where it was not estimated.
        exact: whether the residual is at the quantization level.
        effects: detected effects.
        information: of theta, with other unknowns eliminated, shape (14, 14).
        slopes: of each block of time at theta, shape (B, 14).
        informations: of each block of time, shape (B, 14, 14).
        filter_data: of the last filter.
        unexplained: the fraction of the innovations' variance that quantization does not explain, shape (2,).
        J: the likelihood per measurement.
        converged: whether the final fit converged.
        steps: of the optimisation, in words.
        offsets: of the positions [rad], shape (2,).
        rough: the fit of the shortest interval.
    """

    data: TrainingData
    model: str
    theta: Array
    free: Flags
    delay: float
    delay_std_error: float
    exact: bool
    effects: tuple[DetectedEffect, ...]
    information: Array
    slopes: Array
    informations: Array
    filter_data: FilterData
    unexplained: Array
    J: float
    converged: bool
    steps: tuple[str, ...]
    offsets: Array
    rough: Problem

    @property
    def difference(self) -> Array:
        """The difference of theta to the fit of the shortest interval, shape (14,); 0 if the rig is exact."""
        return np.zeros(GEARED) if self.exact else np.where(self.free, self.theta - self.rough.fit.x[:GEARED], 0.0)

    def without(self, blocks: Flags) -> Array:
        """Return theta without some blocks of time, shape (14,), by one scoring step of all others, within bounds."""
        rest = self.information - self.informations[blocks].sum(axis=0)
        box = self.data.settings.box('geared')
        bounds = Bounds(
            np.where(self.free, box.lower, self.theta), np.where(self.free, box.upper, self.theta), box.names
        )
        pull = -self.slopes[blocks].sum(axis=0)
        step, _ = bounded_step(
            rest, pull, 1e-6, bounds.lower - self.theta, bounds.upper - self.theta, bounds.lower < bounds.upper
        )
        return repaired(self.theta + step)


@dataclass(frozen=True, slots=True)
class Fits:
    """The fits of one model.

    Attributes:
        data: with the hold of the torque.
        rough: of the shortest interval.
        all_intervals: of all intervals.
        exact: of all samples; None if the residual is above the quantization level.
    """

    data: TrainingData
    rough: Problem
    all_intervals: Problem
    exact: Problem | None

    @classmethod
    def of(cls, data: TrainingData, rough: Problem, progress: Progress) -> Fits:
        """Continue from the fit of the shortest interval."""
        all_intervals = _all_levels(data, rough, progress)
        return cls(data, rough, all_intervals, _exact_fit(data, rough, all_intervals, progress))

    def completed(self, data: TrainingData, progress: Progress) -> Fits:
        """Return the fits of all data, from the fits of an excerpt; an exact rig needs no fit of all intervals."""
        if data.searched == 1:
            return self
        rough = _refit(data, self.rough, progress)
        if self.exact is not None and (exact := _exact_fit(data, rough, self.all_intervals, progress, self.exact)):
            return Fits(data, rough, self.all_intervals, exact)
        return Fits(data, rough, _refit(data, self.all_intervals, progress), None)

    @property
    def last(self) -> Problem:
        """The final fit."""
        return self.exact or self.all_intervals

    def surely_better(self, before: Fits, found: DetectedEffect, share: float = 1.0) -> bool:
        """Return whether an effect is significant; ``share``: the fitted fraction of the data, which scales z.

        It is if the rig is exact only with it. Otherwise Vuong's test decides, for an exact rig on all samples, for
        others on all intervals: short ones hardly distinguish a spring from gravity.
        """
        if (self.exact is None) is not (before.exact is None):
            return self.exact is not None
        if self.exact is None and not found.accepted:
            return False
        old, new = before.last, self.last
        if old.likelihood.levels != new.likelihood.levels:
            return new.likelihood.levels > old.likelihood.levels
        gains = old.fit.evaluation.costs - new.fit.evaluation.costs
        everywhere = bool((np.bincount(old.likelihood.filter_data.owner, gains) > 0).all())
        return everywhere and vuong(gains, 0.0) / share**0.5 > EffectSettings().sure


def fit_composite(data: TrainingData, progress: Progress, *, effects: bool = True) -> Composite:
    """Estimate parameters by the composite likelihood and the last step."""
    part = data.excerpt()
    begin = _first_fit(part, progress)
    part, begin = _best_hold(part, begin, progress)
    fits = Fits.of(part, begin, progress)
    data, found = _complete(data, part), list[DetectedEffect]()
    try:
        best = fits.completed(data, progress)
    except FloatingPointError:  # a filter diverges outside the excerpt
        best = Fits.of(data, _first_fit(data, progress), progress)
    steps = [
        f'innovations at {best.rough.interval:g} s: {begin.fit.iterations} scoring steps, J = {best.rough.fit.cost:.6g}'
    ]
    if effects:
        progress('searching for unmodelled effects', 0, 0, math.nan)
        best, found = _with_effects(best, fits, progress)
    steps += [f'together with {each.name} ({each.where})' for each in found if each.accepted]
    if best.data.hold == 'linear' and best.data.settings.hold == 'auto':
        steps.append(f'torque measured at its samples, not held: J = {best.rough.fit.cost:.6g}')
    all_intervals = best.all_intervals.fit
    steps.append(
        f'innovations at 0.05, 0.1 and 0.2 s: {all_intervals.iterations} scoring steps, J = {all_intervals.cost:.6g}'
    )
    answer = _composite(best, found)
    if best.exact is not None:
        steps.append(f'all samples: {best.exact.fit.iterations} scoring steps; residual at the quantization level')
    elif not any(each.accepted for each in found):
        progress('likelihood: prediction error', 0, 0, math.nan)
        answer = _refined(answer)
        steps.append('prediction errors after 0.1, 0.25 and 0.5 s, with the likelihood as prior')
    return replace(answer, steps=tuple(steps))


def _with_effects(best: Fits, part: Fits, progress: Progress) -> tuple[Fits, list[DetectedEffect]]:
    """Return the fits with the accepted effects, and the detected effects; the last one may be possible only.

    Effects are detected in an excerpt, and accepted if they are also significant in all data.
    """
    found, last = list[DetectedEffect](), part
    for each, problem in find_effects(part.rough, EffectSettings(share=best.data.searched)):
        accepted = each.accepted or _nearly_exact(part.data, problem)
        if accepted:
            try:
                extended = Fits.of(part.data, problem, progress)
                accepted = extended.surely_better(last, each, best.data.searched)
                complete = extended.completed(best.data, progress) if accepted else best
            except FloatingPointError:
                break
            accepted = accepted and complete.surely_better(best, each)
        # On an exact rig all samples have decided.
        if accepted or (best.exact is None and each.z > EffectSettings().possible):
            found.append(replace(each, accepted=accepted))
        if not accepted:
            break
        best, last = complete, extended
    if last is not part:
        held, rough = _best_hold(last.data, last.rough, progress)
        if held.hold != best.data.hold:
            best = Fits.of(held, rough, progress).completed(_complete(best.data, held), progress)
    return best, found


def _best_hold(data: TrainingData, rough: Problem, progress: Progress) -> tuple[TrainingData, Problem]:
    """Return the data and their fit with the likelier hold of the torque."""
    if data.settings.hold != 'auto' or max(m.interval for m in data.motions) <= SETTINGS.held_step:
        return data, rough
    other = data.held('linear' if data.hold == 'zero' else 'zero')
    x, at = rough.fit.x.copy(), rough.likelihood.shared
    x[14] += (0.5 if other.hold == 'zero' else -0.5) * np.median([m.interval for m in other.motions])
    x[at:] = np.maximum(x[at:], _first_noise(other, rough.likelihood.filter_data))
    try:
        tried = _refit(other, replace(rough, fit=replace(rough.fit, x=x)), progress)
    except FloatingPointError:  # the filter diverges with the other hold
        return data, rough
    return (other, tried) if tried.fit.cost < rough.fit.cost else (data, rough)


def _complete(data: TrainingData, part: TrainingData) -> TrainingData:
    """Return all data, with the hold that was selected for an excerpt."""
    if part.hold == data.hold:
        return data
    return part if data.searched == 1 else data.held(part.hold)


def _refit(data: TrainingData, near: Problem, progress: Progress) -> Problem:
    """Return a problem of the shortest interval fitted to other data."""
    if data.motions is near.likelihood.filter_data.motions:
        return near
    like = near.likelihood.of(FilterData.of(data.motions, near.likelihood.filter_data.settings))
    return replace(near, likelihood=like, fit=_fit(like, near.fit.x, near.lower, near.upper, progress))


def with_fitted_noise(motions: Sequence[Motion], theta: Array, delay: float, settings: Settings) -> Problem:
    """Return the fit of the shortest interval with given parameters: only the noise is fitted.

    Raises:
        TrajectoryError: no filter follows the motion.
    """
    data = TrainingData(tuple(motions), 0.0, 'zero', state_scale(motions), settings)
    filter_data = FilterData.of(motions, _shortest(_stable_step(data, theta)))
    lower, upper = _limits(data, filter_data)
    known = np.array([*theta, *np.zeros(GEARED - len(theta)), delay, 0.0, 0.0])
    lower[:SHARED], upper[:SHARED] = known, known
    like = Likelihood(filter_data)
    try:
        return Problem(like, fit(like, np.append(known, _first_noise(data, filter_data)), lower, upper), lower, upper)
    except FloatingPointError as error:
        raise TrajectoryError(
            f'{motions[0].name}: no filter follows this motion with these parameters; choose another window'
        ) from error


def _scale(data: TrainingData, theta: Array) -> Array:
    """Return the scale of the shared unknowns, for finite differences."""
    inertia, mass = max(theta[:2].sum(), 1e-9), max(theta[3:5].sum(), 1e-9)
    effort, speed = _effort(data).max(), max(float(data.scale[2:].max()), 1e-3)
    of = {'P1': inertia, 'P2': inertia, 'P3': inertia, 'P4': mass, 'P5': mass, 'J2': inertia, 'k1': 1.0, 'k2': 1.0}
    friction = {name: effort / speed if name[0] == 'b' else effort for name in NAMES if name not in of}
    return np.array([*((of | friction)[name] for name in NAMES), 0.01, 0.01, 0.01])


def _effort(data: TrainingData) -> Array:
    """Return the root mean square of both torques [N m]; without a motor, a tenth of the other one."""
    tau = root_mean_square_torque(data.motions)
    return np.asarray(np.maximum(tau, max(0.1 * tau.max(), 1e-9)))


def _box(settings: Settings, model: str) -> Bounds:
    """Return bounds of all of theta; parameters that are not in the model are fixed at 0."""
    box, inside = settings.box('geared'), np.arange(GEARED) < MODELS[model]
    return Bounds(np.where(inside, box.lower, 0.0), np.where(inside, box.upper, 0.0), box.names)


def _limits(data: TrainingData, filter_data: FilterData) -> tuple[Array, Array]:
    """Return bounds of theta, delay, offsets and noise; the noise of positions is at least their quantization."""
    box = _box(data.settings, 'geared' if data.settings.model == 'auto' else data.settings.model)
    low, high = data.settings.delays
    noise = np.log(filter_data.quantization) / 2
    levels, effort = len(filter_data.settings.intervals), np.log(_effort(data))
    return (
        np.concatenate([box.lower, [low, -0.1, -0.1], np.tile([*noise, *effort - 16], levels)]),
        np.concatenate([box.upper, [high, 0.1, 0.1], np.tile([*noise + 3, *effort + 2], levels)]),
    )


def _first_fit(data: TrainingData, progress: Progress) -> Problem:
    """Fit the shortest interval alone, from the first of the rough parameters with which a filter follows.

    Dry friction is stiff: if the result needs shorter steps than the filter had, the fit is repeated. Fast motions are
    predictable over shorter intervals only: they are halved until a filter follows.
    """
    starts, interval = list(_rough(data)), LikelihoodSettings().intervals[0]
    fine = max(_stable_step(data, theta) for theta, _ in starts)
    while True:
        settings = _shortest(fine, interval)
        found = next(filter(None, (_fit_from(data, *start, settings, progress) for start in starts)), None)
        if found is not None:
            used, fine = fine, _stable_step(data, found.fit.x[:GEARED])
            if fine >= used:
                return found
        elif interval > max(m.interval for m in data.motions):
            interval /= 2
        else:
            raise TrajectoryError(
                f'{data.motions[0].name}: no filter follows this motion from the rough parameters; check signs, units '
                'and stamps, or choose another part of the recording'
            )


def _stable_step(data: TrainingData, theta: Array) -> float:
    """Return the longest step [s] of the filter that is stable with the dry friction of theta."""
    step = LikelihoodSettings().step
    return step / substeps(Parameters.from_vector(theta), _effort(data), step)


def _shortest(fine: float, interval: float = LikelihoodSettings().intervals[0]) -> LikelihoodSettings:
    """Return the settings of the shortest interval, with steps of at most ``fine`` [s] near standstill."""
    return LikelihoodSettings(intervals=(interval,), fine=fine, slow=SETTINGS.slow)


def _fit_from(
    data: TrainingData, theta: Array, delay: float, settings: LikelihoodSettings, progress: Progress
) -> Problem | None:
    """Fit the shortest interval from rough parameters; None if the filter diverges with any noise."""
    filter_data = FilterData.of(data.motions, settings)
    lower, upper = _limits(data, filter_data)
    like, noise = Likelihood(filter_data, scale=_scale(data, theta)), _first_noise(data, filter_data)
    for noisy, small in ((1.0, 1.0), (SETTINGS.louder, 1.0), (SETTINGS.louder, SETTINGS.smaller)):
        begin = np.append(small * theta[:5], theta[5:])
        x = np.concatenate([begin, [delay, 0.0, 0.0], noise + np.log([1.0, 1.0, noisy, noisy])])
        try:
            return Problem(like, _fit(like, x, lower, upper, progress), lower, upper)
        except FloatingPointError:
            continue
    return None


def _rough(data: TrainingData) -> Iterator[tuple[Array, float]]:
    """Yield theta, shape (14,), and delay [s] of each start: from the settings, or by the weak criterion.

    With few samples, smoothed velocities resemble a delay: if no filter follows with it, the least delay is tried.
    Friction under load starts at 0: the weak criterion hardly distinguishes it from a smaller torque.
    """
    settings = data.settings
    none, model = settings.least_delay, 'rotor' if settings.model in ('auto', 'geared') else settings.model
    if settings.start is not None:
        answers = [(settings.start.vector('geared'), none)]
    else:
        weak = [data.linear('weak', model)]
        if abs(weak[0].delay - none) > max(m.interval for m in data.motions) / 2:
            weak.append(linear('weak', data.motions, model, replace(settings, delays=(none, none))))
        rest = np.zeros(GEARED - MODELS[model])
        answers = [(np.append(each.criterion.minimum(settings.box(model)), rest), each.delay) for each in weak]
    for theta, delay in answers:
        theta[:2] = np.maximum(theta[:2], SETTINGS.least_share * max(theta[:2].sum(), 1e-6))
        yield theta, delay


def _first_noise(data: TrainingData, filter_data: FilterData) -> Array:
    """Return the logarithms of the initial noise of positions and torques, shape (4,)."""
    torque = SETTINGS.noise * math.sqrt(0.1) * _effort(data)
    return np.log(np.append(1.5 * np.sqrt(filter_data.quantization), torque))


def _fit(like: Likelihood, x: Array, lower: Array, upper: Array, progress: Progress) -> LikelihoodFit:
    return fit(like, x, lower, upper, progress=lambda cost: progress('likelihood: scoring', 0, 0, cost))


def _all_levels(data: TrainingData, rough: Problem, progress: Progress) -> Problem:
    """Fit all intervals, from the fit of the shortest one, without the longest ones if a filter diverges."""
    intervals, settings = LikelihoodSettings().intervals, rough.likelihood.filter_data.settings
    while True:
        filter_data = FilterData.of(data.motions, replace(settings, intervals=intervals))
        like, at = rough.likelihood.of(filter_data), rough.likelihood.shared

        def wider(values: Array, at: int = at, count: int = len(intervals)) -> Array:
            return np.append(values[:at], np.tile(values[at:], count))

        x, lower, upper = wider(rough.fit.x), wider(rough.lower), wider(rough.upper)
        try:
            return Problem(like, _fit(like, x, lower, upper, progress), lower, upper)
        except FloatingPointError:
            if len(intervals) == 1:
                return rough
            intervals = intervals[:-1]


def torque_noise(data: TrainingData, problem: Problem) -> Array:
    """Return the torque noise at each of K intervals over the limit of an exact rig, shape (K, 2)."""
    noise = np.exp(problem.fit.x[problem.likelihood.shared :].reshape(-1, 4)[:, 2:])
    return np.asarray(noise / math.sqrt(0.1) / (np.array(SETTINGS.quiet) * _effort(data)))


def _nearly_exact(data: TrainingData, problem: Problem) -> bool:
    """Return whether the torque noise is so small that all samples should be fitted."""
    return bool((torque_noise(data, problem).min(axis=0) < 10).all())


def _exact_fit(
    data: TrainingData, rough: Problem, all_intervals: Problem, progress: Progress, near: Problem | None = None
) -> Problem | None:
    """Fit all samples by one Gaussian filter; None if the residual is above the quantization level.

    The start is the fit of all intervals, or the exact fit of an excerpt.
    """
    if not _nearly_exact(data, all_intervals):
        return None
    quiet = np.array(SETTINGS.quiet) * _effort(data)
    at = all_intervals.likelihood.shared
    interval = min(m.interval for m in data.motions)
    off = abs(math.remainder(all_intervals.fit.x[14], interval)) > SETTINGS.between / 10
    native = LikelihoodSettings(
        intervals=(interval / 2,),
        step=SETTINGS.between if off else LikelihoodSettings().step,
        freedom=math.inf,
        fine=SETTINGS.fine,
        slow=SETTINGS.slow,
        rest=-1.0,
    )
    filter_data = FilterData.of(data.motions, native)
    like = all_intervals.likelihood.of(filter_data)
    quantum = np.log(filter_data.quantization) / 2
    lower, upper = (np.append(each[:at], each[at : at + 4]) for each in (all_intervals.lower, all_intervals.upper))
    lower[at : at + 2] -= 1.0
    upper[at:] = [*quantum + math.log(SETTINGS.quantized), *np.log(math.sqrt(0.1) * quiet)]
    first = np.append(all_intervals.fit.x[:at], [*quantum, *all_intervals.fit.x[at:].reshape(-1, 4)[:, 2:].min(axis=0)])
    progress('likelihood: all samples', 0, 0, math.nan)
    try:
        found = fit(like, first if near is None else near.fit.x, lower, upper, 15, 0.02)
    except FloatingPointError:
        return None
    e, s = like.innovations(found.x)
    for rows in filter_data.rows:
        if not ((e[rows] ** 2 / s[rows]).mean(axis=0) < SETTINGS.variance).all():
            return None
    # Torque noise at its limit may be too small, unless quantization is larger.
    if (found.x[at:] > upper[at:] - 1e-6).any() and (unexplained(rough.likelihood, found.x) > SETTINGS.least).any():
        return None
    return _smallest(data, Problem(like, found, lower, upper))


def _smallest(data: TrainingData, problem: Problem) -> Problem:
    """Return the fit of the smallest model that explains exact recordings as well, by Schwarz's criterion."""
    if data.settings.model != 'auto':
        return problem
    worth = math.log(max(problem.likelihood.filter_data.measurements, 2)) / 2
    for size in sorted(set(MODELS.values()) - {GEARED}):
        dropped = np.flatnonzero(problem.fit.free[:GEARED] & (np.arange(GEARED) >= size))
        lower, upper = problem.lower.copy(), problem.upper.copy()
        lower[size:GEARED], upper[size:GEARED] = 0.0, 0.0
        x = problem.fit.x.copy()
        others = np.setdiff1d(np.flatnonzero(problem.fit.free), dropped)
        H = problem.fit.information
        # The minimum over the others if the dropped ones are fixed at 0.
        if dropped.size:
            x[others] += np.linalg.lstsq(
                H[np.ix_(others, others)], H[np.ix_(others, dropped)] @ x[dropped], rcond=1e-12
            )[0]
        x[size:GEARED] = 0.0
        x = repaired(np.clip(x, lower, upper))
        costs = float(problem.likelihood.costs(x).sum()) + problem.likelihood.prior(x)
        if not costs < problem.fit.cost + 40 * worth:
            continue
        try:
            found = fit(problem.likelihood, x, lower, upper, 10, 0.02)
        except FloatingPointError:
            continue
        if found.cost < problem.fit.cost + worth * max(dropped.size, 1):
            return Problem(problem.likelihood, found, lower, upper)
    return problem


def unexplained(likelihood: Likelihood, x: Array) -> Array:
    """Return the fraction of both joints' innovation variance that quantization does not explain, shape (2,)."""
    e, s = likelihood.innovations(x)
    # The weights reduce the first innovations, at which the speed is still unknown.
    weights = (likelihood.filter_data.weight[:, None] + 1e-12) / s
    variance = np.average(e**2, axis=0, weights=weights)
    return np.clip(1 - likelihood.filter_data.quantization / np.maximum(variance, 1e-300), 0.0, 1.0)


def _composite(fits: Fits, found: Sequence[DetectedEffect]) -> Composite:
    """Return the estimate by the final likelihood, with all unknowns but theta eliminated."""
    data, rough, problem = fits.data, fits.rough, fits.last
    like, solved = problem.likelihood, problem.fit
    H, free = solved.information, solved.free
    theta, rest = np.arange(GEARED), np.setdiff1d(np.flatnonzero(free), np.arange(GEARED))
    gain = H[np.ix_(theta, rest)] @ np.linalg.pinv(H[np.ix_(rest, rest)], hermitian=True)
    onto = np.zeros((GEARED, len(H)))
    onto[:, :GEARED], onto[:, rest] = np.eye(GEARED), -gain
    blocks = solved.evaluation
    inverse = np.zeros_like(H)
    inverse[np.ix_(free, free)] = np.linalg.pinv(H[np.ix_(free, free)], hermitian=True)
    moves = blocks.slopes @ inverse[:, 14]
    lower, upper = problem.lower, problem.upper
    size = int(np.flatnonzero(upper[:GEARED] > lower[:GEARED]).max(initial=0)) + 1
    model = next(name for name, count in MODELS.items() if count >= size)
    return Composite(
        data=data,
        model=model if data.settings.model == 'auto' else data.settings.model,
        theta=solved.x[:GEARED],
        free=free[:GEARED],
        delay=float(solved.x[14]),
        delay_std_error=math.sqrt(max(inverse[14, 14], float((moves**2).sum()))) if free[14] else math.nan,
        exact=fits.exact is not None,
        effects=_sized(found, solved.x),
        information=onto @ H @ onto.T,
        slopes=blocks.slopes @ onto.T,
        informations=onto @ blocks.informations @ onto.T,
        filter_data=like.filter_data,
        unexplained=unexplained(rough.likelihood, rough.fit.x),
        J=solved.cost / max(like.filter_data.measurements, 1),
        converged=solved.converged,
        steps=(),
        offsets=solved.x[15:17],
        rough=rough,
    )


def _sized(found: Sequence[DetectedEffect], x: Array) -> tuple[DetectedEffect, ...]:
    """Return the effects with the sizes that the last fit found."""
    ends = SHARED + np.cumsum([len(each.sizes) for each in found], dtype=int)
    return tuple(
        replace(each, sizes=x[end - len(each.sizes) : end]) if each.accepted else each
        for each, end in zip(found, ends, strict=True)
    )


def _refined(answer: Composite) -> Composite:
    """Return the estimate after the prediction error, with the likelihood as prior."""
    data, bounds = answer.data, _box(answer.data.settings, answer.model)
    pull = np.where(answer.free, 0.0, answer.slopes.sum(axis=0))
    try:
        better = refine(
            data.motions,
            answer.theta,
            answer.information,
            pull,
            answer.delay,
            answer.offsets,
            bounds,
            answer.filter_data,
        )
    except TrajectoryError:
        return answer
    margin = 1e-9 * (bounds.upper - bounds.lower)
    return replace(
        answer,
        theta=better.theta,
        free=(better.theta > bounds.lower + margin) & (better.theta < bounds.upper - margin),
        information=better.information,
        # The slope of the prior changes with theta.
        slopes=answer.slopes + np.einsum('bij,j->bi', answer.informations, better.theta - answer.theta) + better.slopes,
        informations=answer.informations + better.informations,
    )
