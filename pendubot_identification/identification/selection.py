# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The estimate by the likelihood: the selection of hold, effects and model, and the last step.

If the residual is at the quantization level, the rig is exact, and the last step is one filter on all samples. Else it
is the prediction error with the likelihood as prior; but with an accepted unmodelled effect, the likelihood is the last
step.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.criteria.likelihood import SHARED, FilterData, LikelihoodFit, bounded_step
from pendubot_identification.criteria.prediction_error import refine
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model.parameters import MODELS, repaired

from .conventions import Fault, corrected_conversion, sound
from .effects import DetectedEffect, EffectSettings, find_effects, vuong
from .estimate import Effort, Estimate, Progress, Zeros, correlations, influence_covariance, scaled_condition_number
from .fitting import (
    GEARED,
    SETTINGS,
    TrainingData,
    first_fit,
    first_noise,
    fit_all_samples,
    fit_intervals,
    nearly_exact,
    refit,
    theta_box,
    unexplained,
)


@dataclass(frozen=True, slots=True)
class Fits:
    """The fits of one model."""

    data: TrainingData  #: with the hold of the torque.
    rough: LikelihoodFit  #: of the shortest interval.
    all_intervals: LikelihoodFit  #: of all intervals.
    exact: LikelihoodFit | None  #: of all samples; None if the residual is above the quantization level.

    @classmethod
    def of(cls, data: TrainingData, rough: LikelihoodFit, progress: Progress) -> Fits:
        """Continue from the fit of the shortest interval."""
        all_intervals = fit_intervals(data, rough, progress)
        return cls(data, rough, all_intervals, fit_all_samples(data, rough, all_intervals, progress))

    def completed(self, data: TrainingData, progress: Progress) -> Fits:
        """Return the fits of all data, from the fits of an excerpt; an exact rig needs no fit of all intervals."""
        if data.searched == 1:
            return self
        data = data.held(self.data.hold)
        rough = refit(data, self.rough, self.rough.x, progress)
        if self.exact is not None and (exact := fit_all_samples(data, rough, self.all_intervals, progress, self.exact)):
            return Fits(data, rough, self.all_intervals, exact)
        return Fits(data, rough, refit(data, self.all_intervals, self.all_intervals.x, progress), None)

    @property
    def last(self) -> LikelihoodFit:
        """The final fit."""
        return self.exact or self.all_intervals

    def surely_better(self, before: Fits, found: DetectedEffect, share: float = 1.0) -> bool:
        """Return whether an effect is significant; ``share``: the fitted fraction of the data, which scales z.

        It is if the rig is exact only with it. Otherwise Vuong's test decides, for an exact rig on all samples, for
        others on all intervals: short ones hardly distinguish a spring from gravity. A size on its bound shows that the
        effect stands for another one.
        """
        if not self.last.free[SHARED : self.last.likelihood.shared].all():
            return False
        if (self.exact is None) is not (before.exact is None):
            return self.exact is not None
        if self.exact is None and not found.accepted:
            return False
        old, new = before.last, self.last
        if old.likelihood.levels != new.likelihood.levels:
            return new.likelihood.levels > old.likelihood.levels
        gains = old.evaluation.costs - new.evaluation.costs
        everywhere = bool((np.bincount(old.likelihood.filter_data.owner, gains) > 0).all())
        return everywhere and vuong(gains, 0.0) / share**0.5 > EffectSettings().sure


@dataclass(frozen=True, slots=True)
class Composite(Fits):
    """The estimate from recordings of one rig, with the contribution of each block of time."""

    model: str  #: the name of one of :data:`.parameters.MODELS`.
    effects: tuple[DetectedEffect, ...]  #: detected effects.
    theta: Array  #: shape (14,).
    free: Flags  #: which parameters are estimated and not on a bound, shape (14,).
    information: Array  #: of theta, with other unknowns eliminated, shape (14, 14).
    slopes: Array  #: of each block of time at theta, shape (B, 14).
    informations: Array  #: of each block of time, shape (B, 14, 14).
    unexplained: Array  #: the fraction of the innovations' variance that quantization does not explain, shape (2,).
    steps: tuple[str, ...]  #: of the optimisation, in words.

    @classmethod
    def after(cls, fits: Fits, found: Sequence[DetectedEffect], steps: Sequence[str]) -> Composite:
        """Return the estimate by the final likelihood, with all unknowns but theta eliminated."""
        last, settings, rough = fits.last, fits.data.settings, fits.rough
        H, theta = last.evaluation.information, np.arange(GEARED)
        rest = np.setdiff1d(np.flatnonzero(last.free), theta)
        onto = np.zeros((GEARED, len(H)))
        onto[:, :GEARED] = np.eye(GEARED)
        onto[:, rest] = -H[np.ix_(theta, rest)] @ np.linalg.pinv(H[np.ix_(rest, rest)], hermitian=True)
        owner, informations = last.likelihood.filter_data.owner, last.evaluation.informations
        parts = [onto[:, last.likelihood.of_recording(k)] for k in owner]
        size = int(np.flatnonzero(last.likelihood.estimated[:GEARED]).max(initial=0)) + 1
        smallest = next(name for name, count in MODELS.items() if count >= size)
        return cls(
            *(fits.data, fits.rough, fits.all_intervals, fits.exact),
            model=smallest if settings.model == 'auto' else settings.model,
            effects=_sized(found, last.x),
            theta=last.x[:GEARED],
            free=last.free[:GEARED],
            information=onto @ H @ onto.T,
            slopes=last.evaluation.slopes @ onto.T,
            informations=np.array([part @ each @ part.T for part, each in zip(parts, informations, strict=True)]),
            unexplained=unexplained(rough.likelihood, rough.x),
            steps=tuple(steps),
        )

    @property
    def delay(self) -> float:
        """The delay of the effort [s]."""
        return float(self.last.x[14])

    @property
    def offsets(self) -> Array:
        """The offsets of the positions in each recording [rad], shape (R, 2)."""
        return self.last.likelihood.offsets(self.last.x)

    @property
    def filter_data(self) -> FilterData:
        """The inputs of the last filter, with the blocks of time."""
        return self.last.likelihood.filter_data

    def estimate(self) -> Estimate:
        """Return the estimate with its uncertainty."""
        last, size, settings = self.last, MODELS[self.model], self.data.settings
        bounds, free, information = settings.box(self.model), self.free[:size], self.information[:size, :size]
        # An unmodelled effect biases estimates by short and by long intervals differently.
        apart = np.where(free & (self.exact is None), self.theta[:size] - self.rough.x[:size], 0.0)
        owner, measurements = self.filter_data.owner, self.filter_data.measurements
        covariance, std_error, freedom, words = influence_covariance(
            *(information, self.slopes[:, :size], self.informations[:, :size, :size], owner, free, apart),
            exact=self.exact is not None,
        )
        delay_error = math.nan
        if last.free[14]:
            estimated, H = np.ix_(last.free, last.free), last.evaluation.information
            inverse = np.zeros_like(H)
            inverse[estimated] = np.linalg.pinv(H[estimated], hermitian=True)
            moves = last.evaluation.slopes @ inverse[:, 14]
            delay_error = math.sqrt(max(inverse[14, 14], float((moves**2).sum())))
        return Estimate(
            criterion='likelihood',
            model=self.model,
            theta=self.theta[:size],
            free=free,
            covariance=covariance,
            correlation=correlations(information, free),
            std_error=np.where(bounds.fixed, 0.0, np.where(bounds.present, std_error, math.nan)),
            freedom=freedom,
            uncertainty=words,
            effort=Effort(self.data.hold, self.delay, delay_error),
            J=last.evaluation.cost * last.likelihood.levels / max(measurements, 1),
            residuals=2 * measurements,
            condition_number=scaled_condition_number(information, free),
            converged=last.converged,
            steps=self.steps,
            exact=self.exact is not None,
            absent=bounds.absent,
            fixed=bounds.fixed,
        )

    def without(self, blocks: Flags) -> Array:
        """Return theta without some blocks of time, shape (14,), by one scoring step of all others, within bounds."""
        rest = self.information - self.informations[blocks].sum(axis=0)
        box, pull = self.data.settings.box('geared'), -self.slopes[blocks].sum(axis=0)
        step, _ = bounded_step(rest, pull, 1e-6, box.lower - self.theta, box.upper - self.theta, self.free & ~box.fixed)
        return repaired(self.theta + step)

    def refined(self) -> Composite:
        """Return the estimate after the prediction error, with the likelihood as prior."""
        bounds = theta_box(self.data.settings, self.model)
        pull = np.where(self.free, 0.0, self.slopes.sum(axis=0))
        given = self.theta, self.information, pull, self.delay, self.offsets, bounds, self.filter_data
        try:
            better = refine(self.data.motions, *given)
        except TrajectoryError:  # all recordings are shorter than the longest horizon
            return self
        # The slope of the prior changes with theta.
        moved = np.einsum('bij,j->bi', self.informations, better.theta - self.theta)
        return replace(
            self,
            theta=better.theta,
            free=~bounds.at_bound(better.theta),
            information=better.information,
            slopes=self.slopes + moved + better.slopes,
            informations=self.informations + better.informations,
            steps=(*self.steps, 'prediction errors after 0.1, 0.25 and 0.5 s, with the likelihood as prior'),
        )


def fitted(data: TrainingData, faults: Sequence[Fault], progress: Progress) -> Composite:
    """Return the estimate; recordings with wrong signs, order or zeros have no unmodelled effects.

    Raises:
        TrajectoryError: no filter follows; the message names the faults of the recordings, if there are any.
    """
    progress('weak: rough parameters', 0, 0, math.nan)
    try:
        return fit_composite(data, progress, faults, effects=data.settings.compensate)
    except TrajectoryError as error:
        if not faults:
            raise
        corrected = corrected_conversion(faults)
        words = {} if corrected is None else corrected.words()
        raise TrajectoryError('; '.join(fault.sentence for fault in faults), **words) from error


def fit_composite(
    data: TrainingData, progress: Progress, faults: Sequence[Fault] = (), *, effects: bool = True
) -> Composite:
    """Estimate parameters by the composite likelihood and the last step."""
    part = data.excerpt()
    part, begin = _best_hold(part, first_fit(part, progress), progress)
    fits, found = [Fits.of(part, begin, progress)], list[DetectedEffect]()
    if effects and sound(faults, begin.likelihood.offsets(begin.x)):
        progress('searching for unmodelled effects', 0, 0, math.nan)
        found = _with_effects(fits, data.searched, progress)
    best, found = _completed(data, fits, found, progress)
    accepted = [each for each in found if each.accepted]
    steps = [f'innovations at {begin.interval:g} s: {begin.iterations} scoring steps, J = {begin.evaluation.cost:.6g}']
    steps += [f'together with {each.name} ({each.where})' for each in accepted]
    if best.data.hold == 'linear' and data.settings.hold == 'auto':
        steps.append(f'torque measured at its samples, not held: J = {best.rough.evaluation.cost:.6g}')
    every = best.all_intervals
    intervals = ', '.join(f'{each:g}' for each in every.likelihood.filter_data.settings.intervals)
    steps.append(f'innovations at {intervals} s: {every.iterations} scoring steps, J = {every.evaluation.cost:.6g}')
    if best.exact is not None:
        steps.append(f'all samples: {best.exact.iterations} scoring steps; residual at the quantization level')
    answer = Composite.after(best, found, steps)
    if answer.exact or accepted:
        return answer
    progress('likelihood: prediction error', 0, 0, math.nan)
    return answer.refined()


def _with_effects(fits: list[Fits], share: float, progress: Progress) -> list[DetectedEffect]:
    """Return the detected effects, of which the last may be possible only; append the fits with each accepted one."""
    found = list[DetectedEffect]()
    for each, rough in find_effects(fits[0].rough, EffectSettings(share=share)):
        accepted = each.accepted or nearly_exact(fits[-1].data, rough)
        if accepted:
            try:
                extended = Fits.of(fits[-1].data, rough, progress)
            except FloatingPointError:
                break
            accepted = extended.surely_better(fits[-1], each, share)
        # On an exact rig all samples have decided.
        if accepted or (fits[-1].exact is None and each.z > EffectSettings().possible):
            found.append(replace(each, accepted=accepted))
        if not accepted:
            break
        fits.append(extended)
    if len(fits) > 1:
        held, rough = _best_hold(fits[-1].data, fits[-1].rough, progress)
        if held.hold != fits[-1].data.hold:
            fits[-1] = Fits.of(held, rough, progress)
    return found


def _completed(
    data: TrainingData, fits: Sequence[Fits], found: Sequence[DetectedEffect], progress: Progress
) -> tuple[Fits, list[DetectedEffect]]:
    """Return the fits of all data, from fits of an excerpt with 0, 1, ... effects; all data confirm the last effect."""

    def complete(count: int) -> Fits | None:
        with contextlib.suppress(FloatingPointError):  # a filter diverges outside the excerpt
            return fits[count].completed(data, progress)
        return None

    count = len(fits) - 1
    best = complete(count)
    while count and data.searched < 1:
        before = complete(count - 1)
        if best is not None and (before is None or best.surely_better(before, found[count - 1])):
            break
        best, count = before, count - 1
    if best is None:
        data = data.held(fits[0].data.hold)
        best = Fits.of(data, first_fit(data, progress), progress)
    return best, [*found[:count], *(replace(each, accepted=False) for each in found[count : count + 1])]


def _best_hold(data: TrainingData, rough: LikelihoodFit, progress: Progress) -> tuple[TrainingData, LikelihoodFit]:
    """Return the data and their fit with a held torque, unless a measured one is significantly likelier (Vuong)."""
    if data.settings.hold != 'auto' or max(m.interval for m in data.motions) <= SETTINGS.held_step:
        return data, rough
    other = data.held('linear' if data.hold == 'zero' else 'zero')
    x, at = rough.x.copy(), rough.likelihood.before_noise
    x[14] += (0.5 if other.hold == 'zero' else -0.5) * np.median([m.interval for m in other.motions])
    x[at:] = np.maximum(x[at:], first_noise(other))
    try:
        tried = refit(other, rough, x, progress)
    except FloatingPointError:  # the filter diverges with the other hold
        return data, rough
    zero, linear = (rough, tried) if data.hold == 'zero' else (tried, rough)
    chosen = 'linear' if vuong(zero.evaluation.costs - linear.evaluation.costs, 0.0) > NORMAL_95 else 'zero'
    return (data, rough) if data.hold == chosen else (other, tried)


def _sized(found: Sequence[DetectedEffect], x: Array) -> tuple[DetectedEffect, ...]:
    """Return the effects with the sizes that the last fit found."""
    ends = SHARED + np.cumsum([len(each.sizes) for each in found], dtype=int)
    return tuple(
        replace(each, sizes=x[end - len(each.sizes) : end]) if each.accepted else each
        for each, end in zip(found, ends, strict=True)
    )


def recorded_zeros(fit: LikelihoodFit) -> Zeros:
    """Return the errors of each recording's zeros; their variances by the information, and by the blocks' influence."""
    filter_data, blocks, first = fit.likelihood.filter_data, fit.evaluation, fit.likelihood.shared
    std_error = np.empty((2, len(filter_data.motions)))
    for k in range(len(filter_data.motions)):
        selected, offsets = filter_data.owner == k, slice(first + 2 * k, first + 2 * k + 2)
        inverse = np.linalg.inv(blocks.information[offsets, offsets])
        moves = blocks.slopes[selected, offsets] @ inverse
        std_error[:, k] = np.sqrt(np.diag(inverse) + len(moves) * moves.var(axis=0))
    return Zeros(tuple(m.name for m in filter_data.motions), fit.likelihood.offsets(fit.x).T, std_error)
