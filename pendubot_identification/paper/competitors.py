# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The algorithms in the paper's comparison with MDE (Table 3): DE, HDE and PSO; all runs advance as one array."""

import math
from collections.abc import Callable

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.model.parameters import Bounds
from pendubot_identification.optimizers.mde import MDESettings, generation
from pendubot_identification.optimizers.optimizer import (
    Objective,
    OptimizationResult,
    State,
    best_points,
    columns,
    evaluate,
    random_points,
    run_generations,
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
