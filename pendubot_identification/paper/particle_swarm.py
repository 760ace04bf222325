"""Particle swarm optimisation, global best, in the form of SwarmOps, with all independent runs advanced as one array.

    v <- w v + c1 r1 (own best - x) + c2 r2 (swarm's best - x),    x <- x + v

r1 and r2 are drawn once a particle, not once a component. Velocities are bounded by the width of the box, positions by
the box; all particles move, then all are evaluated. Pedersen, Good parameters for particle swarm optimization, HL1001,
2010.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import Bounds
from pendubot_identification.optimizers.optimizer import IndependentRuns, random_points

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PSOSettings:
    """The paper's Table 3: Pedersen's parameters for 20 dimensions and 400 000 function values.

    Attributes:
        particles: s, of one swarm.
        inertia: w.
        personal: c1, towards a particle's own best.
        social: c2, towards the swarm's best.
        evaluations: a run ends with the generation in which it has asked for so many function values.
        target: stop a run at a value not above this.

    Raises:
        ParameterError: a setting that makes no sense.
    """

    particles: int = 149
    inertia: float = -0.3236
    personal: float = -0.1136
    social: float = 3.9789
    evaluations: int = 4000
    target: float | None = None

    def __post_init__(self) -> None:
        if self.particles < 1 or self.evaluations < self.particles:
            raise ParameterError(
                f'{self.particles} particles and {self.evaluations} function values were asked for; at least one '
                'particle, and a value for each, are needed'
            )
        if not np.isfinite([self.inertia, self.personal, self.social]).all():
            raise ParameterError('the weights w, c1 and c2 of the swarm must be finite numbers')


class PSO(IndependentRuns):
    """Ask/tell optimiser (see :class:`.optimizer.Optimizer`) of several independent swarms.

    Args:
        bounds: the search box, of dimension D.
        settings: see :class:`PSOSettings`.
        runs: number of independent runs, each with a random stream of its own.
        seed: same seed, same result.
    """

    def __init__(self, bounds: Bounds, settings: PSOSettings | None = None, *, runs: int = 10, seed: int = 1) -> None:
        self.settings = settings or PSOSettings()
        particles = self.settings.particles
        super().__init__(bounds, runs, seed, particles)
        self._width = bounds.upper - bounds.lower
        self._x = random_points(self._streams, particles, bounds)
        self._v = random_points(self._streams, particles, Bounds(-self._width, self._width, bounds.names))
        self._best, self._values = self._x.copy(), np.full((runs, particles), np.inf)

    def ask(self) -> Array:
        """Return the particles, shape (active runs, s, D)."""
        return self._x

    def tell(self, values: Array) -> None:
        """Take their values, shape (active runs, s): remember the best, stop, and move."""
        better = values < self._values
        np.copyto(self._values, values, where=better)
        np.copyto(self._best, self._x, where=better[..., None])
        lowest = self._values.min(axis=1)
        self._found.record(self._active, self.generation, lowest)
        self._stop_where_due(lowest)
        if not self.done:
            self.generation += 1
            self._move()

    def _leaders(self) -> Array:
        """Return the best point of every active run so far, shape (active runs, D)."""
        return np.asarray(self._best[np.arange(len(self._best)), self._values.argmin(axis=1)])

    def _stop_where_due(self, lowest: Array) -> None:
        settings = self.settings
        reasons = np.full(len(lowest), '', dtype=object)
        if self.generation + 1 >= math.ceil(settings.evaluations / settings.particles):
            reasons[:] = 'evaluations'
        if settings.target is not None:
            reasons[lowest <= settings.target] = 'target'
        self._stop(reasons)

    def _keep(self, going: NDArray[np.bool_]) -> None:
        self._x, self._v = self._x[going], self._v[going]
        self._best, self._values = self._best[going], self._values[going]

    def _move(self) -> None:
        settings = self.settings
        drawn = np.stack([stream.random((2, settings.particles, 1)) for stream in self._streams])
        v = settings.inertia * self._v
        v += settings.personal * drawn[:, 0] * (self._best - self._x)
        v += settings.social * drawn[:, 1] * (self._leaders()[:, None] - self._x)
        self._v = np.clip(v, -self._width, self._width)
        self._x = np.clip(self._x + self._v, self.bounds.lower, self.bounds.upper)
