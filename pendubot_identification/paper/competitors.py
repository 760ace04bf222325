# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's comparison of optimizers: the functions of Table 2, and DE, HDE and PSO of Table 3 beside MDE.

All runs advance as one array.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pendubot_identification.arrays import Array
from pendubot_identification.model.parameters import Bounds
from pendubot_identification.optimizers.mde import (
    MDESettings,
    Objective,
    OptimizationResult,
    State,
    best_points,
    columns,
    evaluate,
    generation,
    random_points,
    run_generations,
)


@dataclass(frozen=True, slots=True)
class BenchmarkFunction:
    """A function of points, shape (..., n) in, (...) out, on [-half_width, half_width]^n, with the minimum 0 at 0."""

    name: str
    half_width: float
    value: Callable[[ArrayLike], Array]

    def gradient(self, x: ArrayLike) -> Array:
        """Return the gradient by central differences: (..., n) in, (..., n) out."""
        x = np.asarray(x, dtype=float)[..., None, :]
        step = 1e-7 * self.half_width
        steps = step * np.eye(x.shape[-1])
        return (self.value(x + steps) - self.value(x - steps)) / (2 * step)

    def bounds(self, dimension: int) -> Bounds:
        """Return the bounds in n dimensions."""
        width = np.full(dimension, self.half_width)
        return Bounds(-width, width, tuple(f'x{k}' for k in range(1, dimension + 1)))


def sphere(x: ArrayLike) -> Array:
    """Return sum x_i^2."""
    return np.asarray((np.asarray(x) ** 2).sum(axis=-1))


def griewank(x: ArrayLike) -> Array:
    """Return 1 + sum x_i^2 / 4000 - prod cos(x_i / sqrt(i)), i from 1."""
    x = np.asarray(x)
    roots = np.sqrt(np.arange(1, x.shape[-1] + 1))
    return np.asarray(1 + (x**2).sum(axis=-1) / 4000 - np.cos(x / roots).prod(axis=-1))


def ackley(x: ArrayLike) -> Array:
    """Return 20 + e - 20 exp(-0.2 sqrt(mean x_i^2)) - exp(mean cos 2 pi x_i)."""
    x = np.asarray(x)
    distance = np.sqrt((x**2).mean(axis=-1))
    return np.asarray(20 + np.e - 20 * np.exp(-0.2 * distance) - np.exp(np.cos(2 * np.pi * x).mean(axis=-1)))


def rastrigin(x: ArrayLike) -> Array:
    """Return sum x_i^2 + 10 - 10 cos 2 pi x_i."""
    x = np.asarray(x)
    return np.asarray((x**2 + 10 - 10 * np.cos(2 * np.pi * x)).sum(axis=-1))


#: The benchmark functions in the order of the paper's tables.
FUNCTIONS = (
    BenchmarkFunction('Sphere', 100.0, sphere),
    BenchmarkFunction('Griewank', 600.0, griewank),
    BenchmarkFunction('Ackley', 30.0, ackley),
    BenchmarkFunction('Rastrigin', 5.12, rastrigin),
)


#: Settings with which MDE equals DE, rand/1/bin (Storn and Price 1997): one F, one CR, partners drawn once per vector.
#: The values of Table 3 are Pedersen's for 10 dimensions and 20 000 function evaluations (Good parameters for
#: differential evolution, HL1002, 2010).
CLASSIC = MDESettings(18, 4000, 0.0, weight=(0.6714,) * 2, crossover=(0.5026,) * 2, per_component=False)
#: Table 3's parameters of PSO, Pedersen's for 20 dimensions and 400 000 function evaluations: particles, w, c1, c2.
PARTICLES, W, C1, C2 = 149, -0.3236, -0.1136, 3.9789


def hde(
    objective: Objective,
    gradient: Callable[[Array], Array],
    bounds: Bounds,
    settings: MDESettings,
    *,
    rate: float = 0.01,
    runs: int = 10,
    seed: int = 1,
) -> OptimizationResult:
    """Minimise by DE with a gradient step of the best vector in every generation (reference 29 of the paper).

    The step is an additional trial: x_best - rate gradient(x_best), clipped to the bounds, replaces the best vector if
    it is at least as good. A generation needs NP + 1 function evaluations and one gradient, (..., D) in, (..., D) out.
    See :func:`.mde.mde` for the other arguments.
    """
    rng, x = random_points(bounds, runs, settings.population, seed)

    def step(x: Array, values: Array) -> State:
        run, best = np.arange(len(values)), values.argmin(axis=1)
        point, value = x[:, run, best], values[run, best]
        trial = np.clip(point.T - rate * gradient(point.T), bounds.lower, bounds.upper)
        trial_value = objective(trial)
        x[:, run, best] = np.where(trial_value <= value, trial.T, point)
        values[run, best] = np.minimum(trial_value, value)
        return generation(rng, objective, bounds, settings, x, values)

    start, each = (x, evaluate(objective, x)), settings.population + 1
    return run_generations(step, start, settings.generations, target=settings.target, per_generation=each)


def pso(
    objective: Objective,
    bounds: Bounds,
    *,
    particles: int = PARTICLES,
    evaluations: int = 4000,
    target: float | None = None,
    runs: int = 10,
    seed: int = 1,
) -> OptimizationResult:
    """Minimise by particle swarm optimisation, global best, in the form of SwarmOps.

        v <- w v + c1 r1 (particle's best - x) + c2 r2 (swarm's best - x),    x <- x + v

    r1 and r2 are drawn once per particle. Velocities are limited to the width of the box, positions to the box. All
    particles move before the evaluation. Pedersen, Good parameters for particle swarm optimization, HL1001, 2010. A run
    stops at a value not above the target, or with the generation in which it reaches the number of function
    evaluations. See :func:`.mde.mde` for the other arguments.
    """
    rng, x = random_points(bounds, runs, particles, seed)
    lower, upper = columns(bounds)
    width = upper - lower

    def step(best: Array, values: Array, x: Array, v: Array) -> State:
        r1, r2 = rng.random((2, *values.shape))
        leader = best_points(best, values)[..., None]
        v = W * v + C1 * r1 * (best - x) + C2 * r2 * (leader - x)
        v = np.clip(v, -width, width)
        x = np.clip(x + v, lower, upper)
        new = evaluate(objective, x)
        better = new < values
        return np.where(better, x, best), np.where(better, new, values), x, v

    start = x, evaluate(objective, x), x, rng.uniform(-width, width, x.shape)
    return run_generations(step, start, math.ceil(evaluations / particles) - 1, target=target)
