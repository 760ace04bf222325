# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How the cost grows with the work: samples, population, runs, dimension as a figure."""

import matplotlib as mpl
import numpy as np

from benchmarks.speed.measure import interleaved, on
from benchmarks.speed.optimisers import energy_criterion, mde
from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import Penalised, Quadratic
from pendubot_identification.model.parameters import Bounds, default_bounds
from pendubot_identification.trajectories.trajectory import Trajectory

GENERATIONS = 400


def samples():
    """Reducing recordings to the paper's criterion: everything that depends on how long they are."""
    for count in (1_000, 10_000, 100_000, 1_000_000, 3_600_000):
        t = np.arange(count) / 1000
        q = np.column_stack([np.sin(3 * t) - 1.5, np.cos(5 * t)])
        motion = Trajectory(t, q, np.column_stack([np.sin(7 * t), 0 * t]))

        def reduce(motion=motion):
            regression = energy_regression(motion)
            Quadratic.reduce(regression.phi, regression.y)

        yield count, interleaved({'': reduce}, 5 if count < 10**6 else 1)['']


def searches(kind):
    criterion = Penalised.of(energy_criterion())
    bounds = default_bounds().of(7)
    if kind == 'population':
        for count in (30, 60, 100, 200, 300):
            yield count, mde(criterion, bounds, count, generations=GENERATIONS)
    elif kind == 'runs':
        for count in (1, 3, 10, 30, 100):
            yield count, mde(criterion, bounds, runs=count, generations=GENERATIONS)
    else:
        rng = np.random.default_rng(1)
        for count in (7, 10, 14, 20, 30):
            phi = rng.normal(size=(4 * count, count))
            objective = Quadratic.reduce(phi, phi @ rng.random(count))
            box = Bounds(np.zeros(count), np.ones(count), tuple(map(str, range(count))))
            yield count, mde(objective, box, generations=GENERATIONS)


def figure(path):
    mpl.use('Agg')
    from matplotlib import pyplot

    drawing, axes = pyplot.subplots(1, 4, figsize=(13, 3.2), layout='constrained')
    at, spent = zip(*samples(), strict=True)
    axes[0].loglog(at, spent, 'o-', label='to a triangle')
    axes[0].set_xlabel('samples')
    axes[0].set_ylabel('s')
    rows = [('samples', at, spent)]
    for axis, kind in zip(axes[1:], ('population', 'runs', 'dimension'), strict=True):
        for name, compiled in (('kernel', True), ('numpy', False)):
            at, spent = zip(
                *((n, interleaved({'': on(compiled, work)})['']) for n, work in searches(kind)), strict=True
            )
            axis.loglog(at, spent, 'o-', label=name)
            rows.append((f'{kind}, {name}', at, spent))
        axis.set_xlabel(f'{kind}, {GENERATIONS} generations')
        axis.legend()
    for axis in axes:
        axis.grid(alpha=0.3, which='both')
    drawing.savefig(path, metadata={'Date': None})
    return '\n'.join(
        ['| | work: s |', '|---|---|']
        + [f'| {name} | {", ".join(f"{n}: {s:.3g}" for n, s in zip(a, b, strict=True))} |' for name, a, b in rows]
    )
