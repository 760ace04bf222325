# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A rig that is followed, block by block: predict, gate, update, detect, report.

A block that is predicted updates the estimate. One that is not waits for the next ones: where one step of theta
explains them all, theta changed, and they update it after it has been freed to do so; where predicted ones follow, it
was a disturbance, such as a push by hand, and is ignored; where nothing explains them for long, all begins anew.
Beside the estimate runs that of the other hypothesis on the motor: that its gain drifts, or no longer drifts. Where
it predicts better, by the sequential test of Page (Continuous inspection schemes, Biometrika 41, 1954), it takes the
estimate's place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.errors import ExcitationError, PendubotError
from pendubot_identification.level import POOR, Level
from pendubot_identification.model.parameters import NAMES, Bounds, Parameters
from pendubot_identification.trajectories.trajectory import Trajectory

from .blocks import Block, Blocks, Samples, SegmentSettings
from .changes import DEAD_ZONE, DELAY, DRIFT, RATE, SEVERAL, TILT, ChangeType, StepChange, Window, kinds
from .events import NOT_AS_BEFORE, Change, Disturbance, Event, Lost, Start, State
from .filter import Estimate, Noise, left_given
from .residuals import BLOCK
from .settings import TrackerSettings

Array = NDArray[np.float64]

#: The scales of delay [s] and rate [1/s], the longest delay, and the largest value of other unknowns beside theta.
DELAY_SCALE, RATE_SCALE, LONGEST_DELAY, LARGEST = 0.01, 1e-3, 0.1, 5.0
#: The deviation of theta before any motion, in its scale; the squared residual that a torque from outside leaves alone.
UNKNOWN, FOREIGN = 1e3, 1000.0


class _Step(NamedTuple):
    """A block, its rows with noise 1, and the estimate before it.

    ``left`` is how many times more than usual it leaves unexplained, in squares, ``ratio`` that of its own window;
    it updated the estimate where it was ``predicted``.
    """

    block: Block
    rows: Array
    before: Estimate
    left: float
    ratio: float
    likelihood: float
    predicted: bool


class Following:
    """The estimate of parameters, tilt, dead zone, delay and drift, from the first motion on.

    In units of a scale, shape (D+5,), all are about 1.
    """

    def __init__(self, motion: Trajectory, start: Start, bounds: Bounds, settings: TrackerSettings) -> None:
        """Find out from a first motion how to listen.

        Raises:
            PendubotError: it is too short, has gaps, or does not tell the parameters.
        """
        self._settings = settings
        segment_settings = SegmentSettings.of(motion, start.model, bounds, start.delays, start.hold)
        low, high = start.delays
        unbound = bounds.beside((DELAY,), LONGEST_DELAY).beside((*TILT, DEAD_ZONE), LARGEST)
        self._bounds = unbound.replaced(DELAY, low, high) if low < high else unbound
        self._names = (*unbound.names, RATE)
        first = unbound.replaced(DELAY, low, high)
        segment_settings, found, x, present = _explained(motion, segment_settings, first, settings)
        self._beyond = math.sqrt(np.mean([left_given(block, x[-3:]) for block in found]))
        if self._beyond > settings.lacking:
            segment_settings = replace(segment_settings, whitened=False)
            found = _moving(motion, segment_settings, settings)
            x = _pooled(found).minimum(_fixed(first, present))
        self._size = size = len(bounds.names)
        if problems := Parameters.from_vector(x[:size]).unphysical():
            raise PendubotError(f'not physical: {problems[0]}')
        effort = float(np.sqrt(np.mean(motion.tau**2))) + 1e-9
        theta_scale = _scale(x[:size], motion, effort)
        self._scale = np.concatenate([theta_scale, [DELAY_SCALE], theta_scale[3:5], [0.01 * effort, RATE_SCALE]])
        self._noise = Noise([self._scaled(block) for block in found], x / self._scale[:-1], settings)
        self.blocks = Blocks(segment_settings)
        # Of theta next to nothing is known beforehand; the delay lies between its bounds, or is given.
        deviation = np.array([UNKNOWN] * size + [settings.fixed] * 5)
        deviation[size] = max((high - low) / DELAY_SCALE, settings.fixed)
        mean = np.append(x / self._scale[:-1], 0.0)
        mean[:size], mean[size] = 0.0, segment_settings.delay / DELAY_SCALE
        deviation[[name in present for name in self._names]] = 1.0
        self._estimate = updated = Estimate.of(mean, deviation)
        rows = [self._noise.rows(self._scaled(block)) for block in found]
        for each in rows:
            updated = updated.measurement_update(each)
        poor = (np.sqrt(np.diag(updated.covariance)) > POOR)[:5]
        if poor.any():
            raise PendubotError(f'poorly determined: {", ".join(np.array(NAMES[:5])[poor])}')
        friction = np.array([name[0] in 'bFk' for name in self._names])
        self._walk = np.where(friction, settings.friction_walk, settings.inertia_walk)
        self._opening: Change | None = None
        self._steps: list[_Step] = []
        self._time = self._moved = self._unexplained = math.nan
        self._drifts, self._rival = False, self._estimate
        if start.theta is not None:
            error = (0.0 if start.std_error is None else start.std_error) / theta_scale
            more = np.where(friction[:size], settings.friction_carried_over, settings.carried_over)
            mean[:size], deviation[:size] = start.theta / theta_scale, np.hypot(error, more)
            self._carry_over(Estimate.of(mean, deviation), found, rows)
        self._fork(motion.t[0])
        self.level, self.why = start.validate(motion)
        if self.level is Level.ERROR:
            raise PendubotError('; '.join(self.why))

    @property
    def segment_settings(self) -> SegmentSettings:
        """How samples are made weak-form residuals of."""
        return self.blocks.segment_settings

    @property
    def _left(self) -> float:
        """How many times what errors of the angles explain is left unexplained, in root mean squares."""
        return self._noise.beyond if self.segment_settings.whitened else self._beyond

    @property
    def _lacking(self) -> bool:
        """Whether the rig has unmodelled effects."""
        return self._left > self._settings.lacking

    def _scaled(self, block: Block) -> Block:
        return block._replace(r_factor=block.r_factor * np.append(self._scale[:-1], 1.0))

    def _carry_over(self, known: Estimate, found: Sequence[Block], rows: Sequence[Array]) -> None:
        """Begin with what was known beforehand, as far as the first blocks do not reject it."""
        window = Window.of(known, rows)
        if self.segment_settings.whitened:
            denied = window.ratio >= self._settings.denied
        else:
            pooled = _pooled(found)
            best = float(pooled(pooled.minimum(self._bounds)))
            denied = float(pooled((known.mean * self._scale)[:-1])) >= self._settings.worse * best
        if not denied:
            self._estimate = known
        else:
            step_change = window.step_change(
                [ChangeType(NOT_AS_BEFORE, np.eye(len(self._scale)))], known.mean, self._settings
            )
            self._opening = Change(
                -math.inf, found[0].begin, NOT_AS_BEFORE, {} if step_change is None else self._described(step_change)
            )

    def take(self, block: Block) -> Iterator[Event]:
        """Learn from a block, or not yet, and return what happened."""
        if self._opening is not None:
            yield self._opening
            self._opening = None
        self._predict(block)
        if not block.rows:
            return
        self._moved = block.end
        step, waited = self._gate(block), self._waiting()
        self._steps = [*self._steps, step][-max(self._settings.window, len(waited) + 1) :]
        if change := self._detect():
            yield change
        elif step.predicted:
            if any(each.ratio > self._settings.change or each.left > FOREIGN for each in waited):
                yield Disturbance(waited[0].block.begin, waited[-1].block.end)
            if drift := self._update(step):
                yield drift
        elif len(waited) + 1 >= self._settings.lost:
            yield Lost(waited[0].block.begin, block.end)

    def _predict(self, block: Block) -> None:
        """Let both hypotheses drift until a block."""
        since = block.begin - self._time
        self._time = block.begin
        # A clock that began anew tells nothing of the time since.
        since = max(since, BLOCK) if since == since else BLOCK
        # What wears in motion need not do so at rest.
        worn = since if block.begin - self._moved < self._settings.idle else 0.0
        self._estimate = self._advanced(self._estimate, since, worn, self._drifts)
        self._rival = self._advanced(self._rival, since, worn, not self._drifts)

    def _advanced(self, estimate: Estimate, since: float, worn: float, drifts: bool) -> Estimate:
        deviation = self._walk * math.sqrt(since)
        if drifts:
            deviation[-1] = self._settings.rate_walk * math.sqrt(since)
        return estimate.time_update(deviation, worn * self._worn(estimate))

    def _worn(self, estimate: Estimate) -> Array:
        """Return what a rate of one scale moves in a second, shape (D+5,): theta."""
        return np.append(RATE_SCALE * estimate.mean[: self._size], np.zeros(5))

    def _gate(self, block: Block) -> _Step:
        """Compare a block with the prediction."""
        scaled = self._scaled(block)
        rows, left = self._noise.rows(scaled), self._noise.left(scaled)
        window = Window.of(self._estimate, [rows])
        predicted = window.ratio <= self._settings.gate
        return _Step(block, rows, self._estimate, left, window.ratio, window.likelihood, predicted)

    def _update(self, step: _Step) -> Change | None:
        """Learn from a block, and decide between the two hypotheses."""
        self._estimate = step.before.measurement_update(step.rows)
        self._noise.update(self._scaled(step.block), step.before)
        self._relinearise()
        self._likelihood_ratio += 2 * (Window.of(self._rival, [step.rows]).likelihood - step.likelihood)
        self._rival = self._rival.measurement_update(step.rows)
        if self._likelihood_ratio <= 0:
            self._fork(step.block.end)
        threshold = self._settings.drift * (self._settings.more if self._lacking else 1.0)
        if self._likelihood_ratio <= threshold:
            return None
        # It began or ended since the onset, or little before: what is small shows in many blocks only.
        self._drifts, since = not self._drifts, self._onset - self._settings.window * BLOCK
        rate = max(abs(self._estimate.mean[-1]), abs(self._rival.mean[-1]))
        worn = rate * (step.block.end - since) * self._worn(self._rival)
        self._estimate = self._rival.inflate_covariance(worn[:, None])
        self._fork(step.block.end)
        self._steps = []
        if not self._drifts:
            return None
        moved = (step.block.end - since) * self._worn(self._estimate)
        rate, error = self._estimate.mean[-1], math.sqrt(self._estimate.covariance[-1, -1])
        drift = ChangeType(DRIFT, moved[:, None])
        return Change(
            since, step.block.end, DRIFT, self._described(StepChange(drift, rate * moved, error * np.abs(moved), 0.0))
        )

    def _fork(self, now: float) -> None:
        """Let the other hypothesis begin anew from the estimate."""
        self._rival = self._estimate.with_rate(self._settings.fixed if self._drifts else 1.0)
        self._likelihood_ratio, self._onset = 0.0, now

    def _relinearise(self) -> None:
        """Take the effort with the estimated delay and dead zone where rows are no longer straight in them."""
        x = np.clip((self._estimate.mean * self._scale)[:-1], self._bounds.lower, self._bounds.upper)
        delay, dead = float(x[self._size]), max(float(x[-1]), 0.0)
        moved = (
            np.abs([delay - self.segment_settings.delay, dead - self.segment_settings.dead_zone])
            / self._scale[[self._size, -2]]
        )
        if (moved > self._settings.relinearise).any():
            self.blocks.segment_settings = replace(self.segment_settings, delay=delay, dead_zone=dead)

    def _waiting(self) -> list[_Step]:
        """Return the last blocks that did not update the estimate."""
        count = next((k for k, step in enumerate(reversed(self._steps)) if step.predicted), len(self._steps))
        return self._steps[len(self._steps) - count :]

    def _rows(self, steps: Sequence[_Step]) -> list[Array]:
        """Return the rows of steps, with what a rate has moved since the first of them."""
        worn, rows = BLOCK * self._worn(steps[0].before), [step.rows.copy() for step in steps]
        for k, each in enumerate(rows):
            each[:, -2] = k * each[:, :-1] @ worn
        return rows

    def _detect(self) -> Change | None:
        """Look for the window of two blocks or more that speaks most for one step; if so, believe in that."""
        s = self._settings
        clean = [step for step in self._steps[-s.window :] if step.left < s.clean]
        waiting = sum(step.left < s.clean for step in self._waiting())
        least, changed = 2 if waiting else s.window, s.more * s.change if self._lacking else s.change
        best = None
        # What is small shows in many blocks only.
        for count in range(least, len(clean) + 1):
            steps = clean[-count:]
            window = Window.of(steps[0].before, self._rows(steps))
            sure = window.evidence > changed or (waiting >= s.window and window.ratio > s.gate)
            if sure and window.left < s.explained and (best is None or window.evidence > best[0].evidence):
                best = window, steps
        if best is None:
            return None
        window, steps = best
        before = steps[0].before
        named = kinds(self._names, before.mean * self._scale)
        step_change = window.step_change(
            [ChangeType(k.name, k.directions / self._scale[:, None]) for k in named], before.mean, s
        )
        if step_change is None or (step_change.kind.name == SEVERAL and len(steps) < s.agreeing):
            return None
        estimate = before.inflate_covariance(
            step_change.kind.directions / np.abs(step_change.kind.directions).max(axis=0)
        )
        for rows in self._rows(steps):
            estimate = estimate.measurement_update(rows)
        self._estimate = self._advanced(estimate, BLOCK, BLOCK * (len(steps) - 1), self._drifts)
        self._fork(self._steps[-1].block.end)
        # It may have happened under the blocks before, if they are not predicted either.
        first = next(k for k, step in enumerate(self._steps) if step is steps[0])
        earlier = first
        while earlier and not self._steps[earlier - 1].predicted:
            earlier -= 1
        begin = self._steps[earlier].block.begin - (BLOCK if earlier == first else 0.0)
        if earlier and self._steps[earlier - 1].block.begin < begin - BLOCK:
            # Or at any time since the last motion before a rest.
            begin = self._steps[earlier - 1].block.begin
        self._steps = []
        # Under its first block it may have happened until most test functions knew of it.
        return Change(begin, steps[0].block.begin + BLOCK, step_change.kind.name, self._described(step_change))

    def _described(self, step_change: StepChange) -> dict[str, tuple[float, float]]:
        """Return the parameters that moved beyond doubt."""
        step, error = step_change.step * self._scale, step_change.std_error * self._scale
        sure = np.abs(step) > 3 * error
        return {self._names[k]: (float(step[k]), float(error[k])) for k in np.flatnonzero(sure)}

    def state(self, block: Block) -> State:
        """Report what is true after a block."""
        size = self._size
        errors = np.sqrt(np.diag(self._estimate.covariance)) * self._scale
        errors = errors * math.sqrt(self._settings.common if self._lacking else 1)
        x = self._physical()
        if block.rows:
            self._unexplained = block.unexplained(x)
        # Gravity along the base, and across it.
        across = x[size + 1 : size + 3]
        tilt = math.atan2(across.sum(), x[3:5].sum())
        theta, std_error = x[:size].copy(), errors[:size]
        theta[3:5] = math.cos(tilt) * x[3:5] + math.sin(tilt) * across
        warnings = (*self.why, *self._doubts(block, theta, std_error, tilt, float(x[-1]), float(errors[-2])))
        level = max(self.level, Level.WARN if warnings else Level.OK)
        t, delay = (block.begin + block.end) / 2, (float(x[size]), float(errors[size]))
        return State(t, theta, std_error, *delay, level, warnings, self._unexplained, moving=bool(block.rows))

    def _doubts(
        self, block: Block, theta: Array, std_error: Array, tilt: float, dead: float, dead_error: float
    ) -> Iterator[str]:
        idle = block.end - self._moved if self._moved == self._moved else math.inf
        if idle > self._settings.idle:
            yield f'nothing has moved for {idle:.0f} s: the parameters are of then, and ever less sure'
        poor = std_error[:5] > POOR * np.abs(theta[:5])
        if poor.any():
            names = ', '.join(np.array(NAMES[:5])[poor])
            yield f'poorly determined: the standard error of {names} exceeds half the value'
        if abs(tilt) > self._settings.tilt:
            yield (
                f'the base is tilted in the plane of motion by {math.degrees(tilt):.2f} deg, or the zero of the '
                'shoulder is off by that; level the base, or set the zeros anew'
            )
        if self.segment_settings.dead_zone > 0 and dead > 3 * dead_error:
            yield f'the motor has a dead zone of {dead:.3g} N m: so much of every torque does not act'
        if self.segment_settings.rounded and self._lacking:
            yield (
                f'what is left unexplained is {self._left:.1f} times what rounded angles explain: the rig has '
                'what the models lack, or is sampled too slowly; parameters may be farther off than their bands say'
            )
        if self._waiting():
            yield 'the last motion is not explained: a hand, a change, or something that the model lacks'
        if block.saturated:
            yield 'the effort stands at its limit; if more was asked for than the motor gives, less has acted'

    def _physical(self) -> Array:
        """Return the estimate without the rate, or the likeliest physical one where it is not."""
        x, size = (self._estimate.mean * self._scale)[:-1], self._size
        inside = (x >= self._bounds.lower).all() and (x <= self._bounds.upper).all()
        if inside and not Parameters.from_vector(x[:size]).unphysical():
            return np.asarray(x)
        given_rate = self._estimate.right - self._estimate.r_factor[:, -1] * self._estimate.mean[-1]
        rows = np.column_stack([self._estimate.r_factor[:, :-1] / self._scale[:-1], given_rate])
        return Quadratic(rows, 1).minimum(self._bounds)


def _moving(motion: Trajectory, segment_settings: SegmentSettings, settings: TrackerSettings) -> list[Block]:
    """Return a first motion's blocks, but those in which nothing moves."""
    samples = Samples(np.column_stack([motion.t, motion.q, motion.tau]))
    found = [block for block in Blocks(segment_settings).complete(samples) if block.rows]
    if len(found) * BLOCK < settings.first / 2:
        raise ExcitationError(f'only {len(found) * BLOCK:.1f} s of them move')
    return found


def _pooled(found: Sequence[Block]) -> Quadratic:
    return Quadratic.pool([Quadratic(block.r_factor, block.rows) for block in found])


def _explained(
    motion: Trajectory, segment_settings: SegmentSettings, bounds: Bounds, settings: TrackerSettings
) -> tuple[SegmentSettings, list[Block], Array, tuple[str, ...]]:
    """Return how a first motion is taken, its blocks, all unknowns, and the fewest of tilt and dead zone that it needs.

    Where none of them leave the encoders' quantization alone, all are 0: the rig has other effects.
    """
    without = _moving(motion, segment_settings, settings)
    for present in ((), TILT, (DEAD_ZONE,), (*TILT, DEAD_ZONE)):
        found, made, within = without, segment_settings, _fixed(bounds, present)
        # Rows are whitened by theta, and not straight in a dead zone.
        for _ in range(3 if present else 1):
            pooled = _pooled(found)
            x = pooled.minimum(within)
            if not present:
                fallback = x
            if math.sqrt(pooled(x)) < settings.lacking:
                return made, found, x, present
            accuracy = replace(made.accuracy, theta=x[:-4])
            made = replace(made, accuracy=accuracy, dead_zone=max(float(x[-1]), 0.0))
            found = _moving(motion, made, settings)
    return segment_settings, without, fallback, ()


def _fixed(bounds: Bounds, present: Sequence[str]) -> Bounds:
    """Return the bounds with tilt and dead zone fixed at 0, but for those that are present."""
    for name in {*TILT, DEAD_ZONE} - set(present):
        bounds = bounds.replaced(name, 0.0, 0.0)
    return bounds


def _scale(theta: Array, motion: Trajectory, effort: float) -> Array:
    """Return the size of each parameter: its own, or for what is nearly nothing what would matter beside the others."""
    speed = float(np.sqrt(np.mean(np.square(np.diff(motion.q, axis=0) / np.diff(motion.t)[:, None])))) + 1e-3
    least = {'P': theta[:5].max() * 0.1, 'J': theta[1] * 0.1, 'b': 0.02 * effort / speed, 'F': 0.02 * effort, 'k': 0.02}
    return np.maximum(np.abs(theta), [least[name[0]] for name in NAMES[: len(theta)]])
