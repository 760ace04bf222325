# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A rig that is followed: its first motion tells how to listen, every further block what is true now.

A block that is foreseen is learned from. One that is not waits for the next ones: where one step of theta explains
them all, theta changed, and they are learned from after it has been freed to do so; where foreseen ones follow, it was
a burst, such as a hand, and is forgotten; where nothing explains them for long, all begins anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.errors import ParameterError, PendubotError
from pendubot_identification.level import NORMAL_95, POOR, Level
from pendubot_identification.model.parameters import MODELS, NAMES, Bounds, Parameters, default_bounds
from pendubot_identification.trajectories.trajectory import Trajectory

from .balances import BLOCK, STILL
from .blocks import NOT_FINITE, REPEATED, RESTART, Block, Blocks, Taking
from .changes import AGREEING, CHANGED, DELAY, SEVERAL, Jump, Kind, Window, kinds
from .filter import Belief, Noise, left_of

Array = NDArray[np.float64]

#: The first motion [s]: by it delay, smoothing and noise are chosen. At most so much is waited for that tells enough.
FIRST, LONGEST_FIRST = 8.0, 30.0
#: From one attempt to begin to the next [s].
AGAIN = 2.0
#: Samples that are taken at once: little is lost of them where all begins anew; before it begins, so many seconds.
PORTION, FIRST_PORTION = 8192, 0.5
#: Parameters drift as random walks, by so much of their size in a second: friction, and everything else.
FRICTION_WALK, INERTIA_WALK = 2e-3, 5e-6
#: Consecutive blocks over which a change is looked for.
WINDOW = 8
#: A block that leaves so many times more unexplained than usual, in squares, has no vote in what changed; one that
#: leaves as much as the second was moved by something else for certain.
CLEAN, FOREIGN = 8.0, 1000.0
#: Blocks in a row that nothing explains, after which what was believed is given up.
LOST = 20
#: Blocks leave so many times what rounded angles explain where the rig has what the models lack; others leave it once.
LACKING = 1.5
#: By so much more than within a motion parameters then differ from one motion to the next, about: of two real rigs.
DIFFERING = 3.0
#: So much more must then speak of a change: motions of other kinds were found to say up to three times the usual.
MORE = 4.0
#: After so long without motion it is said [s].
IDLE = 10.0
#: Parameters of a file were found by another criterion, or yesterday: so much more of them is taken to be uncertain.
CARRIED_OVER, FRICTION_CARRIED_OVER = 0.02, 0.3
#: The delay's unit [s], the longest one, and what is not known of one that is given.
DELAY_SCALE, LONGEST_DELAY, GIVEN = 0.01, 0.1, 1e-5
#: What a delay does to balances is bent beyond so much more of it [s].
STRAIGHT = 2e-3
#: The ratio with which a first motion denies what was believed beforehand: among normal rows one of 1e8 does by chance.
DENIED = 60.0
#: The kind of a change that was there from the beginning.
NOT_AS_BEFORE = 'not as it was identified before'
#: So much more may it leave unexplained, in squares, where the rig has what the models lack: as much as its recordings
#: do of each other's parameters.
WORSE = 15.0


@dataclass(frozen=True, slots=True)
class Start:
    """What is known beforehand; what is None is found out from the first motion.

    ``judge`` tells how good a first motion is: a level, and why. One of level ERROR is none to begin with.

    Raises:
        ParameterError: a model that is not known, or parameters that no rig has.
    """

    model: str = 'coulomb'
    theta: Array | None = None  #: shape (D,).
    std_error: Array | None = None  #: shape (D,).
    delays: tuple[float, float] = (0.0, 0.05)  #: between which that of the effort is searched [s].
    hold: str = 'zero'  #: see :class:`.blocks.Taking`.
    judge: Callable[[Trajectory], tuple[Level, Sequence[str]]] = lambda motion: (Level.OK, ())

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ParameterError(f'there is no model {self.model!r}; the models are {", ".join(MODELS)}')
        if self.theta is None:
            return
        if problems := Parameters.from_vector(self.theta).unphysical():
            raise ParameterError(f'no rig can be followed from these parameters: {"; ".join(problems)}')


class State(NamedTuple):
    """What is true at a time, as far as it is known.

    Attributes:
        t: the middle of the newest block [s].
        theta: physical parameters, shape (D,).
        std_error: of them, shape (D,); 1.96 of them hold the truth in 95 % of cases.
        delay: of the effort [s], and ``delay_std_error`` [s].
        level: how far to trust them, and ``warnings`` why.
        unexplained: the torque that they leave unexplained, root mean square under bumps, when it last moved [N m].
        moving: whether anything was learned.
    """

    t: float
    theta: Array
    std_error: Array
    delay: float
    delay_std_error: float
    level: Level
    warnings: tuple[str, ...]
    unexplained: float
    moving: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return NAMES[: len(self.theta)]


class Change(NamedTuple):
    """Parameters that jumped between ``begin`` and ``end`` [s]; of each that did, by how much, and its standard error.

    ``begin`` is infinitely early where they are not those of the file that was begun with.
    """

    begin: float
    end: float
    kind: str
    steps: dict[str, tuple[float, float]]

    def __str__(self) -> str:
        steps = ', '.join(
            f'{name} by {step:+.3g} +- {NORMAL_95 * error:.1g}' for name, (step, error) in self.steps.items()
        )
        when = f'at {self.begin:.1f} to {self.end:.1f} s' if math.isfinite(self.begin) else 'from the beginning'
        return f'{self.kind}, {when}' + (f': {steps}' if steps else '')


class Burst(NamedTuple):
    """A torque from nowhere, such as a hand's, from ``begin`` to ``end`` [s]."""

    begin: float
    end: float

    def __str__(self) -> str:
        return f'a torque from nowhere, at {self.begin:.1f} to {self.end:.1f} s: nothing was learned from that motion'


class Lost(NamedTuple):
    """Motion from ``begin`` to ``end`` [s] that nothing explains: all began anew."""

    begin: float
    end: float

    def __str__(self) -> str:
        return f'from {self.begin:.1f} to {self.end:.1f} s nothing explains the motion: it is identified anew'


Event = Change | Burst | Lost


class Tracker:
    """Follows a rig by its samples.

    Attributes:
        state: what is true now; None as long as nothing is known.
        waiting: why nothing is known yet, in a sentence.
    """

    def __init__(self, start: Start | None = None, bounds: Bounds | None = None) -> None:
        self._start = start or Start()
        self._bounds = (bounds or default_bounds()).of(MODELS[self._start.model])
        self._notes: dict[str, int] = {}
        self.state: State | None = None
        self.reset()

    def reset(self) -> None:
        """Forget all but how it began."""
        self._first: list[Array] = []
        self._enough = FIRST
        self._following: _Following | None = None
        self.state, self.waiting = None, f'waiting for {FIRST:g} s of motion'

    @property
    def taking(self) -> Taking | None:
        """How samples are made balances of, once that is known."""
        return None if self._following is None else self._following.taking

    @property
    def notes(self) -> dict[str, int]:
        """What was wrong with samples, and how often."""
        own = {} if self._following is None else self._following.blocks.notes
        return {k: self._notes.get(k, 0) + own.get(k, 0) for k in {**self._notes, **own}}

    def feed(self, samples: Array) -> Iterator[State | Event]:
        """Take samples, rows of t [s], q1, q2 [rad], tau1, tau2 [N m]; return what follows from them, in order.

        Raises:
            PendubotError: ``judge`` of the start does.
        """
        while len(samples):
            count = PORTION
            if self._following is None:
                # Up to a gap, if there is one: it may be enough.
                with np.errstate(invalid='ignore'):
                    later = np.abs(samples[:, 0] - samples[0, 0]) >= FIRST_PORTION
                count = int(np.argmax(later)) if later.any() else PORTION
            yield from self._take(samples[:count])
            samples = samples[count:]

    def _take(self, samples: Array) -> Iterator[State | Event]:
        if self._following is None:
            samples = self._begun(samples)
        following = self._following
        if following is None:
            return
        for block in following.blocks.feed(samples):
            for event in following.take(block):
                yield event
                if isinstance(event, Lost):
                    self._notes = self.notes
                    self.reset()
                    return
            self.state = following.state(block)
            yield self.state

    def _begun(self, samples: Array) -> Array:
        """Begin to follow as soon as the first motion suffices; return it, to be learned from."""
        good = samples[np.isfinite(samples).all(axis=1)]
        self._count(NOT_FINITE, len(samples) - len(good))
        self._first.append(good)
        held: Array = np.concatenate(self._first)
        if len(held) < 2:
            return held
        latest = np.maximum.accumulate(held[:, 0])[:-1]
        late = (held[1:, 0] <= latest) & (held[1:, 0] > latest - RESTART)
        self._count(REPEATED, int(late.sum()))
        held = np.asarray(held[~np.append(False, late)])
        if len(held) < 2:
            return held
        steps = np.diff(held[:, 0])
        # From the last break on.
        usual = float(np.median(np.abs(steps)))
        breaks = np.flatnonzero((steps <= 0) | (steps > max(0.1, 5 * usual)))
        if len(breaks):
            self._count('a gap between samples', len(breaks))
            held = np.asarray(held[breaks[-1] + 1 :])
        self._first = [held]
        span = float(held[-1, 0] - held[0, 0]) if len(held) else 0.0
        self._enough = min(self._enough, max(FIRST, span + AGAIN))
        if span < self._enough:
            return held
        try:
            if (np.ptp(held[:, 1:3], axis=0) < STILL).all():
                raise PendubotError('nothing moves')
            motion = Trajectory(held[:, 0], held[:, 1:3], held[:, 3:5], name='the first motion')
            self._following = _Following.of(motion, self._start, self._bounds)
        except PendubotError as error:
            self.waiting = f'the first {span:.0f} s do not tell enough ({error}); waiting for more motion'
            self._enough = span + AGAIN
            if span > LONGEST_FIRST:
                self._first = [held[held[:, 0] > held[-1, 0] - LONGEST_FIRST / 2]]
                self._enough = LONGEST_FIRST / 2 + AGAIN
            return held
        self._first, self._enough, self.waiting = [], FIRST, ''
        return held

    def _count(self, what: str, times: int) -> None:
        if times:
            self._notes[what] = self._notes.get(what, 0) + times


class _Step(NamedTuple):
    """A block, its rows with noise 1, and what was believed before it.

    ``left`` is how many times more than usual it leaves unexplained, in squares, ``ratio`` that of its own window;
    it was learned from where it was ``foreseen``.
    """

    block: Block
    rows: Array
    before: Belief
    left: float
    ratio: float
    foreseen: bool


class _Following:
    """What is believed of parameters and delay, from the first motion on. In units of a scale they are about 1."""

    def __init__(
        self, taking: Taking, scale: Array, noise: Noise, bounds: Bounds, beyond: float, belief: Belief
    ) -> None:
        self.blocks = Blocks(taking)
        self._scale, self._noise, self._bounds, self._beyond = scale, noise, bounds, beyond
        self._belief = belief
        self._opening: Change | None = None
        friction = np.array([name[0] in 'bFk' for name in bounds.names])
        self._walk = np.where(friction, FRICTION_WALK, INERTIA_WALK)
        self._steps: list[_Step] = []
        self._time, self._moved = math.nan, math.nan
        self._unexplained = math.nan
        self.level: Level = Level.OK
        self.why: Sequence[str] = ()

    @classmethod
    def of(cls, motion: Trajectory, start: Start, bounds: Bounds) -> _Following:
        """Find out from a first motion how to listen.

        Raises:
            PendubotError: it is too short, has gaps, or does not tell the parameters.
        """
        taking = Taking.of(motion, start.model, bounds, start.delays, start.hold)
        found = _moving(motion, taking)
        if len(found) * BLOCK < FIRST / 2:
            raise PendubotError(f'only {len(found) * BLOCK:.1f} s of them move')
        beyond = math.sqrt(np.mean([left_of(block) for block in found]))
        if beyond > LACKING:
            taking = replace(taking, whitened=False)
            found = _moving(motion, taking)
        low, high = start.delays
        unbound = bounds.beside((DELAY,), LONGEST_DELAY)
        bounds = unbound.replaced(DELAY, low, high)
        pooled = Quadratic.pool([Quadratic(block.triangle, block.rows) for block in found])
        theta = pooled.minimum(bounds)
        if problems := Parameters.from_vector(theta[:-1]).unphysical():
            raise PendubotError(f'not physical: {problems[0]}')
        scale = np.append(_scale(theta[:-1], motion), DELAY_SCALE)
        noise = Noise([_scaled(block, scale) for block in found], theta / scale)
        # Of the delay alone something is known beforehand: between what it lies, or what it is until it changes.
        delay, unsure = taking.delay / DELAY_SCALE, max(high - low, GIVEN) / DELAY_SCALE
        row = np.append(np.zeros(len(theta) - 1), [1.0, delay])[None] / unsure
        belief = nothing = Belief.nothing(len(theta)).learned(row)
        for block in found:
            belief = belief.learned(noise.rows(_scaled(block, scale)))
        poor = (np.sqrt(np.diag(belief.covariance)) > POOR)[:5]
        if poor.any():
            raise PendubotError(f'poorly determined: {", ".join(np.array(NAMES[:5])[poor])}')
        made = cls(taking, scale, noise, bounds if low < high else unbound, beyond, nothing)
        if start.theta is not None:
            known, size = np.append(start.theta / scale[:-1], delay), scale[:-1]
            error = np.zeros_like(size) if start.std_error is None else start.std_error / size
            more = np.where([name in NAMES[:5] for name in bounds.names[:-1]], CARRIED_OVER, FRICTION_CARRIED_OVER)
            made.carry_over(Belief.of(known, np.diag(np.append(error**2 + more**2, unsure**2))), found, pooled)
        made.level, made.why = start.judge(motion)
        if made.level is Level.ERROR:
            raise PendubotError('; '.join(made.why))
        return made

    @property
    def taking(self) -> Taking:
        """How samples are made balances of."""
        return self.blocks.taking

    @property
    def _left(self) -> float:
        """How many times what errors of the angles explain is left unexplained, in root mean squares."""
        return self._noise.beyond if self.taking.whitened else self._beyond

    @property
    def _lacking(self) -> bool:
        """Whether the rig has what the models lack."""
        return self._left > LACKING

    def carry_over(self, belief: Belief, found: Sequence[Block], pooled: Quadratic) -> None:
        """Begin with what was believed beforehand, as far as the first blocks, pooled, do not deny it."""
        window = Window.of(belief, [self._noise.rows(_scaled(block, self._scale)) for block in found])
        if self.taking.whitened:
            denied = window.ratio >= DENIED
        else:
            denied = float(pooled(belief.mean * self._scale)) >= WORSE * float(pooled(pooled.minimum(self._bounds)))
        if not denied:
            self._belief = belief
        else:
            jump = window.jump([Kind(NOT_AS_BEFORE, np.eye(len(self._scale)))], belief.mean)
            self._opening = Change(-math.inf, found[0].begin, NOT_AS_BEFORE, {} if jump is None else self._told(jump))

    def take(self, block: Block) -> Iterator[Event]:
        """Learn from a block, or not yet, and return what happened."""
        if self._opening is not None:
            yield self._opening
            self._opening = None
        since = block.begin - self._time
        self._time = block.begin
        # A clock that began anew tells nothing of the time since.
        self._belief = self._belief.drifted(self._walk * math.sqrt(max(since, BLOCK) if since == since else BLOCK))
        if not block.rows:
            return
        self._moved = block.end
        scaled = _scaled(block, self._scale)
        rows = self._noise.rows(scaled)
        known = self._belief.known
        alone = Window.of(self._belief, [rows]) if known else None
        foreseen, ratio = (True, 0.0) if alone is None else (not alone.doubtful, alone.ratio)
        waited = self._waiting()
        step = _Step(block, rows, self._belief, self._noise.left(scaled), ratio, foreseen)
        self._steps = [*self._steps, step][-max(WINDOW, len(waited) + 1) :]
        if change := self._changed():
            yield change
        elif not foreseen:
            if len(waited) + 1 >= LOST:
                yield Lost(waited[0].block.begin, block.end)
        else:
            if any(step.ratio > CHANGED or step.left > FOREIGN for step in waited):
                yield Burst(waited[0].block.begin, waited[-1].block.end)
            if known:
                self._noise.learn(scaled, self._belief)
            self._belief = self._belief.learned(rows)
            self._take_delay()

    def _take_delay(self) -> None:
        """Take the effort with the delay that is believed in where what that does is bent."""
        delay = float(np.clip(self._belief.mean[-1] * DELAY_SCALE, self._bounds.lower[-1], self._bounds.upper[-1]))
        if abs(delay - self.taking.delay) > STRAIGHT:
            self.blocks.taking = replace(self.taking, delay=delay)

    def _waiting(self) -> list[_Step]:
        """Return the last blocks that were not learned from."""
        count = next((k for k, step in enumerate(reversed(self._steps)) if step.foreseen), len(self._steps))
        return self._steps[len(self._steps) - count :]

    def _changed(self) -> Change | None:
        """Look for the window of two blocks or more that speaks most for one step; if so, believe in that."""
        clean = [step for step in self._steps[-WINDOW:] if step.left < CLEAN and step.before.known]
        waiting = sum(step.left < CLEAN for step in self._waiting())
        least, changed = 2 if waiting else WINDOW, MORE * CHANGED if self._lacking else CHANGED
        best = None
        # What is small shows in many blocks only.
        for count in range(least, len(clean) + 1):
            steps = clean[-count:]
            window = Window.of(steps[0].before, [step.rows for step in steps])
            sure = window.ratio > changed * max(1.0, window.left) or (waiting >= WINDOW and window.doubtful)
            if sure and window.explained and (best is None or window.ratio > best[0].ratio):
                best = window, steps
        if best is None:
            return None
        window, steps = best
        before = steps[0].before
        named = kinds(before.mean * self._scale)
        jump = window.jump([Kind(kind.name, kind.directions / self._scale[:, None]) for kind in named], before.mean)
        if jump is None:
            return None
        if jump.kind.name == SEVERAL and len(steps) < AGREEING:
            return None
        self._belief = before.opened(jump.kind.directions / np.abs(jump.kind.directions).max(axis=0))
        for step in steps:
            self._belief = self._belief.learned(step.rows)
        # It may have happened under the blocks before, if they are not foreseen either.
        first = next(k for k, step in enumerate(self._steps) if step is steps[0])
        earlier = first
        while earlier and not self._steps[earlier - 1].foreseen:
            earlier -= 1
        begin = self._steps[earlier].block.begin - (BLOCK if earlier == first else 0.0)
        if earlier and self._steps[earlier - 1].block.begin < begin - BLOCK:
            # Or at any time since the last motion before a rest.
            begin = self._steps[earlier - 1].block.begin
        self._steps = []
        # Under its first block it may have happened until most bumps knew of it.
        return Change(begin, steps[0].block.begin + BLOCK, jump.kind.name, self._told(jump))

    def _told(self, jump: Jump) -> dict[str, tuple[float, float]]:
        """Return the parameters that moved beyond doubt."""
        sure = np.abs(jump.step) > 3 * jump.std_error
        return {
            self._bounds.names[k]: (float(jump.step[k] * self._scale[k]), float(jump.std_error[k] * self._scale[k]))
            for k in np.flatnonzero(sure)
        }

    def state(self, block: Block) -> State:
        """Return what is true after a block."""
        covariance = self._belief.covariance
        errors = np.sqrt(np.diag(covariance)) * self._scale * (DIFFERING if self._lacking else 1.0)
        found = self._physical()
        if block.rows:
            self._unexplained = block.unexplained(found)
        theta, std_error = found[:-1], errors[:-1]
        delay, delay_error = float(found[-1]), float(errors[-1])
        warnings = (*self.why, *self._doubts(block, theta, std_error))
        level = max(self.level, Level.WARN if warnings else Level.OK)
        t = (block.begin + block.end) / 2
        return State(
            t, theta, std_error, delay, delay_error, level, warnings, self._unexplained, moving=bool(block.rows)
        )

    def _doubts(self, block: Block, theta: Array, std_error: Array) -> Iterator[str]:
        idle = block.end - self._moved if self._moved == self._moved else math.inf
        if idle > IDLE:
            yield f'nothing has moved for {idle:.0f} s: the parameters are of then, and ever less sure'
        poor = (std_error[:5] > POOR * np.abs(theta[:5])) | ~np.isfinite(std_error[:5])
        if poor.any():
            names = ', '.join(np.array(NAMES[:5])[poor])
            yield f'poorly determined: the standard error of {names} exceeds half the value'
        if self.taking.rounded and self._lacking:
            yield (
                f'what is left unexplained is {self._left:.1f} times what rounded angles explain: the rig has '
                'what the models lack, or is sampled too slowly; parameters may be farther off than their bands say'
            )
        if self._waiting():
            yield 'the last motion is not explained: a hand, a change, or something that the model lacks'
        if block.saturated:
            yield 'the effort stands at its limit; if more was asked for than the motor gives, less has acted'

    def _physical(self) -> Array:
        """Return the believed parameters, or the likeliest physical ones where these are not."""
        theta = self._belief.mean * self._scale
        inside = (theta >= self._bounds.lower).all() and (theta <= self._bounds.upper).all()
        if inside and not Parameters.from_vector(theta[:-1]).unphysical():
            return np.asarray(theta)
        rows = np.column_stack([self._belief.triangle / self._scale, self._belief.right])
        return Quadratic(np.concatenate([rows, np.zeros((1, rows.shape[1]))]), 1).minimum(self._bounds)


def _moving(motion: Trajectory, taking: Taking) -> list[Block]:
    """Return a first motion's blocks, but those in which nothing moves."""
    samples = np.column_stack([motion.t, motion.q, motion.tau])
    return [block for block in Blocks(taking).feed(samples) if block.rows]


def _scaled(block: Block, scale: Array) -> Block:
    return block._replace(triangle=block.triangle * np.append(scale, 1.0))


def _scale(theta: Array, motion: Trajectory) -> Array:
    """Return the size of each parameter: its own, or for what is nearly nothing what would matter beside the others."""
    speed = float(np.sqrt(np.mean(np.square(np.diff(motion.q, axis=0) / np.diff(motion.t)[:, None])))) + 1e-3
    effort = float(np.sqrt(np.mean(motion.tau**2))) + 1e-9
    least = {'P': theta[:5].max() * 0.1, 'J': theta[1] * 0.1, 'b': 0.02 * effort / speed, 'F': 0.02 * effort, 'k': 0.02}
    return np.maximum(np.abs(theta), [least[name[0]] for name in NAMES[: len(theta)]])
