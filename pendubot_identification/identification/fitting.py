# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Prepared training recordings, and the fits of a model to them: quadratic criteria, and the likelihood's stages."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.energy import Regression, energy_regression
from pendubot_identification.criteria.likelihood import (
    FilterData,
    Likelihood,
    LikelihoodFit,
    LikelihoodSettings,
    fit,
    quantization,
)
from pendubot_identification.criteria.prediction_error import state_scale
from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.criteria.weak import estimate_delay, residual_weights, weak_regression
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model.parameters import MODELS, NAMES, Bounds, Parameters, repaired
from pendubot_identification.model.simulation import substeps
from pendubot_identification.optimizers.mde import mde
from pendubot_identification.trajectories.motion import Motion, root_mean_square_torque
from pendubot_identification.trajectories.signals import SMOOTHING, choose_smoothing
from pendubot_identification.trajectories.trajectory import Trajectory

from .estimate import REACHED, Effort, Estimate, Progress, correlations, regression_covariance
from .settings import Settings

GEARED = MODELS['geared']


@dataclass(frozen=True, slots=True)
class FittingSettings:
    """Settings of the minimisation of the likelihood, and limits of an exact rig."""

    shortest: float = 1.0  #: shortest recording that is fitted [s].
    #: least fraction of P1, and of P2, in their sum at the start: a start on a bound cannot move.
    least_share: float = 0.05
    noise: float = 0.1  #: torque noise at the start, averaged over 0.1 s, as a fraction of the effort.
    #: largest standard deviation of the positions' noise [rad], unless 20 times their quantization is more.
    noisiest: float = 0.02
    louder: float = 10.0  #: factor of the initial noise after a filter has diverged.
    smaller: float = 0.7  #: factor of P1 to P5 in a third attempt.
    held_step: float = 0.004  #: sampling interval [s] above which held and measured torque differ by more than a delay.
    #: largest torque noise of an exact rig over 0.1 s over the effort, at shoulder and elbow (docs/method.md).
    quiet: tuple[float, float] = (6e-3, 2e-2)
    quantized: float = 1.15  #: largest noise of the positions over their quantization.
    #: largest mean of the squared innovations over the quantization, in every recording.
    variance: float = 1.25
    #: least unexplained fraction of the variance of the innovations that shows an effect: 1 - 1 / variance.
    least: float = 0.2
    fine: float = 0.0005  #: Runge-Kutta step of the exact fit where a joint is slow or reverses [s].
    #: duration of the excerpt [s] in which faults, hold and effects are searched; all data confirm effects.
    search: float = 150.0


SETTINGS = FittingSettings()


@dataclass(frozen=True, slots=True)
class TrainingData:
    """Prepared training recordings."""

    motions: tuple[Motion, ...]  #: the recordings with states and torques.
    smoothing: float  #: smoothing window of the states [s].
    hold: str  #: of the torque between samples: ``zero`` or ``linear``.
    scale: Array  #: the states' standard deviations, shape (4,).
    settings: Settings  #: of the identification.

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
                f'need {shortest:g} s; record for longer, or take the complete recording by @0:'
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
        """Return the fraction :attr:`searched` of every recording, from its middle, but not less than a fit needs."""
        if self.searched == 1:
            return self
        shares = [min(1.0, max(self.searched, SETTINGS.shortest / (m.end - m.start))) for m in self.motions]
        return replace(self, motions=tuple(m.middle(share) for m, share in zip(self.motions, shares, strict=True)))

    @property
    def effort(self) -> Array:
        """The root mean square of both torques [N m]; without a motor, a tenth of the other one."""
        tau = root_mean_square_torque(self.motions)
        return np.asarray(np.maximum(tau, max(0.1 * tau.max(), 1e-9)))

    def held(self, hold: str) -> TrainingData:
        """Return the data with a hold of the torque, ``zero`` or ``linear``."""
        if hold == self.hold:
            return self
        motions = tuple(Motion.prepare(m.recorded, self.smoothing, hold) for m in self.motions)
        return replace(self, motions=motions, hold=hold)

    def linear(self, criterion: str, model: str) -> Linear:
        """Return a quadratic criterion with estimated delay and weights, from a cache."""
        key = criterion, model, self.hold, tuple(m.name for m in self.motions)
        return self.motions[0].once(key, lambda: linear(criterion, self.motions, model, self.settings))


class Linear(NamedTuple):
    """A quadratic criterion of recordings."""

    residuals: list[Regression]  #: of each recording.
    criterion: Quadratic  #: pooled over the recordings.
    delay: float  #: of the effort [s].
    weights: Array  #: of the three weak-form residuals, shape (3,); empty for ``energy``.


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
    name: str, model: str, data: TrainingData, validation: Sequence[Motion], progress: Progress
) -> Estimate:
    """Minimise a quadratic criterion, by MDE unless the optimizer is ``lsq``, and compare the exact minimum."""
    settings, problem = data.settings, data.linear(name, model)
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
    J_validation = linear(name, validation, model, settings, like=problem).criterion if validation else None
    free, estimated = ~bounds.at_bound(theta, tolerance=1e-7), bounds.present & ~bounds.fixed
    covariance, std_error, freedom, method = regression_covariance(problem.residuals, theta, free)
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
        effort=Effort(data.hold if name == 'weak' else 'zero', problem.delay),
        J=J,
        residuals=criterion.count,
        condition_number=criterion.condition_number(estimated),
        converged=True,
        steps=(step,),
        unexplained=J / max(J_zero, np.finfo(float).tiny),
        J_exact=J_exact,
        runs=runs,
        J_validation=np.nan if J_validation is None else float(J_validation(theta)),
        J_validation_runs=np.empty(0) if J_validation is None or runs is None else J_validation(repaired(runs.x)),
        absent=bounds.absent,
        fixed=bounds.fixed,
    )


def refit(data: TrainingData, near: LikelihoodFit, x: Array, progress: Progress) -> LikelihoodFit:
    """Return the fit of other data at the same intervals, from x."""
    like = near.likelihood.of(FilterData.of(data.motions, near.likelihood.filter_data.settings))
    return _fit(like, x, progress)


def with_given_parameters(motions: Sequence[Motion], theta: Array, delay: float, settings: Settings) -> LikelihoodFit:
    """Return the fit of the shortest interval with given parameters: only zeros and noise are fitted.

    Raises:
        TrajectoryError: no filter follows the motion.
    """
    data = TrainingData(tuple(motions), 0.0, 'zero', state_scale(motions), settings)
    known = np.concatenate([theta, np.zeros(GEARED - len(theta)), [delay]])
    like = _likelihood(data, _shortest(_stable_step(data, theta)), known[:GEARED])
    lower, upper = (np.append(known, bound[like.shared :]) for bound in (like.lower, like.upper))
    try:
        return fit(replace(like, lower=lower, upper=upper), _start(data, known[:GEARED], delay))
    except FloatingPointError as error:
        raise TrajectoryError(
            f'{motions[0].name}: no filter follows this motion with these parameters; choose another window'
        ) from error


def theta_box(settings: Settings, model: str) -> Bounds:
    """Return bounds of all of theta; parameters that are not in the model are fixed at 0."""
    return settings.box('geared').without(NAMES[MODELS[model] :])


def _likelihood(data: TrainingData, settings: LikelihoodSettings, theta: Array) -> Likelihood:
    """Return the likelihood at one interval, scaled for theta; positions are at least as noisy as quantized."""
    filter_data = FilterData.of(data.motions, settings)
    box = theta_box(data.settings, 'geared' if data.settings.model == 'auto' else data.settings.model)
    low, high = data.settings.delays
    noise, effort = np.log(filter_data.quantization) / 2, np.log(data.effort)
    zeros = np.full(2 * len(data.motions), 10 * settings.offset)
    lower = np.concatenate([box.lower, [low], -zeros, noise, effort - 16])
    loudest = np.maximum(noise + 3, math.log(SETTINGS.noisiest))
    upper = np.concatenate([box.upper, [high], zeros, loudest, effort + 2])
    inertia, mass = max(theta[:2].sum(), 1e-9), max(theta[3:5].sum(), 1e-9)
    torque, speed = data.effort.max(), max(float(data.scale[2:].max()), 1e-3)
    of = {'P1': inertia, 'P2': inertia, 'P3': inertia, 'P4': mass, 'P5': mass, 'J2': inertia, 'k1': 1.0, 'k2': 1.0}
    friction = {name: torque / speed if name[0] == 'b' else torque for name in NAMES if name not in of}
    scale = np.array([*((of | friction)[name] for name in NAMES), 0.01])
    return Likelihood(filter_data, lower, upper, scale)


def first_fit(data: TrainingData, progress: Progress) -> LikelihoodFit:
    """Fit the shortest interval alone, from the first of the rough parameters with which a filter follows.

    Dry friction is stiff: if the result needs shorter steps than the filter had, the fit is repeated. Fast motions are
    predictable over shorter intervals only: they are halved until a filter follows.
    """
    starts, interval = list(_rough(data)), LikelihoodSettings().intervals[0]
    fine = max(_stable_step(data, x[:GEARED]) for x in starts)
    while True:
        settings = _shortest(fine, interval)
        found = next(filter(None, (_fit_from(data, x, settings, progress) for x in starts)), None)
        if found is not None:
            used, fine = fine, _stable_step(data, found.x[:GEARED])
            if fine >= used:
                return found
            starts.insert(0, found.x)
        elif interval > max(m.interval for m in data.motions):
            interval /= 2
        else:
            name, given = data.motions[0].name, data.settings.start is not None
            raise TrajectoryError(
                f'{name}: no filter follows this motion from the parameters of start; leave it out, or give another one'
                if given
                else f'{name}: no filter follows this motion from the rough parameters; check signs, units and stamps, '
                'or choose another part of the recording'
            )


def _stable_step(data: TrainingData, theta: Array) -> float:
    """Return the longest step [s] of the filter that is stable with the dry friction of theta."""
    step = LikelihoodSettings().fine
    return step / substeps(Parameters.from_vector(theta), data.effort, step)


def _shortest(fine: float, interval: float = LikelihoodSettings().intervals[0]) -> LikelihoodSettings:
    """Return the settings of the shortest interval, with steps of at most ``fine`` [s] near standstill."""
    return LikelihoodSettings(intervals=(interval,), fine=fine)


def _fit_from(data: TrainingData, x: Array, settings: LikelihoodSettings, progress: Progress) -> LikelihoodFit | None:
    """Fit the shortest interval from x; None if the filter diverges with any noise."""
    like = _likelihood(data, settings, x[:GEARED])
    for noisy, small in ((1.0, 1.0), (SETTINGS.louder, 1.0), (SETTINGS.louder, SETTINGS.smaller)):
        begin = x.copy()
        begin[:5] *= small
        begin[-2:] += math.log(noisy)
        with contextlib.suppress(FloatingPointError):
            return _fit(like, begin, progress)
    return None


def _rough(data: TrainingData) -> Iterator[Array]:
    """Yield the unknowns of each start: from the settings, or by the weak criterion.

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
        yield _start(data, theta, delay)


def _start(data: TrainingData, theta: Array, delay: float) -> Array:
    """Return initial unknowns of the shortest interval, without errors of zeros, from theta and delay [s]."""
    return np.concatenate([theta, [delay], np.zeros(2 * len(data.motions)), first_noise(data)])


def first_noise(data: TrainingData) -> Array:
    """Return the logarithms of the initial noise of positions and torques, shape (4,)."""
    torque = SETTINGS.noise * math.sqrt(0.1) * data.effort
    return np.log(np.append(1.5 * np.sqrt(quantization(data.motions)), torque))


def _fit(like: Likelihood, x: Array, progress: Progress) -> LikelihoodFit:
    return fit(like, x, progress=lambda cost: progress('likelihood: scoring', 0, 0, cost))


def fit_intervals(data: TrainingData, rough: LikelihoodFit, progress: Progress) -> LikelihoodFit:
    """Fit all intervals, from the fit of the shortest one, without the longest ones if a filter diverges."""
    for levels in (3, 2, 1):
        chosen = replace(rough.likelihood.filter_data.settings, intervals=LikelihoodSettings().intervals[:levels])
        like = rough.likelihood.of(FilterData.of(data.motions, chosen))
        with contextlib.suppress(FloatingPointError):
            return _fit(like, rough.likelihood.widened(rough.x, levels), progress)
    return rough


def torque_noise(data: TrainingData, fitted: LikelihoodFit) -> Array:
    """Return the torque noise at each of K intervals over the limit of an exact rig, shape (K, 2)."""
    noise = np.exp(fitted.x[fitted.likelihood.before_noise :].reshape(-1, 4)[:, 2:])
    return np.asarray(noise / math.sqrt(0.1) / (np.array(SETTINGS.quiet) * data.effort))


def nearly_exact(data: TrainingData, fitted: LikelihoodFit) -> bool:
    """Return whether the torque noise is so small that all samples should be fitted."""
    return bool((torque_noise(data, fitted).min(axis=0) < 10).all())


def fit_all_samples(
    data: TrainingData,
    rough: LikelihoodFit,
    all_intervals: LikelihoodFit,
    progress: Progress,
    near: LikelihoodFit | None = None,
) -> LikelihoodFit | None:
    """Fit all samples by one Gaussian filter, with the smallest model that explains them as well.

    None if the residual is above the quantization level. ``near``: the exact fit of an excerpt, a better start.
    """
    if not nearly_exact(data, all_intervals):
        return None
    before, interval = all_intervals.likelihood, min(m.interval for m in data.motions)
    at = before.before_noise
    native = LikelihoodSettings(
        intervals=(interval / 2,),
        freedom=1e9,
        fine=SETTINGS.fine,
        rest=-1.0,
    )
    # By the delay, torques before and after the recordings act at their ends.
    late = data.excerpt().linear('weak', 'rotor').delay
    motions = [m.part(m.start + max(late, 0.0), m.end + min(late, 0.0)) for m in data.motions]
    filter_data = FilterData.of(motions, native)
    quantum = np.log(filter_data.quantization) / 2
    loudest = np.log(math.sqrt(0.1) * np.array(SETTINGS.quiet) * data.effort)
    noise = all_intervals.x[at:].reshape(-1, 4)[:, 2:].min(axis=0)
    lower = np.concatenate([before.lower[:at], before.lower[at : at + 2] - 1.0, before.lower[at + 2 : at + 4]])
    upper = np.concatenate([before.upper[:at], quantum + math.log(SETTINGS.quantized), loudest])
    like = Likelihood(filter_data, lower, upper, before.scale, before.effects)
    progress('likelihood: all samples', 0, 0, math.nan)
    try:
        first = np.concatenate([all_intervals.x[:at], quantum, noise]) if near is None else near.x
        found = fit(like, first, 15)
    except FloatingPointError:
        return None
    if _noisier(filter_data, *like.innovations(found.x)):
        return None
    # Torque noise at its limit may be too small, unless quantization is larger.
    if (found.x[at:] > upper[at:] - 1e-6).any() and (unexplained(rough.likelihood, found.x) > SETTINGS.least).any():
        return None
    return found if data.settings.model != 'auto' else _smallest(found)


def _noisier(filter_data: FilterData, e: Array, s: Array) -> bool:
    """Return whether squared innovations significantly exceed the quantization, in any recording and joint.

    The weights are the inverse variances of the innovations: the speed is unknown at the first ones. The standard error
    is from blocks of time: few samples with correlated quantization vary by a third.
    """
    for each in filter_data.series:
        ratios, block = e[each.rows] ** 2 / s[each.rows], filter_data.block[each.rows]
        quantization = (filter_data.quantization / s[each.rows]).mean(axis=0)
        means = np.array([ratios[block == number].mean(axis=0) for number in np.unique(block)])
        error = means.std(axis=0) / math.sqrt(max(len(means) - 1, 1))
        if (ratios.mean(axis=0) - NORMAL_95 * error >= SETTINGS.variance * quantization).any():
            return True
    return False


def _smallest(fitted: LikelihoodFit) -> LikelihoodFit:
    """Return the fit of the smallest model that explains exact recordings as well, by Schwarz's criterion.

    Correlated quantization overstates the information: the effective number of parameters counts (Gao and Song 2010).
    """
    like, H, free = fitted.likelihood, fitted.evaluation.information, np.flatnonzero(fitted.free)
    slopes = fitted.evaluation.slopes[:, free]
    effective = np.vdot(slopes, slopes @ np.linalg.pinv(H[np.ix_(free, free)], hermitian=True))
    worth = max(effective / max(free.size, 1), 1.0) * math.log(max(like.filter_data.measurements, 2)) / 2
    for size in sorted(set(MODELS.values()) - {GEARED}):
        kept = (np.arange(len(H)) < size) | (np.arange(len(H)) >= GEARED)
        smaller, x = replace(like, lower=like.lower * kept, upper=like.upper * kept), fitted.x.copy()
        dropped, others = free[~kept[free]], free[kept[free]]
        # The minimum over the others if the dropped ones are fixed at 0.
        pull = H[np.ix_(others, dropped)] @ x[dropped]
        x[others] += np.linalg.lstsq(H[np.ix_(others, others)], pull, rcond=1e-12)[0]
        x = repaired(np.clip(x, smaller.lower, smaller.upper))
        if not float(smaller.costs(x).sum()) + smaller.prior(x) < fitted.evaluation.cost + 40 * worth:
            continue
        with contextlib.suppress(FloatingPointError):
            found = fit(smaller, x, 10)
            if found.evaluation.cost < fitted.evaluation.cost + worth * max(dropped.size, 1):
                return found
    return fitted


def unexplained(likelihood: Likelihood, x: Array) -> Array:
    """Return the fraction of both joints' innovation variance that quantization does not explain, shape (2,)."""
    e, s = likelihood.innovations(x)
    # The weights reduce the first innovations, at which the speed is still unknown.
    weights = (likelihood.filter_data.weight[:, None] + 1e-12) / s
    variance = np.average(e**2, axis=0, weights=weights)
    return np.clip(1 - likelihood.filter_data.quantization / np.maximum(variance, 1e-300), 0.0, 1.0)
