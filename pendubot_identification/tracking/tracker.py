# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The tracker of a rig: a first motion starts the filter, and each further block updates it.

The first motion gives the delay, the smoothing, the noise and the prior of the filter.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.quadratic import SIZING, Quadratic, box_factor
from pendubot_identification.criteria.weak import WIDTH, estimate_delay, residual_weights, weak_regression
from pendubot_identification.errors import ExcitationError, PendubotError
from pendubot_identification.level import POOR, Level
from pendubot_identification.model.parameters import FRICTION, MODELS, NAMES, Bounds, Parameters, default_bounds
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import (
    SMOOTHING,
    choose_smoothing,
    differentiate,
    encoder_step,
    resample,
)
from pendubot_identification.trajectories.trajectory import Trajectory

from .blocks import BLOCK, STILL, Block, Samples, SegmentSettings
from .events import NOT_AS_BEFORE, Change, Event, Lost, Start, State, TrackerSettings
from .filter import DEAD_ZONE, DELAY, RATE, TILT, ChangeType, Estimate, Innovations, Noise, StepChange
from .following import Following, step

#: Largest number of samples that are appended at once.
PORTION = 8192
#: Scales of delay [s] and rate [1/s]; longest delay [s]; largest tilt [kg m] and dead zone [N m] of a rig
#: within the default bounds.
DELAY_SCALE, RATE_SCALE, LONGEST_DELAY, LARGEST = 0.01, 1e-3, 0.1, 5.0
#: Relative deviation of theta before any motion.
UNKNOWN = 10.0
#: Widest smoothing of whitened rows [s]: they are less sensitive to noise than to distorted motion.
WIDEST = 0.03


class Tracker:
    """Estimates the current parameters of a rig from its samples."""

    def __init__(self, start: Start | None = None) -> None:
        self._settings = TrackerSettings()
        self._start = start or Start()
        self._bounds = default_bounds().of(MODELS[self._start.model])
        self._samples = Samples()
        self.state: State | None = None  #: the newest parameters; None before tracking starts.
        self.reason = ''  #: the reason why tracking has not started.
        self.reset()

    def reset(self) -> None:
        """Restart tracking without any samples."""
        self._samples.clear()
        self._pause, self._attempted = self._settings.pause, -math.inf
        self._restart()

    def _restart(self) -> None:
        self._following: Following | None = None
        self.state, self.reason = None, f'{self._settings.first:g} s of motion without a gap are needed'

    @property
    def waiting(self) -> str:
        """The reason why more samples are needed, as a sentence; empty after tracking has started."""
        return self.reason and f'{self.reason}; waiting for more motion'

    @property
    def segment_settings(self) -> SegmentSettings | None:
        """The settings of the regression rows; None before tracking starts."""
        return None if self._following is None else self._following.segment

    @property
    def notes(self) -> dict[str, int]:
        """The count of each fault of samples."""
        return self._samples.notes

    def feed(self, samples: Array) -> Iterator[State | Event]:
        """Process samples, rows of t [s], q1, q2 [rad], tau1, tau2 [N m]; yield states and events in order."""
        for begin in range(0, len(samples), PORTION):
            for _ in self._samples.append(samples[begin : begin + PORTION]):
                yield from self._follow()

    def _follow(self) -> Iterator[State | Event]:
        """Process the complete blocks."""
        if self._following is None:
            self._begin()
            yield from () if self._following is None else self._following.events
        while self._following is not None and (blocks := self._samples.take_blocks(self._following.segment)):
            for block in blocks:
                self._following, state = step(self._following, block)
                yield from self._following.events
                if any(isinstance(event, Lost) for event in self._following.events):
                    self._samples.clear()
                    self._restart()
                    return
                self.state, self.reason = state, ''
                yield state

    def _begin(self) -> None:
        """Start tracking as soon as the newest motion determines the parameters."""
        s, t = self._settings, self._samples.newest[:, 0]
        # The last attempt is long ago, or the clock was reset since then.
        if not t[0] - s.longest_pause <= self._attempted <= t[-1]:
            self._pause, self._attempted = s.pause, -math.inf
        while self._following is None:
            due = max(t[0] + s.first, self._attempted + self._pause)
            # Two samples remain, and show an implausible interval.
            oldest = min(np.searchsorted(t, min(due, t[-1]) - s.longest_first, side='right'), max(len(t) - 2, 0))
            newest = self._samples.newest = self._samples.newest[oldest:]
            t = newest[:, 0]
            if t[-1] < due:
                return
            first, pause = newest[: max(np.searchsorted(t, due, side='right'), 2)], self._pause
            # Growing pauses limit the cost of attempts.
            self._attempted, self._pause = due, min(2 * pause, s.longest_pause)
            try:
                if (np.ptp(first[:, 1:3], axis=0) < STILL).all():
                    raise ExcitationError('nothing moves')
                motion = Trajectory(first[:, 0], first[:, 1:3], first[:, 3:5], name='the first motion')
                self._following = start_following(motion, self._start, self._bounds, s)
            except PendubotError as error:
                self.reason = f'{np.ptp(first[:, 0]):.0f} s do not determine the parameters ({error})'
                if isinstance(error, ExcitationError):
                    self._pause = pause


def start_following(motion: Trajectory, start: Start, bounds: Bounds, settings: TrackerSettings) -> Following:
    """Return the estimate before a first motion, with a change as event if the parameters of the start do not fit.

    Raises:
        PendubotError: the motion is too short, has gaps, or does not determine the parameters.
    """
    level, why = start.validate(motion)
    if level is Level.ERROR:
        raise PendubotError('; '.join(why))
    factor = _box_factor(motion, start, bounds)
    bounds = bounds.scaled(factor)
    unbound = bounds.beside((DELAY,), LONGEST_DELAY).beside((*TILT, DEAD_ZONE), LARGEST * factor)
    within = unbound.replaced(DELAY, *start.delays)
    segment, weighted = _segment_settings(motion, start, bounds)
    segment, blocks, x, present = _explained(motion, segment, within, settings)
    excess = math.sqrt(np.mean([block.residual(x[-3:]) for block in blocks]))
    if excess > settings.unmodelled:
        blocks = _moving_blocks(motion, weighted, settings)
        # The residual keeps its size in units of quantization.
        factor = excess / math.sqrt(np.mean([block.residual() for block in blocks]))
        segment = replace(weighted, weights=factor * weighted.weights)
        blocks = _moving_blocks(motion, segment, settings)
        x = _pooled(blocks).minimum(_fixed(within, ()))

    size, searched = len(bounds.names), float(np.ptp(start.delays))
    noise = Noise.of(blocks, x, settings.noise_memory)
    effort = float(np.sqrt(np.mean(motion.tau**2))) + 1e-9
    theta_scale = _theta_scale(x[:size], motion, effort)
    scale = np.concatenate([theta_scale, [DELAY_SCALE], theta_scale[3:5], [0.01 * effort, RATE_SCALE]])
    gate = float(chdtri(len(scale), settings.false_alarm))
    names = (*within.names, RATE)
    walk = scale * np.where(np.isin(names, FRICTION), settings.friction_walk, settings.inertia_walk)
    mean, deviation = np.append(x, 0.0), np.where(np.isin(names, present), scale, settings.inertia_walk * scale)
    deviation[:size], deviation[size] = UNKNOWN * theta_scale, max(searched, deviation[size])
    prior, rows = Estimate(mean, np.diag(deviation)), [noise.rows(block) for block in blocks]
    updated = prior.measurement_update(Innovations.of(prior, rows))
    # The jackknife: wrong samples in one block may dominate all others.
    others = (_pooled([*blocks[:k], *blocks[k + 1 :]]) for k in range(len(blocks)))
    spread = np.std([each.minimum(_fixed(within, present)) for each in others], axis=0) * math.sqrt(len(blocks) - 1)
    poor = ~(np.maximum(updated.std_error[:5], spread[:5]) <= POOR * theta_scale[:5])  # also if it is NaN
    if poor.any():
        raise PendubotError(f'poorly determined: {", ".join(np.array(NAMES[:5])[poor])}')
    beginning = within if searched else unbound, scale, walk, effort, gate, level, tuple(why), segment, noise
    following = Following(settings, *beginning, prior, prior).after(prior, motion.t[0])
    if start.theta is None:
        return following

    more = np.where(np.isin(bounds.names, FRICTION), settings.friction_carried_over, settings.carried_over)
    error = 0.0 if start.std_error is None else start.std_error
    deviation[:size] = np.hypot(error, more * theta_scale)
    known = Estimate(np.append(start.theta, mean[size:]), np.diag(deviation))
    innovations, pooled = Innovations.of(known, rows), _pooled(blocks)
    worse = float(pooled(known.mean[:-1]) / pooled(x))
    if innovations.ratio <= gate if segment.whitened else worse <= settings.rejected:
        return following.after(known, motion.t[0])
    step = StepChange.of(ChangeType(NOT_AS_BEFORE, np.diag(scale)), innovations, scale)
    changed = step.significant(following.names) if step.possible(known.mean, scale) else {}
    return replace(following, events=(Change(-math.inf, blocks[0].begin, NOT_AS_BEFORE, changed),))


def _box_factor(motion: Trajectory, start: Start, bounds: Bounds) -> float:
    """Return the factor by which default bounds must grow for the rig of a first motion."""
    states = Motion.prepare(motion, SMOOTHING, start.hold)
    regression = weak_regression(states, SIZING, max(start.delays[0], 0.0), stride=WIDTH / 3, coarse=True)
    return box_factor(bounds.completed(), Quadratic.reduce(regression.phi, regression.y))


def _segment_settings(motion: Trajectory, start: Start, bounds: Bounds) -> tuple[SegmentSettings, SegmentSettings]:
    """Return the settings for whitened rows, and for rows of the criterion weak.

    Raises:
        PendubotError: the motion is too short, has gaps, or gives parameters that are not physical.
    """
    window = choose_smoothing([motion])
    prepared, (low, high) = Motion.prepare(motion, window, start.hold), start.delays
    delay = low if low == high else estimate_delay([prepared], start.model, bounds, low, high)
    regression = weak_regression(prepared, start.model, delay)
    weights = residual_weights([regression], bounds)
    row_weights = np.tile(weights, len(regression.y) // 3)
    theta = Quadratic.reduce(row_weights[:, None] * regression.phi, row_weights * regression.y).minimum(bounds)
    if problems := Parameters.from_vector(theta).unphysical():
        raise PendubotError(f'not physical: {problems[0]}')
    even, quanta = resample(motion).q, encoder_step(motion.q)
    removed = np.std(even - differentiate(even, prepared.interval, window)[0], axis=0)
    variance = np.maximum(np.where(quanta > 0, quanta / np.sqrt(12), removed), 1e-6) ** 2
    weighted = SegmentSettings(
        start.model, delay, start.hold, prepared.interval, window, theta, variance, bool(quanta.all()), weights, False
    )
    return replace(weighted, smoothing=min(window, WIDEST), whitened=True), weighted


def _explained(
    motion: Trajectory, segment: SegmentSettings, bounds: Bounds, settings: TrackerSettings
) -> tuple[SegmentSettings, list[Block], Array, tuple[str, ...]]:
    """Return the settings, blocks and unknowns of a first motion, and the names of tilt and dead zone that it needs.

    If no selection of them reduces the residual to the quantization level, the rig has other effects, and both are 0.
    """
    plain = _moving_blocks(motion, segment, settings)
    for present in ((), TILT, (DEAD_ZONE,), (*TILT, DEAD_ZONE)):
        tried, blocks = segment, plain
        # Iterate, because whitening depends on theta, and the rows are not linear in the dead zone.
        for _ in range(3 if present else 1):
            pooled = _pooled(blocks)
            x = pooled.minimum(_fixed(bounds, present))
            if math.sqrt(pooled(x)) < settings.unmodelled:
                return tried, blocks, x, present
            if Parameters.from_vector(x[:-4]).unphysical():
                break
            tried = replace(tried, theta=x[:-4], dead_zone=max(float(x[-1]), 0.0))
            blocks = _moving_blocks(motion, tried, settings)
    return segment, plain, _pooled(plain).minimum(_fixed(bounds, ())), ()


def _fixed(bounds: Bounds, present: Sequence[str]) -> Bounds:
    """Return the bounds with tilt and dead zone fixed at 0, except for the present ones."""
    return bounds.without({*TILT, DEAD_ZONE} - set(present))


def _moving_blocks(motion: Trajectory, segment: SegmentSettings, settings: TrackerSettings) -> list[Block]:
    """Return the blocks of a first motion that contain motion."""
    samples, blocks = Samples(np.column_stack([motion.t, motion.q, motion.tau])), list[Block]()
    while more := samples.take_blocks(segment):
        blocks += [block for block in more if block.rows]
    if len(blocks) * BLOCK < settings.first / 2:
        raise ExcitationError(f'only {len(blocks) * BLOCK:.1f} s of them move')
    return blocks


def _pooled(blocks: Sequence[Block]) -> Quadratic:
    return Quadratic.pool([Quadratic(block.r_factor, block.rows) for block in blocks])


def _theta_scale(theta: Array, motion: Trajectory, effort: float) -> Array:
    """Return the scale of each parameter, shape (D,): its size, or at least the size with a relevant torque."""
    speed = float(np.sqrt(np.mean(np.square(np.diff(motion.q, axis=0) / np.diff(motion.t)[:, None])))) + 1e-3
    least = {'P': theta[:5].max() * 0.1, 'J': theta[1] * 0.1, 'b': 0.02 * effort / speed, 'F': 0.02 * effort, 'k': 0.02}
    return np.maximum(np.abs(theta), [least[name[0]] for name in NAMES[: len(theta)]])
