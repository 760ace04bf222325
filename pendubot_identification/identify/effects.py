# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Unmodelled effects: a catalogue of extensions of the model, which compete by the innovations likelihood.

The likelihood at the shortest interval decides. One scoring step of all candidates together with the model's own
parameters predicts what each would gain; the most promising are fitted. The best is accepted only if it is sure:
Vuong's test (Econometrica 57, 1989) over blocks of time, a gain in every recording, and the same choice whichever
recording is left out. Anything else is reported as possible and changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PPoly

from pendubot_identification.criteria.likelihood import (
    Extension,
    Likelihood,
    LikelihoodFit,
    Shape,
    fit,
    fitted_information,
)
from pendubot_identification.model.dynamics import SIGN_WIDTH
from pendubot_identification.model.filter import Term, TermKind
from pendubot_identification.trajectories.motion import Motion

Array = NDArray[np.float64]
JOINTS = ('shoulder', 'elbow')


@dataclass(frozen=True, slots=True)
class EffectSettings:
    """When an effect is looked at, and when it is sure.

    Attributes:
        fitted: so many candidates are fitted in full, those whose predicted gain is largest.
        iterations: of such a fit; the chosen one is then fitted to the end.
        sure: Vuong's z; for a handful of candidates 3 would be significant, but blocks are few and gains uneven.
            Clean simulated rigs and real ones reach 5.9 at most.
        possible: z above which an effect that is not sure is reported.
        tried: z above which all samples of an exact rig decide about it.
        rounds: effects that may be accepted, one after the other.
        turn: cogging is looked for at a joint that moves by more [rad].
        repetitions: of cogging per turn, at most.
    """

    fitted: int = 5
    iterations: int = 8
    sure: float = 6.0
    possible: float = 4.0
    tried: float = 3.0
    rounds: int = 3
    turn: float = 1.0
    repetitions: int = 24


@dataclass(frozen=True, slots=True)
class Effect:
    """A candidate: its name, one of :data:`MEANINGS`, where it acts, and what it adds to the model."""

    name: str
    where: str
    extension: Extension


@dataclass(frozen=True, slots=True)
class FoundEffect:
    """An effect that the recordings speak for.

    Attributes:
        effect: which.
        sizes: of its unknowns.
        gain: by how much it lowers J.
        z: Vuong's.
        accepted: whether it is sure, and the published parameters were estimated together with it.
        moved: by how much each of P1 to P5 changes beside it, as a fraction, shape (5,).
    """

    effect: Effect
    sizes: Array
    gain: float
    z: float
    accepted: bool
    moved: Array

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.effect.name

    @property
    def where(self) -> str:
        """In words."""
        return self.effect.where

    @property
    def sentence(self) -> str:
        """What was found, how sure that is, and what to do."""
        found, remedy = MEANINGS[self.name]
        if not self.accepted:
            return f'possible, not compensated: {found} ({self.where}); {remedy}'
        own = ', '.join(f'{size:.3g}' for size in self.sizes)
        said = (
            f'{found} ({self.where}, {own}): compensated, P1 to P5 change by up to {100 * abs(self.moved).max():.2g} %'
        )
        if self.name in FRICTION:
            said += '; the friction parameters are meaningful only together with it'
        return f'{said}; {remedy}'


#: What each effect is, and what to do.
MEANINGS = {
    'dead zone': (
        'the motor gives no torque below a threshold',
        "record the motor's current, or raise the driver's offset",
    ),
    'saturation': (
        'the motor gives less torque than recorded where that is large',
        "record the motor's current, or excite with less",
    ),
    'back-EMF': (
        'the motor gives less torque the faster it turns',
        "record the motor's current, raise the supply voltage, or excite with less",
    ),
    'lag': (
        'the torque follows the recorded one with a lag',
        "record the motor's current, or excite with slower torques",
    ),
    'offset': (
        'a constant torque acts that is not recorded',
        "check the zero of the torque's or current's sensor, and cables",
    ),
    'asymmetry': ('dry friction differs between the two directions', 'use Fc as the mean of both directions'),
    'width': ('dry friction changes its sign over another range of speed than 0.05 rad/s', 'simulate with this width'),
    'drag': ('a joint brakes with the square of its speed', 'move more slowly, or use b for these speeds alone'),
    'spring': ('a torque grows with a joint angle: a cable or a spring', 'free the cable, or lead it along the axis'),
    'drift': ('friction changes with time', 'let the rig warm up, and record again'),
    'cogging': ('a torque repeats several times a turn: a motor that cogs, or a gear', 'treat friction as approximate'),
    'eccentricity': ('an angle is off by an error that repeats once a turn', 'centre the encoder or its coupling'),
    'creep': ('dry friction is larger at low speed than in the model', 'use Fc and Fs for these speeds alone'),
}
#: Effects of which the model's friction is a part.
FRICTION = ('asymmetry', 'width', 'drag', 'drift', 'creep')


def _sample_wise(change: Callable[[Array, float], Array]) -> Shape:
    """Return the shape that changes every sample of the recorded torque by itself."""

    def shaped(motion: Motion, own: Array) -> Motion:
        tau = change(motion.recorded.tau, float(own[0]))
        t = motion.recorded.t
        held = len(motion.impulse.c) == 2
        pieces = [tau[:-1]] if held else [np.diff(tau, axis=0) / np.diff(t)[:, None], tau[:-1]]
        return replace(
            motion, impulse=PPoly(np.array(pieces), t).antiderivative(), recorded=replace(motion.recorded, tau=tau)
        )

    return shaped


def _fine_torque(motion: Motion, step: float) -> tuple[Array, Array]:
    """Return times at most a step [s] apart, and the recorded torques' means between them, shapes (N + 1,), (N, 2)."""
    count = max(1, math.ceil((motion.impulse.x[-1] - motion.impulse.x[0]) / min(step, motion.interval)))
    t = np.linspace(motion.impulse.x[0], motion.impulse.x[-1], count + 1)
    return t, np.diff(motion.impulse(t), axis=0) / np.diff(t)[:, None]


def _limited_by_speed(delay: float) -> Shape:
    """Return the shape of a motor whose largest torque falls with its speed, from a standstill to no load.

    The unknowns are the largest torque at a standstill [N m] and the inverse of the speed at no load [s/rad].
    """

    def shaped(motion: Motion, own: Array) -> Motion:
        t, tau = _fine_torque(motion, 0.001)
        speed = motion.states(np.clip((t[1:] + t[:-1]) / 2 + delay, motion.start, motion.end))[2:].T
        high, low = own[0] * np.maximum(1 - own[1] * speed, 0), -own[0] * np.maximum(1 + own[1] * speed, 0)
        return replace(motion, impulse=PPoly(np.clip(tau, low, high)[None], t).antiderivative())

    return shaped


def _eccentric(joint: int) -> Shape:
    """Return the shape of an encoder that reads an angle plus a sine and a cosine of it [rad], the two unknowns."""

    def true(read: Array, own: Array) -> Array:
        angle = read
        for _ in range(4):  # errors are small, so that this converges
            angle = read - own[0] * np.sin(angle) - own[1] * np.cos(angle)
        return angle

    def shaped(motion: Motion, own: Array) -> Motion:
        q, nodes = motion.recorded.q.copy(), motion.smoothed.x
        q[:, joint] = true(q[:, joint], own)
        states = motion.smoothed(nodes)
        angle = states[:, joint] = true(states[:, joint], own)
        states[:, 2 + joint] /= 1 + own[0] * np.cos(angle) - own[1] * np.sin(angle)
        return replace(motion, smoothed=CubicSpline(nodes, states), recorded=replace(motion.recorded, q=q, qd=None))

    return shaped


def _lagged(motion: Motion, own: Array) -> Motion:
    """Return the motion whose torque passes a first-order lag of so many seconds."""
    t, mean = _fine_torque(motion, 0.001)
    step = t[1] - t[0]
    decay = np.exp(-step / max(float(own[0]), 1e-6))
    # The mean of a lagged torque over a step lies between its values at both ends.
    late, past = (1 - decay) * mean, 1
    while past < len(late) and decay**past > 1e-16:  # of twice as many past steps each time
        late[past:] = late[past:] + decay**past * late[:-past]
        past *= 2
    before = np.vstack([np.zeros((1, 2)), late[:-1]])
    part = (1 - decay) * max(float(own[0]), 1e-6) / step
    return replace(motion, impulse=PPoly((mean + (before - mean) * part)[None], t).antiderivative())


def catalogue(motions: Sequence[Motion], delay: float, settings: EffectSettings) -> Iterator[Effect]:
    """Return every effect that recordings can show; ``delay`` of the torque [s]."""
    tau = max(float(np.abs(m.recorded.tau).max()) for m in motions)
    speed = max(float(m.states(m.recorded.t)[2:].std(axis=1).max()) for m in motions)
    spans = np.max([np.ptp(m.recorded.q, axis=0) for m in motions], axis=0)

    def linear(
        name: str, joint: int, *kinds: TermKind, number: float = 0.0, scale: float = tau, where: str = ''
    ) -> Effect:
        count = len(kinds)
        scales = tuple(scale / speed if kind is TermKind.VISCOUS_DRIFT else scale for kind in kinds)
        terms = tuple(Term(kind, joint, number) for kind in kinds)
        # An effect is a part of the motion: its torque stays below half of the motor's.
        reach = {TermKind.ANGLE: 2 / max(spans[joint], 1e-9), TermKind.DRAG: tau / scale / speed**2 / 4}
        limits = tuple(0.5 * s * reach.get(kind, 1.0) for s, kind in zip(scales, kinds, strict=True))
        extension = Extension(terms, None, (), scales, tuple(-s for s in limits), limits, (0.0,) * count)
        return Effect(name, JOINTS[joint] + where, extension)

    for joint in range(2):
        yield linear('offset', joint, TermKind.CONSTANT)
        yield linear('asymmetry', joint, TermKind.DIRECTION)
        yield linear('drag', joint, TermKind.DRAG, scale=tau / speed**2)
        yield linear('spring', joint, TermKind.ANGLE, TermKind.CONSTANT)
        yield linear('drift', joint, TermKind.VISCOUS_DRIFT, TermKind.COULOMB_DRIFT)
        for slow in (0.1, 0.3):
            yield linear('creep', joint, TermKind.CREEP, number=slow, where=f', below {slow:g} rad/s')
        width = Extension(width=(joint,), scale=(SIGN_WIDTH,), lower=(0.005,), upper=(3.0,), start=(SIGN_WIDTH,))
        yield Effect('width', JOINTS[joint], width)
        for number in range(2, settings.repetitions + 1) if spans[joint] > settings.turn else ():
            yield linear('cogging', joint, TermKind.SINE, TermKind.COSINE, number=number, where=f', {number} a turn')
    dead = _sample_wise(lambda tau, zone: np.sign(tau) * np.maximum(np.abs(tau) - zone, 0))
    yield Effect('dead zone', 'motor', Extension((), dead, (), (tau,), (0.0,), (0.5 * tau,), (0.0,)))
    sag = _sample_wise(lambda each, part: each * (1 - part * (each / tau) ** 2))
    yield Effect('saturation', 'gradual', Extension((), sag, (), (1.0,), (-0.5,), (0.9,), (0.0,)))
    limit = _sample_wise(lambda tau, most: np.clip(tau, -most, most))
    for part in (0.85, 0.6):
        least = (0.1 * tau,)
        yield Effect('saturation', 'motor', Extension((), limit, (), (tau,), least, (tau,), (part * tau,)))
    fastest = max(1e-9, *(float(np.abs(m.states(m.recorded.t)[2]).max()) for m in motions))
    slower = Extension(
        shape=_limited_by_speed(delay),
        scale=(tau, 1 / fastest),
        lower=(0.1 * tau, 0.0),
        upper=(2 * tau, 2 / fastest),
        start=(tau, 0.5 / fastest),
    )
    yield Effect('back-EMF', 'motor', slower)
    for joint in range(2):
        turns = Extension((), _eccentric(joint), (), (0.01, 0.01), (-0.1, -0.1), (0.1, 0.1), (0.0, 0.0))
        yield Effect('eccentricity', f"{JOINTS[joint]}'s encoder", turns)
    for lag in (0.004, 0.02):
        yield Effect('lag', 'motor', Extension((), _lagged, (), (0.01,), (0.0005,), (0.2,), (lag,)))


def compensated(motion: Motion, effects: Sequence[FoundEffect], delay: float) -> Motion:
    """Return a motion with the torques that act, as far as accepted effects tell them, along its smoothed states.

    Friction that drifts is taken as at the end of the training data.
    """
    result = motion
    for found in effects:
        extension = found.effect.extension
        if found.accepted and extension.shape is not None:
            result = extension.shape(result, found.sizes[len(extension.terms) :])
    terms = [
        (term, size)
        for found in effects
        if found.accepted
        for term, size in zip(found.effect.extension.terms, found.sizes, strict=False)
    ]
    if not terms:
        return result
    t = np.union1d(result.impulse.x, np.arange(motion.start, motion.end, 0.0025) - delay)
    states = result.states(np.clip((t[1:] + t[:-1]) / 2 + delay, motion.start, motion.end))
    tau = np.diff(result.impulse(t), axis=0) / np.diff(t)[:, None]
    for term, size in terms:
        q, v = states[term.joint], states[2 + term.joint]
        tau[:, term.joint] += size * term.torque(q, v, 0.5)
    return replace(result, impulse=PPoly(tau[None], t).antiderivative())


def blind(effect: Effect) -> bool:
    """Tell whether the likelihood without an effect has no slope towards it, so that it must be tried."""
    return effect.name in ('lag', 'back-EMF') or (effect.name == 'saturation' and effect.where == 'motor')


@dataclass(frozen=True, slots=True)
class Problem:
    """A likelihood with some effects, where it is least, and the bounds of its unknowns."""

    likelihood: Likelihood
    fit: LikelihoodFit
    lower: Array
    upper: Array

    def extended(self, effects: Sequence[Effect]) -> tuple[Likelihood, Array, Array, Array]:
        """Return the likelihood with more effects, where they start, and bounds."""
        like, at = self.likelihood, self.likelihood.shared
        more = [e.extension for e in effects]
        grown = replace(
            like, effects=(*like.effects, *more), scale=np.append(like.scale, [s for e in more for s in e.scale])
        )

        def inserted(values: Array, name: str) -> Array:
            return np.insert(values, at, [s for e in more for s in getattr(e, name)])

        return grown, inserted(self.fit.x, 'start'), inserted(self.lower, 'lower'), inserted(self.upper, 'upper')

    def solved(self) -> Problem:
        """Return the problem fitted to the end."""
        found = fit(self.likelihood, self.fit.x, self.lower, self.upper, iterations=30, tolerance=0.3)
        return replace(self, fit=found)

    def with_effects(self, effects: Sequence[Effect], iterations: int = 20) -> Problem:
        """Return the problem with more effects, solved."""
        like, x, lower, upper = self.extended(effects)
        return Problem(like, fit(like, x, lower, upper, iterations=iterations, tolerance=0.3), lower, upper)


def find_effects(base: Problem, settings: EffectSettings | None = None) -> list[FoundEffect]:
    """Return the effects that one filter's likelihood speaks for; the accepted ones in the order of acceptance."""
    settings = settings or EffectSettings()
    filter_data = base.likelihood.filter_data
    candidates = list(catalogue(filter_data.motions, float(base.fit.x[14]), settings))
    accepted: list[FoundEffect] = []
    for _ in range(settings.rounds):
        known = {(f.name, f.where) for f in accepted}
        left = [c for c in candidates if (c.name, c.where) not in known]
        found = _compete(base, left, settings)
        if found is None:
            break
        best, problem = found
        if not best.accepted:
            return [*accepted, best]
        accepted.append(best)
        base = problem.solved()
    return accepted


def _compete(
    base: Problem, candidates: Sequence[Effect], settings: EffectSettings
) -> tuple[FoundEffect, Problem] | None:
    filter_data, before = base.likelihood.filter_data, base.fit.evaluation.costs
    recordings = len(filter_data.motions)
    promising = sorted(_predicted(base, candidates), key=lambda each: -each[0])
    least = np.log(max(filter_data.weight.sum(), 2.0)) / 2
    tried = [c for gain, c in promising if gain > least * len(c.extension.scale)][: settings.fitted]
    results = []
    for candidate in tried:
        try:
            problem = base.with_effects([candidate], settings.iterations)
        except FloatingPointError:
            continue
        gains = before - problem.fit.evaluation.costs
        results.append((candidate, problem, gains))
    if not results:
        return None
    by_recording = np.array([np.bincount(filter_data.owner, g, minlength=recordings) for *_, g in results])
    cost = np.array([least * len(c.extension.scale) for c, *_ in results])
    best = int(np.argmax(by_recording.sum(axis=1) - cost))
    candidate, problem, gains = results[best]
    z = vuong(gains, cost[best])
    everywhere = bool((by_recording[best] > 0).all())
    at, count = base.likelihood.shared, len(candidate.extension.scale)
    inside = bool(problem.fit.free[at : at + count].all())
    names = [(c.name, c.where) for c, *_ in results]
    chosen = (
        [names[int(np.argmax(np.delete(by_recording, k, axis=1).sum(axis=1) - cost))] for k in range(recordings)]
        if recordings >= 3
        else [names[best]]
    )
    stable = all(name == names[best] for name in chosen)
    accepted = z > settings.sure and everywhere and stable and inside
    if not accepted and z < settings.tried:
        return None
    sizes = problem.fit.x[at : at + count]
    moved = problem.fit.x[:5] / np.maximum(base.fit.x[:5], 1e-12) - 1
    return FoundEffect(candidate, sizes, float(gains.sum()), z, accepted, moved), problem


def vuong(gains: Array, cost: float) -> float:
    """Return Vuong's z of the gains of blocks of time, less what more unknowns cost."""
    deviation = float(gains.std(ddof=1)) if len(gains) > 1 else np.inf
    return float(gains.sum() - cost) / max(deviation * float(np.sqrt(len(gains))), 1e-9)


def _predicted(base: Problem, candidates: Sequence[Effect]) -> Iterator[tuple[float, Effect]]:
    """Yield by how much one scoring step would lower J with each candidate beside the model."""
    seen = [c for c in candidates if not blind(c)]
    like, x, lower, upper = base.extended(seen)
    at = base.likelihood.shared
    evaluation = like.evaluate(x, lower < upper)
    slope, information = fitted_information(like, evaluation, x)
    if not np.isfinite(information).all():
        return
    own = np.zeros(len(x), dtype=bool)
    count = sum(len(c.extension.scale) for c in seen)
    own[at : at + count] = True
    base_free = ~own
    base_free[~own] = base.fit.free
    b = np.flatnonzero(base_free)
    inverse = np.linalg.pinv(information[np.ix_(b, b)], hermitian=True)
    for candidate in seen:
        size = len(candidate.extension.scale)
        c = np.arange(at, at + size)
        at += size
        cross = information[np.ix_(c, b)] @ inverse
        condensed = information[np.ix_(c, c)] - cross @ information[np.ix_(b, c)]
        pull = slope[c] - cross @ slope[b]
        yield float(pull @ np.linalg.pinv(condensed, hermitian=True) @ pull) / 2, candidate
    now = float(base.fit.evaluation.costs.sum())
    for candidate in (c for c in candidates if blind(c)):
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
