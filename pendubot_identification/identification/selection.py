# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Selection of unmodelled effects: the candidates of a catalogue compete by the innovations likelihood.

The likelihood at the shortest interval decides. One scoring step of all candidates together with the model's own
parameters predicts the gain of each; the most promising are fitted. The best is accepted if it is significant by
Vuong's test (Econometrica 57, 1989) over blocks of time. It must have a gain in every recording, and also be the best
without any one of the recordings. Other effects are reported as possible, and not compensated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.likelihood import Likelihood, LikelihoodFit, fit, fitted_information

from .catalogue import DetectedEffect, Effect, catalogue


@dataclass(frozen=True, slots=True)
class EffectSettings:
    """Thresholds of the selection of effects.

    Attributes:
        share: searched fraction of the recordings; z of all data is z over the square root of this fraction.
        fitted: number of candidates that are fitted, by decreasing predicted gain.
        sure: Vuong's z of a significant effect; 3 would suffice for a few candidates, but not for few uneven blocks.
        possible: z above which an effect is reported as possible.
        tried: z above which an effect is fitted to all samples of an exact rig.
        rounds: largest number of accepted effects.
    """

    share: float = 1.0
    fitted: int = 5
    sure: float = 6.0
    possible: float = 4.0
    tried: float = 3.0
    rounds: int = 3


@dataclass(frozen=True, slots=True)
class Problem:
    """A likelihood with effects, its minimum, and the bounds of its unknowns."""

    likelihood: Likelihood
    fit: LikelihoodFit
    lower: Array
    upper: Array

    def extended(self, effects: Sequence[Effect]) -> tuple[Likelihood, Array, Array, Array]:
        """Return the likelihood with more effects, initial values, and bounds."""
        like, at = self.likelihood, self.likelihood.shared
        scale, lower, upper, start = np.array([u for e in effects for u in e.extension.unknowns]).T
        more = (*like.effects, *(e.extension for e in effects))
        grown = replace(like, effects=more, scale=np.append(like.scale, scale))
        pairs = (self.fit.x, start), (self.lower, lower), (self.upper, upper)
        x, low, high = (np.insert(values, at, new) for values, new in pairs)
        return grown, x, low, high

    def with_effects(self, effects: Sequence[Effect]) -> Problem:
        """Return the problem with more effects, solved."""
        like, x, lower, upper = self.extended(effects)
        return Problem(like, fit(like, x, lower, upper, tolerance=0.3), lower, upper)


def find_effects(base: Problem, settings: EffectSettings | None = None) -> list[tuple[DetectedEffect, Problem]]:
    """Return the selected effects in order; the last may be possible only.

    Each is returned with the solved problem that contains it and all effects before it.
    """
    settings = settings or EffectSettings()
    filter_data = base.likelihood.filter_data
    candidates = list(catalogue(filter_data.motions, float(base.fit.x[14])))
    found: list[tuple[DetectedEffect, Problem]] = []
    for _ in range(settings.rounds):
        known = {(f.name, f.where) for f, _ in found}
        left = [c for c in candidates if (c.name, c.where) not in known]
        selected = _compete(base, left, settings)
        if selected is None:
            break
        best, base = selected
        found.append((best, base))
        if not best.accepted:
            break
    return found


def _compete(
    base: Problem, candidates: Sequence[Effect], settings: EffectSettings
) -> tuple[DetectedEffect, Problem] | None:
    filter_data, before = base.likelihood.filter_data, base.fit.evaluation.costs
    recordings = len(filter_data.motions)
    promising = sorted(_predicted(base, candidates), key=lambda each: -each[0])
    least = np.log(max(filter_data.weight.sum(), 2.0)) / 2
    tried = [c for gain, c in promising if gain > least * len(c.extension.unknowns)][: settings.fitted]
    results = []
    for candidate in tried:
        try:
            problem = base.with_effects([candidate])
        except FloatingPointError:
            continue
        gains = before - problem.fit.evaluation.costs
        results.append((candidate, problem, gains))
    if not results:
        return None
    by_recording = np.array([np.bincount(filter_data.owner, g, minlength=recordings) for *_, g in results])
    cost = np.array([least * len(c.extension.unknowns) for c, *_ in results])
    best = int(np.argmax(by_recording.sum(axis=1) - cost))
    candidate, problem, gains = results[best]
    z = vuong(gains, cost[best]) / settings.share**0.5
    everywhere = bool((by_recording[best] > 0).all())
    at, count = base.likelihood.shared, len(candidate.extension.unknowns)
    inside = bool(problem.fit.free[at : at + count].all())
    left_out = range(recordings) if recordings >= 3 else ()
    winners = [results[int(np.argmax(np.delete(by_recording, k, axis=1).sum(axis=1) - cost))][0] for k in left_out]
    stable = all((each.name, each.where) == (candidate.name, candidate.where) for each in winners)
    accepted = z > settings.sure and everywhere and stable and inside
    if not accepted and z < settings.tried:
        return None
    sizes = problem.fit.x[at : at + count]
    moved = problem.fit.x[:5] / np.maximum(base.fit.x[:5], 1e-12) - 1
    return DetectedEffect(candidate, sizes, float(gains.sum()), z, accepted, moved), problem


def vuong(gains: Array, cost: float) -> float:
    """Return Vuong's z of the gains of blocks of time, minus the cost of additional unknowns."""
    deviation = float(gains.std(ddof=1)) if len(gains) > 1 else np.inf
    return float(gains.sum() - cost) / max(deviation * float(np.sqrt(len(gains))), 1e-9)


def _predicted(base: Problem, candidates: Sequence[Effect]) -> Iterator[tuple[float, Effect]]:
    """Yield the predicted decrease of J by one scoring step with each candidate."""
    sloped = [c for c in candidates if not c.blind]
    like, x, lower, upper = base.extended(sloped)
    at = base.likelihood.shared
    evaluation = like.evaluate(x, lower < upper)
    slope, information = fitted_information(like, evaluation, x)
    if not np.isfinite(information).all():
        return
    added = np.zeros(len(x), dtype=bool)
    count = sum(len(c.extension.unknowns) for c in sloped)
    added[at : at + count] = True
    base_free = ~added
    base_free[~added] = base.fit.free
    b = np.flatnonzero(base_free)
    inverse = np.linalg.pinv(information[np.ix_(b, b)], hermitian=True)
    for candidate in sloped:
        size = len(candidate.extension.unknowns)
        c = np.arange(at, at + size)
        at += size
        cross = information[np.ix_(c, b)] @ inverse
        condensed = information[np.ix_(c, c)] - cross @ information[np.ix_(b, c)]
        pull = slope[c] - cross @ slope[b]
        yield float(pull @ np.linalg.pinv(condensed, hermitian=True) @ pull) / 2, candidate
    now = float(base.fit.evaluation.costs.sum())
    for candidate in (c for c in candidates if c.blind):
        like, x, lower, upper = base.extended([candidate])
        if candidate.name == 'lag':
            x[14] = np.clip(x[14] - x[base.likelihood.shared], lower[14], upper[14])
        evaluation = like.evaluate(x, lower < upper)
        if not (np.isfinite(evaluation.costs).all() and np.isfinite(evaluation.informations).all()):
            continue
        slope, information = fitted_information(like, evaluation, x)
        if not np.isfinite(information).all():
            continue
        free = np.flatnonzero(np.insert(base.fit.free, base.likelihood.shared, True))
        step = np.linalg.lstsq(information[np.ix_(free, free)], slope[free], rcond=1e-10)[0]
        yield now - float(evaluation.costs.sum()) + float(slope[free] @ step) / 2, candidate
