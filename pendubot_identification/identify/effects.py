# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What rigs have and the models lack: torques that act beside the model's, and angles that are read otherwise."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.model.dynamics import SIGN_WIDTH

Array = NDArray[np.float64]

#: Where saturation may begin, as a part of the greatest torque; over how many rad/s friction may change its sign.
LIMITS, SIGN_WIDTHS = np.arange(0.3, 0.96, 0.05), (0.01, 0.2, 0.5, 1.5)
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
        "a shaft or belt gives way between the shoulder's encoder and link 1, or the torque acts later when it changes",
        "put the encoder on the link's side, or excite with slower torques",
    ),
    'eccentric': ("an encoder's error repeats once a turn", 'centre the encoder on its axis'),
    'zero': ('a zero is off by a little', 'let the links swing out before the zeros are set'),
}


class Seen(NamedTuple):
    """A motion at some times: angles [rad] and speeds [rad/s] of both joints, the shoulder's torque [N m] in time, and
    how much of all data has passed, from -0.5 to 0.5; arrays of one shape.
    """

    q: tuple[Array, Array]
    v: tuple[Array, Array]
    tau: Array
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
    yield Effect('shaft', 'shoulder', read=((lambda s: (s.tau, 0 * s.tau)),))
    for j, joint in enumerate(('shoulder', 'elbow')):
        yield Effect('offset', joint, ((j, _steady),))
        yield Effect('drag', joint, ((j, _drag(j)),))
        yield Effect('spring', joint, ((j, _angle(j)), (j, _steady)))
        yield Effect('eccentric', joint, read=(_wave(j, np.sin), _wave(j, np.cos)))
        for width in SIGN_WIDTHS:
            yield Effect('friction', f'{joint}, its sign changes over {width:g} rad/s', ((j, _sign(j, width)),))
        for number in range(2, MOST_A_TURN + 1) if spans[j] > LEAST_TURN else ():
            yield Effect(
                'cogging', f'{joint}, {number} a turn', ((j, _turn(j, number, np.sin)), (j, _turn(j, number, np.cos)))
            )


def _steady(s: Seen) -> Array:
    return np.ones_like(s.tau)


def _angle(j: int) -> Callable[[Seen], Array]:
    return lambda s: s.q[j]


def _speed(j: int) -> Callable[[Seen], Array]:
    return lambda s: s.v[j]


def _sign(j: int, width: float = SIGN_WIDTH) -> Callable[[Seen], Array]:
    return lambda s: np.tanh(s.v[j] / width)


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
