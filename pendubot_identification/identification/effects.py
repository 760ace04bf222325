# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Unmodelled effects: a catalogue of candidates, and their selection by the innovations likelihood.

The likelihood at the shortest interval decides. One scoring step of all candidates together with the model's own
parameters predicts the gain of each; the most promising are fitted. The best is accepted if it is significant by
Vuong's test (Econometrica 57, 1989) over blocks of time. It must have a gain in every recording, and also be the best
without any one of the recordings. Other effects are reported as possible, and not compensated.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline, PPoly
from scipy.linalg import solve_banded

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.likelihood import Calibration, Effect, LikelihoodFit, Shape, Unknown, fit
from pendubot_identification.model.dynamics import SIGN_WIDTH
from pendubot_identification.model.filter import Term, TermKind
from pendubot_identification.trajectories.conventions import JOINT_NAMES
from pendubot_identification.trajectories.motion import Motion

#: Rotation of a joint [rad] above which cogging is a candidate; largest number of its repetitions per turn.
TURN, REPETITIONS = 1.0, 24
#: Step [s] of torques that depend on the motion or on earlier torques.
STEP = 0.001
#: The description of each effect, and its remedy.
MEANINGS = {
    'dead zone': (
        'the motor gives no torque below a threshold',
        "record the motor's current, or raise the driver's offset",
    ),
    'saturation': (
        'the motor gives less torque than recorded at large torques',
        "record the motor's current, or excite with smaller torques",
    ),
    'back-EMF': (
        'the torque of the motor decreases with its speed',
        "record the motor's current, raise the supply voltage, or excite with smaller torques",
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
    'cogging': ('a torque repeats several times a turn: cogging, or a gear', 'treat friction as approximate'),
    'eccentricity': ('an angle is off by an error that repeats once a turn', 'centre the encoder or its coupling'),
    'creep': ('dry friction is larger at low speed than in the model', 'use Fc and Fs for these speeds alone'),
}
#: Effects that extend the friction of the model.
FRICTION = ('asymmetry', 'width', 'drag', 'drift', 'creep')


@dataclass(frozen=True, slots=True)
class DetectedEffect:
    """An effect that the recordings show."""

    effect: Effect  #: the candidate.
    sizes: Array  #: estimates of its unknowns.
    gain: float  #: decrease of J.
    z: float  #: statistic of Vuong's test.
    accepted: bool  #: whether it is significant, and the published parameters were estimated together with it.
    moved: Array  #: relative change of P1 to P5 by the effect, shape (5,).

    @property
    def name(self) -> str:
        """The name of the effect."""
        return self.effect.name

    @property
    def where(self) -> str:
        """The joint or part on which it acts."""
        return self.effect.where

    @property
    def sentence(self) -> str:
        """The message: finding, significance, and remedy."""
        found, remedy = MEANINGS[self.name]
        if not self.accepted:
            return f'possible, not compensated: {found} ({self.where}); {remedy}'
        size = ', '.join(f'{x:.3g}' for x in self.sizes)
        sentence = (
            f'{found} ({self.where}, {size}): compensated, P1 to P5 change by up to {100 * abs(self.moved).max():.2g} %'
        )
        if self.name in FRICTION:
            sentence += '; the friction parameters are meaningful only together with it'
        return f'{sentence}; {remedy}'


def catalogue(motions: Sequence[Motion], delay: float) -> Iterator[Effect]:
    """Yield all candidates for recordings; ``delay``: of the torque [s]."""
    tau = max(float(np.abs(m.recorded.tau).max()) for m in motions)
    states = [m.states(m.recorded.t) for m in motions]
    speed = max(float(each[2:].std(axis=1).max()) for each in states)
    fastest = max(1e-9, *(float(np.abs(each[2]).max()) for each in states))
    spans = np.max([np.ptp(m.recorded.q, axis=0) for m in motions], axis=0)

    def linear(
        name: str, joint: int, *kinds: TermKind, number: float = 0.0, scale: float = tau, where: str = ''
    ) -> Effect:
        # The torque of an effect stays below half of the motor's.
        reach = {TermKind.ANGLE: 2 / max(spans[joint], 1e-9), TermKind.DRAG: tau / scale / speed**2 / 4}
        unknowns = []
        for kind in kinds:
            size = scale / speed if kind is TermKind.VISCOUS_DRIFT else scale
            limit = 0.5 * size * reach.get(kind, 1.0)
            unknowns.append(Unknown(size, -limit, limit))
        terms = tuple(Term(kind, joint, number) for kind in kinds)
        return Effect(name, JOINT_NAMES[joint] + where, tuple(unknowns), terms)

    for joint, name in enumerate(JOINT_NAMES):
        yield linear('offset', joint, TermKind.CONSTANT)
        yield linear('asymmetry', joint, TermKind.DIRECTION)
        yield linear('drag', joint, TermKind.DRAG, scale=tau / speed**2)
        yield linear('spring', joint, TermKind.ANGLE, TermKind.CONSTANT)
        yield linear('drift', joint, TermKind.VISCOUS_DRIFT, TermKind.COULOMB_DRIFT)
        for slow in (0.1, 0.3):
            yield linear('creep', joint, TermKind.CREEP, number=slow, where=f', below {slow:g} rad/s')
        yield Effect('width', name, (Unknown(SIGN_WIDTH, 0.005, 3.0, SIGN_WIDTH),), width=(joint,))
        sine = Unknown(0.01, -0.1, 0.1)
        yield Effect('eccentricity', f"{name}'s encoder", (sine, sine), calibration=_eccentric(joint))
        for number in range(2, REPETITIONS + 1) if spans[joint] > TURN else ():
            yield linear('cogging', joint, TermKind.SINE, TermKind.COSINE, number=number, where=f', {number} a turn')
    dead = _sample_wise(lambda tau, zone: np.sign(tau) * np.maximum(np.abs(tau) - zone, 0))
    yield Effect('dead zone', 'motor', (Unknown(tau, 0.0, 0.5 * tau),), shape=dead)
    sag = _sample_wise(lambda sample, part: sample * (1 - part * np.minimum((sample / tau) ** 2, 1)))
    yield Effect('saturation', 'gradual', (Unknown(1.0, -0.5, 0.9),), shape=sag)
    limit = _sample_wise(lambda tau, most: np.clip(tau, -most, most))
    for part in (0.85, 0.6):
        yield Effect('saturation', 'motor', (Unknown(tau, 0.1 * tau, tau, part * tau),), shape=limit, blind=True)
    falling = Unknown(tau, 0.1 * tau, 2 * tau, tau), Unknown(1 / fastest, 0.0, 2 / fastest, 0.5 / fastest)
    yield Effect('back-EMF', 'motor', falling, shape=_limited_by_speed(delay), blind=True)
    for lag in (0.004, 0.02):
        yield Effect('lag', 'motor', (Unknown(0.01, 0.0005, 0.2, lag),), shape=_lagged, blind=True)


def _sample_wise(change: Callable[[Array, float], Array]) -> Shape:
    """Return the shape that maps each sample of the torque independently, after the effects before it."""

    def shaped(motion: Motion, unknowns: Array) -> Motion:
        torque, size = motion.impulse.derivative(), float(unknowns[0])
        pieces = [change(torque.c[-1], size)]
        if len(torque.c) == 2:  # a torque that changes linearly between samples
            length = np.diff(torque.x)[:, None]
            end = change(torque.c[-1] + torque.c[0] * length, size)
            pieces.insert(0, (end - pieces[0]) / length)
        recorded = replace(motion.recorded, tau=change(motion.recorded.tau, size))
        return replace(motion, impulse=PPoly(np.array(pieces), torque.x).antiderivative(), recorded=recorded)

    return shaped


def _fine_torque(motion: Motion) -> tuple[Array, Array]:
    """Return times at most :data:`STEP` apart [s], and the mean torques between them, shapes (N + 1,), (N, 2)."""
    count = max(1, math.ceil((motion.impulse.x[-1] - motion.impulse.x[0]) / min(STEP, motion.interval)))
    t = np.linspace(motion.impulse.x[0], motion.impulse.x[-1], count + 1)
    return t, np.diff(motion.impulse(t), axis=0) / np.diff(t)[:, None]


def _limited_by_speed(delay: float) -> Shape:
    """Return the shape of a motor whose largest torque decreases with its speed, from a standstill to no load.

    The unknowns are the largest torque at a standstill [N m] and the inverse of the speed at no load [s/rad].
    """

    def shaped(motion: Motion, unknowns: Array) -> Motion:
        t, tau = _fine_torque(motion)
        speed = motion.states(np.clip((t[1:] + t[:-1]) / 2 + delay, motion.start, motion.end))[2:].T
        most, slope = unknowns
        high, low = most * np.maximum(1 - slope * speed, 0), -most * np.maximum(1 + slope * speed, 0)
        return replace(motion, impulse=PPoly(np.clip(tau, low, high)[None], t).antiderivative())

    return shaped


def _eccentric(joint: int) -> Calibration:
    """Return the calibration of an encoder whose error is a sine plus a cosine of the angle [rad], the two unknowns."""

    def calibrated(q: Array, unknowns: Array) -> Array:
        true: Array = q.copy()
        for _ in range(4):  # converges, because errors are small
            true[:, joint] = q[:, joint] - unknowns[0] * np.sin(true[:, joint]) - unknowns[1] * np.cos(true[:, joint])
        return true

    return calibrated


def _lagged(motion: Motion, unknowns: Array) -> Motion:
    """Return the motion with a first-order lag of the torque; the unknown is the time constant [s]."""
    t, mean = _fine_torque(motion)
    step, lag = t[1] - t[0], float(unknowns[0])
    decay = math.exp(-step / lag)
    late = solve_banded((1, 0), np.tile([[1.0], [-decay]], len(mean)), (1 - decay) * mean)
    before = np.vstack([np.zeros((1, 2)), late[:-1]])
    # The mean of a lagged torque over a step lies between its values at both ends.
    part = (1 - decay) * lag / step
    return replace(motion, impulse=PPoly((mean + (before - mean) * part)[None], t).antiderivative())


def _calibrated(motion: Motion, calibration: Calibration, unknowns: Array) -> Motion:
    """Return the motion with true angles; its velocities change by the derivative of the calibration."""
    nodes, small = motion.smoothed.x, 1e-5
    q, v = np.split(motion.smoothed(nodes), 2, axis=1)
    slope = (calibration(q + small, unknowns) - calibration(q - small, unknowns)) / (2 * small)
    smoothed = CubicSpline(nodes, np.hstack([calibration(q, unknowns), v * slope]))
    recorded = replace(motion.recorded, q=calibration(motion.recorded.q, unknowns), qd=None)
    return replace(motion, smoothed=smoothed, recorded=recorded)


def compensated(motion: Motion, effects: Sequence[DetectedEffect], delay: float) -> Motion:
    """Return a motion with the acting torques by the accepted effects, except a width, along its smoothed states.

    Drifting friction has its value at the end of the training data.
    """
    accepted, result = [(found.effect, found.sizes) for found in effects if found.accepted], motion
    for effect, sizes in accepted:
        own = sizes[len(effect.terms) :]
        if effect.shape is not None:
            result = effect.shape(result, own)
        if effect.calibration is not None:
            result = _calibrated(result, effect.calibration, own)
    terms = [pair for effect, sizes in accepted for pair in zip(effect.terms, sizes, strict=False)]
    if not terms:
        return result
    t = np.union1d(result.impulse.x, np.arange(motion.start, motion.end, 0.0025) - delay)
    states = result.states(np.clip((t[1:] + t[:-1]) / 2 + delay, motion.start, motion.end))
    tau = np.diff(result.impulse(t), axis=0) / np.diff(t)[:, None]
    for term, size in terms:
        q, v = states[term.joint], states[2 + term.joint]
        tau[:, term.joint] += size * term.torques(q, v, 0.5)[0]
    return replace(result, impulse=PPoly(tau[None], t).antiderivative())


@dataclass(frozen=True, slots=True)
class EffectSettings:
    """Thresholds of the selection of effects."""

    #: searched fraction of the recordings; z of all data is z over the square root of this fraction.
    share: float = 1.0
    fitted: int = 5  #: number of candidates that are fitted, by decreasing predicted gain.
    #: Vuong's z of a significant effect; 3 would suffice for a few candidates, but not for few uneven blocks.
    sure: float = 6.0
    possible: float = 4.0  #: z above which an effect is reported as possible.
    tried: float = 3.0  #: z above which an effect is fitted to all samples of an exact rig.
    rounds: int = 3  #: largest number of accepted effects.


def find_effects(
    base: LikelihoodFit, settings: EffectSettings | None = None
) -> Iterator[tuple[DetectedEffect, LikelihoodFit]]:
    """Yield the selected effects in order; the last may be possible only.

    Each is followed by the fit that contains it and all effects before it.
    """
    settings = settings or EffectSettings()
    candidates = list(catalogue(base.likelihood.filter_data.motions, float(base.x[14])))
    for _ in range(settings.rounds):
        selected = _compete(base, candidates, settings)
        if selected is None:
            return
        yield selected
        found, base = selected
        if not found.accepted:
            return
        candidates = [c for c in candidates if (c.name, c.where) != (found.name, found.where)]


def _compete(
    base: LikelihoodFit, candidates: Sequence[Effect], settings: EffectSettings
) -> tuple[DetectedEffect, LikelihoodFit] | None:
    """Fit the most promising candidates, and return the best one; None if it is not significant."""
    filter_data, at = base.likelihood.filter_data, base.likelihood.shared
    recordings = len(filter_data.motions)
    promising = sorted(_predicted(base, candidates), key=lambda each: -each[0])
    least = np.log(max(filter_data.weight.sum(), 2.0)) / 2
    fits = list[tuple[Effect, LikelihoodFit]]()
    for candidate in [c for gain, c in promising if gain > least * len(c.unknowns)][: settings.fitted]:
        with contextlib.suppress(FloatingPointError):
            fits.append((candidate, fit(*base.likelihood.extended([candidate], base.x), tolerance=0.3)))
    if not fits:
        return None
    gains = base.evaluation.costs - np.array([found.evaluation.costs for _, found in fits])
    by_recording = np.array([np.bincount(filter_data.owner, each, minlength=recordings) for each in gains])
    cost = least * np.array([len(candidate.unknowns) for candidate, _ in fits])
    net = by_recording.sum(axis=1) - cost
    best = int(np.argmax(net))
    (effect, found), gain = fits[best], gains[best]
    z = vuong(gain, cost[best]) / settings.share**0.5
    own = slice(at, at + len(effect.unknowns))
    winners = [fits[np.argmax(net - by_recording[:, k])][0] for k in range(recordings if recordings >= 3 else 0)]
    stable = all((each.name, each.where) == (effect.name, effect.where) for each in winners)
    everywhere, inside = (by_recording[best] > 0).all(), found.free[own].all()
    accepted = bool(z > settings.sure and everywhere and stable and inside)
    if not accepted and z < settings.tried:
        return None
    moved = found.x[:5] / np.maximum(base.x[:5], 1e-12) - 1
    return DetectedEffect(effect, found.x[own], float(gain.sum()), z, accepted, moved), found


def vuong(gains: Array, cost: float) -> float:
    """Return Vuong's z of the gains of blocks of time, minus the cost of additional unknowns."""
    deviation = float(gains.std(ddof=1)) if len(gains) > 1 else np.inf
    return float(gains.sum() - cost) / max(deviation * float(np.sqrt(len(gains))), 1e-9)


def _predicted(base: LikelihoodFit, candidates: Sequence[Effect]) -> Iterator[tuple[float, Effect]]:
    """Yield the predicted decrease of J by one scoring step with each candidate."""
    at = base.likelihood.shared
    for together in ([c for c in candidates if not c.blind], *([c] for c in candidates if c.blind)):
        like, x = base.likelihood.extended(together, base.x)
        if together[0].name == 'lag':
            x[14] = np.clip(x[14] - x[at], like.lower[14], like.upper[14])
        evaluation = like.evaluate(x)
        if not np.isfinite(evaluation.cost):
            continue
        owner = np.repeat(np.arange(len(together)), [len(c.unknowns) for c in together])
        for k, candidate in enumerate(together):
            free = np.insert(base.free, at, owner == k)
            H, g = evaluation.information[np.ix_(free, free)], evaluation.slope[free]
            scale = np.sqrt(np.where(np.diag(H) > 0, np.diag(H), 1.0))
            damped = H / scale / scale[:, None] + 1e-9 * np.eye(len(g))
            gain = g / scale @ np.linalg.solve(damped, g / scale) / 2
            yield base.evaluation.cost - evaluation.cost + float(gain), candidate
