# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What a tracker begins with, and what it tells: states, changes, and motion that it does not learn from."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import ParameterError
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import MODELS, NAMES, Parameters
from pendubot_identification.trajectories.trajectory import Trajectory

Array = NDArray[np.float64]

#: The kind of a change that was there from the beginning.
NOT_AS_BEFORE = 'not as it was identified before'


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
    validate: Callable[[Trajectory], tuple[Level, Sequence[str]]] = lambda motion: (Level.OK, ())

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
        unexplained: the torque that they leave unexplained, root mean square under test functions, when it last moved
            [N m].
        moving: whether a measurement was used.
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


class Disturbance(NamedTuple):
    """A disturbance, such as a push by hand, from ``begin`` to ``end`` [s]."""

    begin: float
    end: float

    def __str__(self) -> str:
        return f'a disturbance at {self.begin:.1f} to {self.end:.1f} s: that motion was not used'


class Lost(NamedTuple):
    """Motion from ``begin`` to ``end`` [s] that nothing explains: all began anew."""

    begin: float
    end: float

    def __str__(self) -> str:
        return f'from {self.begin:.1f} to {self.end:.1f} s nothing explains the motion: it is identified anew'


Event = Change | Disturbance | Lost
