# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The start of tracking and its reports: states, changes, disturbances, restarts."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ParameterError
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import MODELS, NAMES, Parameters
from pendubot_identification.trajectories.trajectory import Trajectory

#: The kind of a change since the parameters of the start were identified.
NOT_AS_BEFORE = 'not as it was identified before'


@dataclass(frozen=True, slots=True)
class Start:
    """The prior knowledge and the options of tracking.

    Raises:
        ParameterError: an unknown model, or parameters that are not physical.
    """

    model: str = 'coulomb'
    theta: Array | None = None  #: shape (D,); None: the first motion determines it.
    std_error: Array | None = None  #: shape (D,).
    delays: tuple[float, float] = (0.0, 0.05)  #: search interval of the delay of the effort [s].
    hold: str = 'zero'  #: see :meth:`.Motion.prepare`.
    #: Returns level and warnings of a first motion; tracking does not start at level ERROR.
    validate: Callable[[Trajectory], tuple[Level, Sequence[str]]] = lambda motion: (Level.OK, ())

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ParameterError(f'there is no model {self.model!r}; the models are {", ".join(MODELS)}')
        if self.theta is not None and (problems := Parameters.from_vector(self.theta).unphysical()):
            raise ParameterError(f'tracking cannot start from unphysical parameters: {"; ".join(problems)}')


class State(NamedTuple):
    """The estimated parameters at one time.

    Attributes:
        t: the middle of the newest block [s].
        theta, std_error: physical parameters and their standard errors, shape (D,).
        delay, delay_std_error: of the effort [s].
        level, warnings: of the parameters.
        unexplained: RMS residual torque under test functions when the rig last moved [N m].
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
        """The names of the parameters."""
        return NAMES[: len(self.theta)]


class Change(NamedTuple):
    """A change of parameters between ``begin`` and ``end`` [s]: its kind, and step and standard error by name.

    ``begin`` is -inf for a change since the parameters of the start were identified.
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
    """A torque that the model does not predict, such as a push by hand, from ``begin`` to ``end`` [s]."""

    begin: float
    end: float

    def __str__(self) -> str:
        return f'a disturbance at {self.begin:.1f} to {self.end:.1f} s: that motion was not used'


class Lost(NamedTuple):
    """Motion from ``begin`` to ``end`` [s] that no change and no disturbance explains: tracking restarts."""

    begin: float
    end: float

    def __str__(self) -> str:
        return f'from {self.begin:.1f} to {self.end:.1f} s no change explains the motion: tracking restarts'


Event = Change | Disturbance | Lost
