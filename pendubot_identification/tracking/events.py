# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The interface of tracking: its settings, its start, and its reports: states, changes, disturbances, restarts."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ParameterError
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import MODELS, NAMES, Parameters
from pendubot_identification.trajectories.trajectory import Trajectory


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Thresholds of tests and standard deviations of priors and random walks."""

    # Start.
    first: float = 8.0  #: Duration of the motion that determines delay, smoothing and noise [s].
    longest_first: float = 30.0  #: Longest first motion [s]; of a longer one, the newest part is used.
    pause: float = 2.0  #: Time between two attempts to start [s]; each failure doubles it to limit the cost.
    longest_pause: float = 120.0  #: Longest pause [s]; tracking for longer resets the pause.
    carried_over: float = 0.02  #: Relative deviation of P1 to P5 from a file, by another day or criterion.
    friction_carried_over: float = 0.3  #: Relative deviation of friction from a file.
    #: Factor of the mean square residual that rejects a file on a rig with unmodelled effects. Single recordings of two
    #: real rigs give 1.1 to 6.4 with their own parameters, and 26 to 2100 with the parameters of the other rig.
    rejected: float = 15.0

    # Filter. Random walks are relative to each unknown's scale, per root of a second.
    friction_walk: float = 2e-3  #: Friction changes within minutes, as grease warms.
    inertia_walk: float = 5e-6  #: Other unknowns change by steps only; also the deviation of a known unknown.
    rate_walk: float = 1e-2  #: The rate of a gradual change changes within hours.
    noise_memory: int = 400  #: Number of blocks over which the noise is averaged: about three minutes of motion.

    # Tests.
    false_alarm: float = 1e-9  #: Probability of each test under its null hypothesis: one false alarm in 1e5 h.
    window: int = 8  #: Number of blocks in which a change is searched, 3.2 s; half of them for an unnamed change.
    change: float = 4.0  #: Factor of the gate for the likelihood ratio of a step; a drift explains smaller ones.
    explained: float = 3.0  #: Largest mean square of a window after a step: with noise alone it is up to 2.
    lost: int = 20  #: Number of consecutive unexplained blocks after which tracking restarts: 8 s.

    # Report.
    unmodelled: float = 1.5  #: Ratio of RMS residual to quantization level that shows unmodelled effects.
    #: Number of blocks with a common error on such rigs, 8 s, by which variances are multiplied. Recordings of 6 to
    #: 10 s of two real rigs differ by about this factor more than blocks.
    common: int = 20
    heavy_tails: float = 2.0  #: Factor of the gate on such rigs, whose errors are not normal.
    idle: float = 10.0  #: Time without motion above which it is reported [s].
    tilt: float = 5e-3  #: Tilt above which it is reported [rad]: the accuracy of zeros.
    dead_zone: float = 2e-3  #: Dead zone above which it is reported, as a fraction of the RMS effort: its accuracy.


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
    """The estimated parameters at one time."""

    t: float  #: the middle of the newest block [s].
    theta: Array  #: physical parameters, shape (D,).
    std_error: Array  #: of theta, shape (D,).
    delay: float  #: of the effort [s].
    delay_std_error: float  #: of the delay [s].
    level: Level  #: of the parameters; OK or WARN.
    warnings: tuple[str, ...]  #: the reasons of the level.
    unexplained: float  #: RMS residual torque under test functions when the rig last moved [N m].
    moving: bool  #: whether a measurement was used.

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
