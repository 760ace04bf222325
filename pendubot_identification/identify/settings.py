# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What an identification is asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import MODELS, UNDER_LOAD, Bounds, Parameters, default_bounds
from pendubot_identification.optimizers.mde import MDESettings
from pendubot_identification.optimizers.optimizer import require_runs
from pendubot_identification.trajectories.trajectory import Trajectory

CRITERIA = ('energy', 'weak', 'trajectory')
OPTIMIZERS = ('auto', 'mde', 'lsq')
HOLDS = ('auto', 'zero', 'linear')
#: The effort's delay is searched within these [s].
DELAYS = (-0.1, 0.1)
#: MDE's runs where none are given, as in the paper.
RUNS = 10
#: A run of MDE stops when its population has come together this closely: then its best J has long been the minimum's
#: to a relative 1e-6, and what is left of 4000 generations changes nothing that can be seen.
SPREAD = 1e-9
#: The paper's MDE, for its criterion and model.
THE_PAPERS = MDESettings(spread=SPREAD)
#: Beyond them the operator is drawn once per vector: per component MDE does not arrive in thousands of generations.
PER_VECTOR = MDESettings(per_component=False, spread=SPREAD)
#: On ``trajectory`` MDE looks for a basin, and Levenberg-Marquardt goes to its bottom: so much is enough. (Per
#: component, the valley in which all parameters grow together is too narrow.)
SEARCH, SEARCH_RUNS = MDESettings(population=40, generations=120, per_component=False, spread=1e-6), 1


@dataclass(frozen=True, slots=True)
class Settings:
    """What is minimised, and how.

    Attributes:
        criteria: some of ``energy`` (the paper's), ``weak`` and ``trajectory``. Of several, the one that predicts the
            validation data best is published.
        model: one of :data:`.parameters.MODELS`, or ``auto``: the smallest that predicts as well as any.
        optimizer: ``mde``, or ``lsq``: for the quadratic criteria their exact bounded least-squares answer, for
            ``trajectory`` Levenberg-Marquardt from the answer of ``weak``. ``auto`` takes MDE for the quadratic
            criteria, where it costs a second and is held against the exact answer, and ``lsq`` for ``trajectory``.
        sliding: length [s] of the energy balance's sliding window; None: cumulative.
        smoothing: the differentiator's window [s]; None: 0.02 s for ``energy``, chosen from the data for the others.
        hold: how the torque behaves between its samples: ``zero`` (held, as the bridge records it), ``linear``
            (measured), or ``auto``: what explains the motion better. ``energy`` always takes it as held.
        delays: within which the effort's delay is searched [s]; equal ones fix it. ``energy`` has none.
        start: where ``lsq`` starts on ``trajectory``, instead of the answer of ``weak``.
        link_length: l1 [m], to be held against P3 / P5.
        mde: those fields of :class:`.mde.MDESettings` that are chosen, by name; the others are what suits each
            criterion, see :meth:`search`.
        runs: independent runs of MDE; None likewise.
        seed: of its random numbers.
        bounds: the search box, of all 14 parameters or the first of them; the others' are then the default ones.

    Raises:
        ParameterError: a name that is not known, or a number that makes no sense.
    """

    criteria: tuple[str, ...] = CRITERIA
    model: str = 'auto'
    optimizer: str = 'auto'
    sliding: float | None = None
    smoothing: float | None = None
    hold: str = 'auto'
    delays: tuple[float, float] = DELAYS
    start: Parameters | None = None
    link_length: float | None = None
    mde: Mapping[str, Any] = field(default_factory=dict)
    runs: int | None = None
    seed: int = 1
    bounds: Bounds = field(default_factory=default_bounds)

    def __post_init__(self) -> None:
        if not self.criteria or len(set(self.criteria)) < len(self.criteria):
            raise ParameterError(f'the criteria are {self.criteria}; one or more of {", ".join(CRITERIA)} are expected')
        chosen: list[tuple[str, str, tuple[str, ...]]] = [('criterion', name, CRITERIA) for name in self.criteria]
        chosen += [('model', self.model, ('auto', *MODELS)), ('optimizer', self.optimizer, OPTIMIZERS)]
        chosen += [('hold', self.hold, HOLDS)]
        for kind, name, known in chosen:
            if name not in known:
                raise ParameterError(f'there is no {kind} {name!r}; choose one of {", ".join(known)}')
        if self.sliding is not None and not (np.isfinite(self.sliding) and self.sliding > 0):
            raise ParameterError(f'the sliding window is {self.sliding:g} s; a time above 0 is expected')
        if self.smoothing is not None and not (np.isfinite(self.smoothing) and self.smoothing >= 0):
            raise ParameterError(f'the smoothing window is {self.smoothing:g} s; 0 or a time above 0 is expected')
        low, high = self.delays
        if not (np.isfinite([low, high]).all() and -0.5 <= low <= high <= 0.5):
            raise ParameterError(
                f'the delay is searched from {low:g} to {high:g} s; two times within half a second are expected, the '
                'smaller one first'
            )
        if self.link_length is not None and not (np.isfinite(self.link_length) and self.link_length > 0):
            raise ParameterError(f'the length of link 1 is {self.link_length:g} m; a length above 0 is expected')
        given, size = len(self.bounds.lower), MODELS['geared' if self.model == 'auto' else self.model]
        if given < size:
            raise ParameterError(f'bounds of {given} parameters were given; the model {self.model} has up to {size}')
        # Whatever is asked for, other models are tried on the way.
        object.__setattr__(self, 'bounds', self.bounds.completed())
        for criterion in self.criteria:
            mde, runs = self.search(criterion, self.model)
            require_runs(runs, mde.population, self.seed)

    def of_rig(self, motions: Sequence[Trajectory]) -> Settings:
        """Return the settings for the rig that moved so: a joint without any effort has no friction under load."""
        driven = np.any([motion.tau.any(axis=0) for motion in motions], axis=0)
        absent = [name for name, motor in zip(UNDER_LOAD, driven, strict=True) if not motor]
        return replace(self, bounds=self.bounds.without(absent))

    def search(self, criterion: str, model: str) -> tuple[MDESettings, int]:
        """Return how MDE minimises a criterion of a model, and in how many runs."""
        usual, runs = PER_VECTOR, RUNS
        if criterion == 'trajectory':
            usual, runs = SEARCH, SEARCH_RUNS
        elif criterion == 'energy' and model == 'viscous':
            usual = THE_PAPERS
        chosen = replace(usual, **self.mde)
        # That the operator is drawn per component can be chosen away, not to.
        chosen = replace(chosen, per_component=usual.per_component and chosen.per_component)
        return chosen, runs if self.runs is None else self.runs
