# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The settings of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import SIZING, Quadratic, box_factor
from pendubot_identification.criteria.weak import WIDTH, weak_regression
from pendubot_identification.errors import ParameterError, TrajectoryError
from pendubot_identification.model.parameters import MODELS, UNDER_LOAD, Bounds, Parameters, default_bounds
from pendubot_identification.optimizers.mde import MDESettings
from pendubot_identification.optimizers.optimizer import require_runs
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import SMOOTHING
from pendubot_identification.trajectories.trajectory import Trajectory

from .options import CRITERIA, DELAYS, OPTIONS, SPREAD

#: MDE's runs where none are given, as in the paper.
RUNS = 10
#: The paper's MDE, for its criterion and model.
THE_PAPERS = MDESettings(spread=SPREAD)
#: Beyond them the operator is drawn once per vector: per component MDE does not arrive in thousands of generations.
PER_VECTOR = MDESettings(per_component=False, spread=SPREAD)


@dataclass(frozen=True, slots=True)
class Settings:
    """The criteria, the model, the data and the optimiser of an identification.

    The fields are those of :data:`.options.OPTIONS`, which describes each of them; None leaves one open. Some
    differ from a user's options:

    Attributes:
        criteria: option criterion. Of several, the likelihood is published, or else weak.
        delays: option delay, the two ends [s].
        start: the parameters themselves.
        bounds: the search box, of all 14 parameters or the first of them; the others' are then the default ones.
        reading: the conversion of the recordings, from which the options that correct their faults follow.
        applied: those of its options that were inferred from the recordings.
        compensate: whether unmodelled effects that are sure are estimated along.

    Raises:
        ParameterError: a name that is not known, or a number that makes no sense.
    """

    criteria: tuple[str, ...] = ('likelihood',)
    model: str = 'auto'
    optimizer: str = 'auto'
    sliding: float | None = None
    smoothing: float | None = None
    hold: str = 'auto'
    delays: tuple[float, float] = DELAYS
    start: Parameters | None = None
    link_length: float | None = None
    link_mass: float | None = None
    population: int | None = None
    generations: int | None = None
    spread: float | None = None
    per_vector: bool = False
    runs: int | None = None
    seed: int = 1
    bounds: Bounds = field(default_factory=default_bounds)
    reading: Conversion = field(default_factory=Conversion)
    applied: tuple[str, ...] = ()
    compensate: bool = True

    def __post_init__(self) -> None:
        if not self.criteria or len(set(self.criteria)) < len(self.criteria):
            raise ParameterError(f'the criteria are {self.criteria}; one or more of {", ".join(CRITERIA)} are expected')
        named = {'criterion': self.criteria, 'delay': self.delays}
        for option in OPTIONS:
            option.check(named[option.name] if option.name in named else getattr(self, option.name))
        low, high = self.delays
        if low > high:
            raise ParameterError(f'the delay is searched from {low:g} to {high:g} s; the smaller one is expected first')
        given, size = len(self.bounds.lower), MODELS['geared' if self.model == 'auto' else self.model]
        if given < size:
            raise ParameterError(
                f'bounds of {given} parameters were given; {size}, of the model {self.model}, are expected'
            )
        if self.bounds.of(MODELS['viscous']).fixed.all():
            raise ParameterError('all of P1 to b2 are fixed at a value; leave some of them to be estimated')
        # Whatever is asked for, other models are tried on the way.
        object.__setattr__(self, 'bounds', self.bounds.completed())
        for criterion in self.criteria:
            mde, runs = self.search(criterion, self.model)
            require_runs(runs, mde.population, self.seed)

    @classmethod
    def of(
        cls, criterion: tuple[str, ...] = ('likelihood',), delay: tuple[float, float] = DELAYS, **others: Any
    ) -> Settings:
        """Return the settings of options as they are named to a user; what is not given has its default."""
        return cls(criteria=criterion, delays=delay, **others)

    def of_rig(self, motions: Sequence[Trajectory]) -> Settings:
        """Return the settings for recordings: the search box, without friction under load of a joint without a motor.

        Default bounds are but a search box. They grow by powers of ten until the least-squares answer of ``weak``, or
        of ``energy`` where motions are too short for that, lies in the inner half. Bounds that were given stay; one
        that equals the default counts as not given. A constant torque has no delay.
        """
        driven = np.any([motion.tau.any(axis=0) for motion in motions], axis=0)
        absent = [name for name, motor in zip(UNDER_LOAD, driven, strict=True) if not motor]
        bounds = self.bounds.without(absent)
        factor = box_factor(bounds, Quadratic.pool([self._reduced(motion) for motion in motions]))
        varies = any(np.ptp(motion.tau, axis=0).any() for motion in motions)
        delays = self.delays if varies else (self.least_delay, self.least_delay)
        return replace(self, bounds=bounds.scaled(factor), delays=delays)

    def _reduced(self, motion: Trajectory) -> Quadratic:
        """Return the least-squares criterion of a motion by which the search box is sized."""
        smoothing = SMOOTHING if self.smoothing is None else self.smoothing
        try:
            states = Motion.prepare(motion, smoothing)
            made = weak_regression(states, SIZING, self.least_delay, stride=WIDTH / 3, coarse=True)
        except TrajectoryError:
            made = energy_regression(motion, self.sliding, smoothing, SIZING)
        return Quadratic.reduce(made.phi, made.y)

    @property
    def least_delay(self) -> float:
        """The delay nearest to 0 [s] within its bounds."""
        low, high = self.delays
        return min(max(0.0, low), high)

    def box(self, model: str) -> Bounds:
        """Return the bounds of a model's parameters."""
        return self.bounds.of(MODELS[model])

    def search(self, criterion: str, model: str) -> tuple[MDESettings, int]:
        """Return how MDE minimises a criterion of a model, and in how many runs."""
        how, runs = PER_VECTOR, RUNS
        if criterion == 'energy' and model == 'viscous':
            how = THE_PAPERS
        how = replace(
            how,
            population=how.population if self.population is None else self.population,
            generations=how.generations if self.generations is None else self.generations,
            spread=how.spread if self.spread is None else self.spread or None,
            per_component=how.per_component and not self.per_vector,
        )
        return how, runs if self.runs is None else self.runs
