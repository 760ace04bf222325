# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What rigs have and the models lack: torques that act beside the model's, and angles that are read otherwise."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.model.dynamics import SIGN_WIDTH
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.piecewise import Piecewise

Array = NDArray[np.float64]

#: Where saturation may begin, as a part of the greatest torque; over how many rad/s friction may change its sign.
LIMITS, SIGN_WIDTHS = np.arange(0.3, 0.99, 0.02), (0.01, 0.2, 0.5, 1.5)
#: Below which speed [rad/s] there may be more dry friction; time constants [s] with which a torque may follow what is
#: recorded; half the time [s] over which one twists a shaft.
CREEPING, LAGS, TWIST = (0.1, 0.3), (0.002, 0.003, 0.005, 0.007, 0.01, 0.015, 0.02, 0.03, 0.05), 0.02
#: Between two times [s] an effect's torque is constant; a lag's is evaluated at times that are so far apart.
FINE, FINEST = 0.0025, 0.0005
#: Cogging repeats at most so often a turn, and is looked for where a joint moves by more than this [rad].
MOST_A_TURN, LEAST_TURN = 24, 1.0

#: What each effect is, and what to do.
MEANINGS = {
    'saturation': (
        'the torque that acts falls short of the recorded one where that is large',
        'record the torque that the motor gives (its current), or excite with less',
    ),
    'drag': ('a joint brakes with the square of its speed', 'move more slowly, or take b for these speeds alone'),
    'friction': ('dry friction changes with speed otherwise than in the model', 'take Fc and b as they are: rough'),
    'asymmetry': ('friction differs between the two directions', 'take Fc as the mean of both directions'),
    'offset': (
        'a steady torque acts that is not recorded',
        "look at the zero of the torque's sensor or of the motor's current, and at cables",
    ),
    'spring': ('a torque grows with a joint angle: a cable or a spring', 'free the cable, or lead it along the axis'),
    'cogging': ('a torque repeats several times a turn: a motor that cogs, or a gear', 'take friction as rough'),
    'drift': ('friction changes with time', 'let the rig warm up, and record again'),
    'shaft': (
        "a shaft or belt gives way between the shoulder's encoder and link 1",
        "put the encoder on the link's side, or excite with slower torques",
    ),
    'lag': (
        'the torque that acts follows the recorded one with a lag, or is missing for a moment when it turns round: a '
        'slow controller of the current, or play in a gear',
        "record the motor's current, take the play out, or excite with slower torques",
    ),
    'eccentric': ("an encoder's error repeats once a turn", 'centre the encoder on its axis'),
    'zero': ('a zero is off by a little', 'let the links swing out before the zeros are set'),
}


class Seen(NamedTuple):
    """What is seen of a motion at some times; arrays of one shape.

    Attributes:
        q: angles of both joints [rad].
        v: speeds [rad/s].
        tau: the shoulder's torque in time [N m].
        mean: the same averaged over so much time [s] before and after.
        lagged: the same behind a lag with such a time constant [s], but for its delay by as much.
        passed: how much of all data has passed, from -0.5 to 0.5.
    """

    q: tuple[Array, Array]
    v: tuple[Array, Array]
    tau: Array
    mean: Callable[[float], Array]
    lagged: Callable[[float], Array]
    passed: Array


#: A torque at a joint (0 or 1), but for its size, as a function of what is seen.
Acting = tuple[int, Callable[[Seen], Array]]
#: What is added to both joints' angles, but for its size.
Read = Callable[[Seen], tuple[Array, Array]]


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect of unknown size: a number for each of its torques or changes of the angles.

    Attributes:
        name: one of :data:`MEANINGS`.
        where: the joint, and what tells it from its kin, in words.
        acting: the torques that brake; they can be allowed for.
        read: the changes of what is read.
    """

    name: str
    where: str
    acting: tuple[Acting, ...] = ()
    read: tuple[Read, ...] = ()


@dataclass(frozen=True, slots=True)
class Found:
    """An effect that explains some of the unexplained torque.

    Attributes:
        effect: which.
        sizes: of its torques or changes, in the catalogue's order [N m, rad and their quotients], shape (C,).
        share: of the square of what was unexplained, what it explains of data that did not fit it.
        moved: by how much each of P1 to P5 changes beside it, as a fraction, shape (5,).
    """

    effect: Effect
    sizes: Array
    share: float
    moved: Array
    of: str = 'unexplained torque'  #: what was unexplained.
    most: bool = True  #: whether it explains most of that, so that it can be relied on in other motions.

    @property
    def allowed(self) -> bool:
        """Whether it is allowed for: a torque that explains most."""
        return bool(self.effect.acting) and self.most

    @property
    def sentence(self) -> str:
        """What was found, how sure that is, and what to do."""
        found, remedy = MEANINGS[self.effect.name]
        moved = f'{100 * np.abs(self.moved).max():.2g} %'
        done = f', and may change P1 to P5 by {moved}'
        if self.allowed:
            done = f'; P1 to P5, which change by up to {moved}, allow for it'
        return f'{found} ({self.effect.where}): {100 * self.share:.2g} % of the {self.of}{done}; {remedy}'


def catalogue(greatest: float, spans: tuple[float, float]) -> Iterator[Effect]:
    """Return every effect that is looked for.

    Args:
        greatest: torque of the recordings [N m].
        spans: over which both joints moved [rad].
    """

    def beyond(limit: float) -> Callable[[Seen], Array]:
        return lambda s: np.sign(s.tau) * np.maximum(np.abs(s.tau) - limit, 0)

    for limit in LIMITS * greatest:
        yield Effect('saturation', f'from about {limit:.2g} N m on', ((0, beyond(limit)),))
    yield Effect('saturation', 'the more, the larger it is', ((0, lambda s: s.tau**3),))
    both = 'shoulder and elbow'
    yield Effect('asymmetry', both, (*((j, _steady) for j in (0, 1)), *((j, _sense(j)) for j in (0, 1))))
    yield Effect('drift', both, tuple((j, _drifting(j, kind)) for j in (0, 1) for kind in (_speed, _sign)))
    yield Effect('zero', both, read=tuple(_wave(j, np.ones_like) for j in (0, 1)))
    yield Effect('shaft', 'shoulder', read=((lambda s: (s.mean(TWIST), 0 * s.tau)),))
    for time in LAGS:
        yield Effect('lag', f'by about {1000 * time:g} ms', ((0, _lagging(time)),))
    for j, joint in enumerate(('shoulder', 'elbow')):
        yield Effect('offset', joint, ((j, _steady),))
        yield Effect('drag', joint, ((j, _drag(j)),))
        yield Effect('spring', joint, ((j, _angle(j)), (j, _steady)))
        yield Effect('eccentric', joint, read=(_wave(j, np.sin), _wave(j, np.cos)))
        for width in SIGN_WIDTHS:
            yield Effect('friction', f'{joint}, its sign changes over {width:g} rad/s', ((j, _sign(j, width)),))
        for speed in CREEPING:
            yield Effect('friction', f'{joint}, more of it below {speed:g} rad/s', ((j, _creeping(j, speed)),))
        for number in range(2, MOST_A_TURN + 1) if spans[j] > LEAST_TURN else ():
            yield Effect(
                'cogging', f'{joint}, {number} a turn', ((j, _turn(j, number, np.sin)), (j, _turn(j, number, np.cos)))
            )


def catalogue_of(motions: Sequence[Motion]) -> list[Effect]:
    """Return every effect that is looked for in some motions."""
    positions = np.concatenate([m.smoothed(m.smoothed.x)[:, :2] for m in motions])
    greatest = max(float(np.abs(m.recorded.tau[:, 0]).max()) for m in motions)
    return list(catalogue(greatest, tuple(np.ptp(positions, axis=0))))


def _steady(s: Seen) -> Array:
    return np.ones_like(s.tau)


def _angle(j: int) -> Callable[[Seen], Array]:
    return lambda s: s.q[j]


def _speed(j: int) -> Callable[[Seen], Array]:
    return lambda s: s.v[j]


def _sign(j: int, width: float = SIGN_WIDTH) -> Callable[[Seen], Array]:
    return lambda s: np.tanh(s.v[j] / width)


def _creeping(j: int, speed: float) -> Callable[[Seen], Array]:
    return lambda s: np.tanh(s.v[j] / SIGN_WIDTH) * np.exp(-((s.v[j] / speed) ** 2))


def _lagging(time: float) -> Callable[[Seen], Array]:
    return lambda s: s.tau - s.lagged(time)


def _sense(j: int) -> Callable[[Seen], Array]:
    return lambda s: np.abs(np.tanh(s.v[j] / SIGN_WIDTH))


def _drag(j: int) -> Callable[[Seen], Array]:
    return lambda s: s.v[j] * np.abs(s.v[j])


def _turn(j: int, number: int, wave: Callable[[Array], Array]) -> Callable[[Seen], Array]:
    return lambda s: wave(number * s.q[j])


def _drifting(j: int, kind: Callable[[int], Callable[[Seen], Array]]) -> Callable[[Seen], Array]:
    return lambda s: s.passed * kind(j)(s)


def _wave(j: int, wave: Callable[[Array], Array]) -> Read:
    return lambda s: (wave(s.q[0]), 0 * s.q[0]) if j == 0 else (0 * s.q[1], wave(s.q[1]))


def together(found: Sequence[Found], more: Sequence[Found]) -> tuple[Found, ...]:
    """Return all of them; what was allowed for and found again has both sizes."""
    known = {(f.effect.name, f.effect.where): f for f in found}
    for m in more:
        key = m.effect.name, m.effect.where
        before = known.get(key)
        known[key] = replace(before, sizes=before.sizes + m.sizes) if before is not None and before.allowed else m
    return tuple(known.values())


def passed_by(motions: Sequence[Motion]) -> list[tuple[float, float]]:
    """Return how much of all data has passed at the start and at the end of each motion, from -0.5 to 0.5."""
    ends = np.cumsum([0.0, *(motion.end - motion.start for motion in motions)])
    return list(pairwise((ends / ends[-1] - 0.5).tolist()))


def seen_of(motion: Motion, at: Array, delay: float, passed: tuple[float, float] = (0.5, 0.5)) -> Seen:
    """Return what is seen of a motion at some times [s] with a delay of the effort [s]."""
    q1, q2, v1, v2 = motion.states(at)
    first, last = motion.impulse.x[[0, -1]]

    def mean(around: float) -> Array:
        low, high = (np.clip(at - delay + side, first, last) for side in (-around, around))
        return np.asarray((motion.impulse(high) - motion.impulse(low))[..., 0] / (2 * around))

    def lagged(time: float) -> Array:
        grid = np.arange(first, last, FINEST)
        decay = np.exp(-FINEST / time)
        mean = (1 - decay) * np.diff(motion.impulse(grid)[:, 0]) / FINEST
        # Of twice as many past steps each time, until the next are forgotten.
        past = 1
        while past < len(mean) and decay**past > 1e-16:
            mean[past:] = mean[past:] + decay**past * mean[:-past]
            past *= 2
        return np.asarray(np.interp(at - delay + time, grid[1:], mean))

    torque = motion.impulse(at - delay, 1)[..., 0]
    return Seen((q1, q2), (v1, v2), torque, mean, lagged, np.interp(at, (motion.start, motion.end), passed))


def allowing_for(
    motion: Motion, found: Sequence[Found], delay: float, passed: tuple[float, float] = (0.5, 0.5)
) -> Motion:
    """Return the motion with what is left for the model of its torques: without those of the effects."""
    found = [each for each in found if each.allowed]
    units = [torque for each in found for torque in each.effect.acting]
    if not units:
        return motion
    sizes = np.concatenate([each.sizes for each in found])
    breaks, made = _unit_torques(motion, units, delay, passed)
    # The same integral in finer pieces, less that of the effects.
    whole = np.array([motion.impulse(breaks[:-1], 2) / 2, motion.impulse(breaks[:-1], 1), motion.impulse(breaks[:-1])])
    taken = Piecewise(np.tensordot(made, sizes, (1, 0))[None], breaks).antiderivative()
    whole[1:] -= taken.c
    return replace(motion, impulse=Piecewise(whole, breaks))


def with_unit_torques(
    motion: Motion, effects: Sequence[Effect], delay: float, passed: tuple[float, float] = (0.5, 0.5)
) -> Motion:
    """Return the motion with the torques of effects of unit size beside its own; they brake."""
    units = [torque for effect in effects for torque in effect.acting]
    if not units:
        return motion
    breaks, made = _unit_torques(motion, units, delay, passed)
    # What Piecewise.antiderivative would do of this, in a third of the time.
    pieces = np.empty((2, *made.shape))
    np.negative(made, out=pieces[0])
    pieces[1, 0] = 0.0
    np.cumsum(pieces[0, :-1] * np.diff(breaks)[:-1, None, None], axis=0, out=pieces[1, 1:])
    return replace(motion, unit_impulse=Piecewise(pieces.reshape(2, len(made), -1), breaks))


def _unit_torques(
    motion: Motion, units: Sequence[Acting], delay: float, passed: tuple[float, float]
) -> tuple[Array, Array]:
    """Return breaks [s], shape (B + 1,), and the torques between them on both joints, shape (B, E, 2)."""
    own = motion.impulse.x
    count = np.maximum(np.rint(np.diff(own) / FINE).astype(np.intp), 1)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    breaks = np.append(np.repeat(own[:-1], count) + place * np.repeat(np.diff(own) / count, count), own[-1])
    seen = seen_of(motion, np.clip((breaks[1:] + breaks[:-1]) / 2 + delay, motion.start, motion.end), delay, passed)
    made = np.zeros((len(breaks) - 1, len(units), 2))
    for k, (joint, torque) in enumerate(units):
        made[:, k, joint] = torque(seen)
    return breaks, made
