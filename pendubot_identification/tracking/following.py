# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One step of the tracker: predict, gate, update, detect, report.

A block inside the innovation gate updates the estimate; one outside waits for the next blocks. If one step of the
unknowns explains them all, the unknowns changed. If the next block is inside the gate again, it was a disturbance, such
as a push by hand, and is ignored. If nothing explains the motion for long, tracking restarts.

A gradual change of the motor stays inside the gate. Two hypotheses are tracked: its gain drifts, or does not. The rival
of the current one takes its place if it predicts better, by the sequential test of Page (Continuous inspection schemes,
Biometrika 41, 1954).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.level import POOR, Level
from pendubot_identification.model.parameters import NAMES, Bounds, Parameters

from .blocks import BLOCK, Block, SegmentSettings
from .events import Change, Disturbance, Event, Lost, State, TrackerSettings
from .filter import DRIFT, RATE, SEVERAL, ChangeType, Estimate, Innovations, Noise, StepChange, most_likely_step


class Prediction(NamedTuple):
    """A block, its rows, the estimate before it, and its innovations under both hypotheses."""

    block: Block
    rows: Array
    before: Estimate
    innovations: Innovations
    rival: Innovations
    inside: bool  #: whether the block is inside the innovation gate of a hypothesis.


@dataclass(frozen=True, slots=True)
class Following:
    """The estimate after a block, under both hypotheses on the motor's gain."""

    settings: TrackerSettings
    bounds: Bounds  #: of all unknowns but the rate: theta, delay, tilt and dead zone.
    scale: Array  #: size of each unknown, shape (D,).
    walk: Array  #: deviation of the random walk of each unknown in a second, if the gain does not drift, shape (D,).
    effort: float  #: RMS of the first motion [N m].
    gate: float  #: likelihood ratio of a block that noise exceeds with the probability of a false alarm.
    level: Level  #: of the first motion.
    why: tuple[str, ...]  #: warnings of the level.
    first_segment: SegmentSettings  #: of the first motion.
    noise: Noise
    estimate: Estimate
    rival: Estimate  #: under the other hypothesis.
    drifts: bool = False  #: whether the gain drifts in ``estimate``.
    page: float = 0.0  #: likelihood ratio of the rival since the onset.
    onset: float = 0.0  #: last time at which the rival was not more likely [s].
    time: float = math.inf  #: of the estimate [s]; infinite before the first block.
    recent: tuple[Prediction, ...] = ()  #: the newest predictions.
    moved: Block | None = None  #: the newest block that moved.
    events: tuple[Event, ...] = ()  #: events of the newest block.

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all unknowns."""
        return (*self.bounds.names, RATE)

    @property
    def segment(self) -> SegmentSettings:
        """The settings of the rows, linearised at the estimated delay and dead zone."""
        x = np.clip(self.estimate.mean[:-1], self.bounds.lower, self.bounds.upper)
        return replace(self.first_segment, delay=float(x[-4]), dead_zone=max(float(x[-1]), 0.0))

    @property
    def common(self) -> int:
        """The number of blocks with a common error: more than 1 on a rig with unmodelled effects."""
        return self.settings.common if self.noise.excess > self.settings.unmodelled else 1

    @property
    def limit(self) -> float:
        """The likelihood ratio beyond which a step or a disturbance is reported."""
        return self.gate * max(self.common, self.settings.change)

    @property
    def waiting(self) -> tuple[Prediction, ...]:
        """The newest predictions outside the gate."""
        inside = [k for k, each in enumerate(self.recent, 1) if each.inside]
        return self.recent[max(inside, default=0) :]

    def idle(self, now: float) -> float:
        """Return the time since the rig moved [s]; 0 before its first motion."""
        return 0.0 if self.moved is None else now - self.moved.end

    def after(self, estimate: Estimate, now: float) -> Following:
        """Return this state with another estimate, from which the rival hypothesis restarts."""
        rate = np.eye(len(self.scale))[:, -1:]
        deviation = self.scale[-1] * (self.settings.inertia_walk if self.drifts else 1.0)
        rival = estimate.time_update(deviation * rate, np.eye(len(rate)) - rate @ rate.T)
        return replace(self, estimate=estimate, rival=rival, page=0.0, onset=now)


def step(now: Following, block: Block) -> tuple[Following, State]:
    """Return the estimate and the events after a block, and the report."""
    after = predict(now, block)
    if block.rows:
        after = detect(update(after, gate(after, block)))
    return after, report(after, block)


def predict(now: Following, block: Block) -> Following:
    """Return both hypotheses at the time of a block."""
    elapsed = max(block.begin - now.time, BLOCK)  # also after a reset of the clock
    # A gain that drifts in motion may be constant at rest.
    drifting = 0.0 if now.idle(block.begin) >= now.settings.idle else elapsed
    return replace(
        now,
        events=(),
        time=block.begin,
        estimate=_advance(now, now.estimate, elapsed, drifting, now.drifts),
        rival=_advance(now, now.rival, elapsed, drifting, not now.drifts),
    )


def _advance(now: Following, estimate: Estimate, elapsed: float, drifting: float, drifts: bool) -> Estimate:
    """Return the estimate after a time [s]; the gain drifts for ``drifting`` [s]."""
    walk, transition = now.walk.copy(), np.eye(len(now.walk))
    if drifts:
        walk[-1] = now.scale[-1] * now.settings.rate_walk
    transition[:, -1] += drifting * _drift(estimate)
    return estimate.time_update(np.diag(walk * math.sqrt(elapsed)), transition)


def _drift(estimate: Estimate) -> Array:
    """Return the change of the unknowns per second at a rate of 1, shape (D,): theta, then zeros."""
    return np.concatenate([estimate.mean[:-5], np.zeros(5)])


def gate(now: Following, block: Block) -> Prediction:
    """Compare a block with its predictions."""
    rows = now.noise.rows(block)
    innovations, rival = Innovations.of(now.estimate, [rows]), Innovations.of(now.rival, [rows])
    limit = now.gate * (now.settings.heavy_tails if now.common > 1 else 1.0)
    return Prediction(block, rows, now.estimate, innovations, rival, min(innovations.ratio, rival.ratio) <= limit)


def update(now: Following, prediction: Prediction) -> Following:
    """Return both hypotheses after a block inside the gate; a block outside waits."""
    waiting = replace(now, recent=(*now.recent, prediction)[-now.settings.lost :], moved=prediction.block)
    if not prediction.inside:
        return waiting
    estimate = now.estimate.measurement_update(prediction.innovations)
    updated = replace(
        waiting,
        estimate=estimate,
        rival=now.rival.measurement_update(prediction.rival),
        page=now.page + 2 * (prediction.rival.log_likelihood - prediction.innovations.log_likelihood),
        noise=now.noise.updated(prediction.block, now.estimate),
    )
    return updated if updated.page > 0 else updated.after(estimate, prediction.block.end)


def detect(now: Following) -> Following:
    """Test for a step of the unknowns, motion that nothing explains, a disturbance, and a drift of the motor's gain."""
    if found := _detect_step(now):
        return _take_step(now, *found)
    newest, waiting = now.recent[-1], now.waiting
    if len(waiting) >= now.settings.lost:
        return replace(now, events=(Lost(waiting[0].block.begin, newest.block.end),))
    waited = replace(now, recent=now.recent[:-1]).waiting if newest.inside else ()
    if any(each.innovations.ratio > now.limit for each in waited):
        now = replace(now, events=(Disturbance(waited[0].block.begin, waited[-1].block.end),))
    return _take_rival(now) if now.page > -2 * math.log(now.settings.false_alarm) * now.common else now


def _detect_step(now: Following) -> tuple[StepChange, tuple[Prediction, ...]] | None:
    """Return the step that explains the newest blocks best, and these; None if no step is significant.

    A named type of change is preferred to an unnamed one, which also explains a change within the first block.
    """
    s, newest = now.settings, now.recent[-now.settings.window :]
    candidates = []
    # A step begins with a block outside the gate; a small step is visible in many blocks only.
    outside = [k for k, each in enumerate(newest[:-1]) if not each.inside]
    for first in outside or ([0] if len(newest) == s.window else []):
        blocks = newest[first:]
        innovations = Innovations.of(blocks[0].before, [each.rows for each in blocks])
        evidence = innovations.ratio / max(1.0, innovations.residual)
        if evidence <= now.limit or innovations.residual > s.explained:
            continue
        if change := most_likely_step(innovations, now.names, blocks[0].before.mean, now.scale):
            candidates.append((change.kind.name != SEVERAL, evidence, change, blocks))
    if not candidates:
        return None
    named, _, change, blocks = max(candidates, key=lambda candidate: candidate[:2])
    return (change, blocks) if named or len(blocks) >= s.window // 2 else None


def _take_step(now: Following, chosen: StepChange, blocks: Sequence[Prediction]) -> Following:
    """Return the estimate after a step that the newest blocks show."""
    estimate = blocks[0].before.time_update(chosen.kind.directions)
    estimate = estimate.measurement_update(Innovations.of(estimate, [each.rows for each in blocks]))
    estimate = _advance(now, estimate, BLOCK, BLOCK * (len(blocks) - 1), now.drifts)
    # The step may be in earlier waiting blocks, or under the last test functions of the block before.
    times = [each.block.begin for each in now.recent]
    first = earliest = len(times) - len(blocks)
    while earliest and not now.recent[earliest - 1].inside:
        earliest -= 1
    begin = times[earliest] - (BLOCK if earliest == first else 0.0)
    if earliest and times[earliest - 1] < begin - BLOCK:
        # The rig rested in between.
        begin = times[earliest - 1]
    change = Change(begin, times[first] + BLOCK, chosen.kind.name, chosen.significant(now.names))
    return replace(now, recent=(), events=(change,)).after(estimate, now.recent[-1].block.end)


def _take_rival(now: Following) -> Following:
    """Return the rival estimate, with a change as event if the motor's gain begins to drift."""
    end = now.recent[-1].block.end
    # The drift began or ended since the onset or shortly before: a small change is visible in many blocks only.
    begin = now.onset - now.settings.window * BLOCK
    drift = (end - begin) * _drift(now.rival)
    rate = max(abs(now.estimate.mean[-1]), abs(now.rival.mean[-1]))
    estimate = now.rival.time_update(rate * drift[:, None])
    taken = replace(now, drifts=not now.drifts, recent=()).after(estimate, end)
    if now.drifts:
        return taken
    error = float(estimate.std_error[-1])
    change = StepChange(ChangeType(DRIFT, drift[:, None]), estimate.mean[-1] * drift, error * np.abs(drift), now.page)
    return replace(taken, events=(*now.events, Change(begin, end, DRIFT, change.significant(now.names))))


def report(now: Following, block: Block) -> State:
    """Return the parameters after a block, with standard errors and warnings."""
    x, errors = _physical(now), math.sqrt(now.common) * now.estimate.std_error
    along, across = x[3:5], x[-3:-1]
    tilt = math.atan2(across.sum(), along.sum())
    theta, std_error = x[:-4].copy(), errors[:-5]
    theta[3:5] = math.cos(tilt) * along + math.sin(tilt) * across
    dead_zone = float(x[-1]) if x[-1] > 3 * errors[-2] else 0.0
    warnings = (*now.why, *_warnings(now, block, theta, std_error, tilt, dead_zone))
    return State(
        t=(block.begin + block.end) / 2,
        theta=theta,
        std_error=std_error,
        delay=float(x[-4]),
        delay_std_error=float(errors[-5]),
        level=max(now.level, Level.WARN if warnings else Level.OK),
        warnings=warnings,
        unexplained=math.nan if now.moved is None else now.moved.unexplained(x),
        moving=bool(block.rows),
    )


def _physical(now: Following) -> Array:
    """Return the estimate without the rate, or the most likely physical one if it is not physical, shape (D-1,)."""
    x = now.estimate.mean[:-1]
    inside = (x >= now.bounds.lower).all() and (x <= now.bounds.upper).all()
    if inside and not Parameters.from_vector(x[:-4]).unphysical():
        return np.asarray(x)
    weights = now.estimate.information_root(len(x))
    return Quadratic.reduce(weights, weights @ x).minimum(now.bounds)


def _warnings(
    now: Following, block: Block, theta: Array, std_error: Array, tilt: float, dead_zone: float
) -> Iterator[str]:
    if (idle := now.idle(block.end)) > now.settings.idle:
        yield f'nothing has moved for {idle:.0f} s: the parameters are of that time, and their uncertainty grows'
    poor = std_error[:5] > POOR * np.abs(theta[:5])
    if poor.any():
        names = ', '.join(np.array(NAMES[:5])[poor])
        yield f'poorly determined: the standard error of {names} exceeds half the value'
    if abs(tilt) > now.settings.tilt:
        yield (
            f'the base is tilted in the plane of motion by {math.degrees(tilt):.2f} deg, or the zero of the shoulder '
            'is off by that; level the base, or set the zeros again'
        )
    if dead_zone > now.settings.dead_zone * now.effort:
        yield f'the motor has a dead zone of {dead_zone:.3g} N m: every torque is reduced by this amount'
    if now.first_segment.quantized and now.common > 1:
        yield (
            f'the residual is {now.noise.excess:.1f} times the quantization level: the rig has unmodelled effects, '
            'or is sampled too slowly; the errors of the parameters may exceed their intervals'
        )
    if now.waiting:
        yield 'the model does not explain the last motion: a push by hand, a change, or an unmodelled effect'
    if block.saturated:
        yield 'the effort is at its limit; if the command was larger, less torque has acted'
