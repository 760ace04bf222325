# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The settings of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import SIZING, Quadratic, box_factor
from pendubot_identification.criteria.weak import WIDTH, weak_regression
from pendubot_identification.errors import ParameterError, TrajectoryError
from pendubot_identification.model.parameters import MODELS, NAMES, UNDER_LOAD, Bounds, Parameters, default_bounds
from pendubot_identification.optimizers.mde import MDESettings, require_runs
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import SMOOTHING
from pendubot_identification.trajectories.trajectory import Trajectory

from . import CRITERIA, DELAYS, OPTIONS, SPREAD

#: Default number of runs of MDE, as in the paper.
RUNS = 10
#: The fields whose options have another name.
FIELDS = {'criterion': 'criteria', 'delay': 'delays'}


@dataclass(frozen=True, slots=True)
class Settings:
    """The criteria, the model, the data and the optimiser of an identification.

    Fields without a comment are described by the options of their names, :data:`.identification.OPTIONS`. None stands
    for the default.

    Raises:
        ParameterError: a name is unknown, or a number is out of range.
    """

    #: option criterion. Of several, the likelihood is published, or else weak.
    criteria: tuple[str, ...] = ('likelihood',)
    model: str = 'auto'
    optimizer: str = 'auto'
    sliding: float | None = None
    smoothing: float | None = None
    hold: str = 'auto'
    delays: tuple[float, float] = DELAYS  #: option delay, the search interval [s].
    start: Parameters | None = None  #: the initial parameters.
    link_length: float | None = None
    link_mass: float | None = None
    population: int | None = None
    generations: int | None = None
    spread: float | None = None
    per_vector: bool = False
    runs: int | None = None
    seed: int = 1
    #: the search box of all 14 parameters, or of the first ones; others have default bounds.
    bounds: Bounds = field(default_factory=default_bounds)
    #: the conversion of the recordings, from which the options that correct their faults follow.
    reading: Conversion = field(default_factory=Conversion)
    applied: tuple[str, ...] = ()  #: options of ``reading`` that were inferred from the recordings.
    compensate: bool = True  #: whether significant unmodelled effects are estimated together with theta.

    def __post_init__(self) -> None:
        if not self.criteria or len(set(self.criteria)) < len(self.criteria):
            raise ParameterError(f'the criteria are {self.criteria}; one or more of {", ".join(CRITERIA)} are expected')
        for option in OPTIONS:
            option.check(getattr(self, FIELDS.get(option.name, option.name)))
        low, high = self.delays
        if low > high:
            raise ParameterError(f'the delay is searched from {low:g} to {high:g} s; the smaller one is expected first')
        count, size = len(self.bounds.lower), MODELS['geared' if self.model == 'auto' else self.model]
        if count < size:
            raise ParameterError(
                f'bounds of {count} parameters were given; {size}, of the model {self.model}, are expected'
            )
        if self.bounds.of(MODELS['viscous']).fixed.all():
            raise ParameterError('all of P1 to b2 are fixed at a value; leave some of them to be estimated')
        # The estimation also fits other models.
        object.__setattr__(self, 'bounds', self.bounds.completed())
        for k in range(MODELS['viscous'], MODELS['geared'] if self.model == 'auto' else 0):
            if not self.bounds.lower[k] <= 0 <= self.bounds.upper[k]:
                having = next(model for model, size in MODELS.items() if k < size)
                raise ParameterError(
                    f'the bounds of {NAMES[k]} exclude 0, its value in smaller models, which the model auto may '
                    f'choose; choose the model {having} or a larger one'
                )
        mde, runs = self.search('energy', 'viscous')
        require_runs(runs, mde.population, self.seed)

    def of_rig(self, motions: Sequence[Trajectory]) -> Settings:
        """Return the settings for recordings: the search box, without friction under load of a joint without a motor.

        Default bounds are a search box. They grow by powers of ten until the least-squares solution of ``weak``, or of
        ``energy`` for short motions, lies in the inner half. Other bounds stay; a bound that equals its default counts
        as default. A constant torque has no delay.
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
            regression = weak_regression(states, SIZING, self.least_delay, stride=WIDTH / 3, coarse=True)
        except TrajectoryError:
            regression = energy_regression(motion, self.sliding, smoothing, SIZING)
        return Quadratic.reduce(regression.phi, regression.y)

    @property
    def least_delay(self) -> float:
        """The delay nearest to 0 [s] within its bounds."""
        low, high = self.delays
        return min(max(0.0, low), high)

    def box(self, model: str) -> Bounds:
        """Return the bounds of a model's parameters."""
        return self.bounds.of(MODELS[model])

    def search(self, criterion: str, model: str) -> tuple[MDESettings, int]:
        """Return the settings of MDE for a criterion of a model, and the number of runs."""
        default = MDESettings()
        mde_settings = MDESettings(
            population=self.population or default.population,
            generations=self.generations or default.generations,
            # Beyond the paper's criterion and model, an operator per component needs many thousands of generations.
            per_component=(criterion, model) == ('energy', 'viscous') and not self.per_vector,
            spread=SPREAD if self.spread is None else self.spread or None,
        )
        return mde_settings, self.runs or RUNS
