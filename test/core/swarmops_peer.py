"""SwarmOps, the package from which the paper took settings and form of PSO and DE, as a peer.

It takes exactly these settings: its author's own PSO (random weights once a particle, velocities bounded by the box's
width, positions by the box) and DE/rand/1/bin.
"""

from unittest import mock

import numpy as np
import pytest


def peer(algorithm, function, dimension, parameters, *, evaluations, runs, seed):
    """Return the errors after so many function values, one a run; skip the test where apt alone installed packages."""
    pytest.importorskip('swarmops', reason='swarmops is on PyPI alone')
    with mock.patch.object(np, 'Infinity', np.inf, create=True):  # numpy 2 has dropped the name
        from swarmops import DE, PSO, tools
        from swarmops.Problem import Problem
    bounds = function.bounds(dimension)

    def fitness(x, limit=np.inf):
        return float(function.value(x))

    problem = Problem(function.name, dimension, 0.0, bounds.lower, bounds.upper, func=fitness)
    optimizer = {'DE': DE.DE, 'PSO': PSO.PSO}[algorithm]
    errors = []
    for run in range(runs):
        tools.new_prng(1000 * seed + run)
        errors.append(optimizer(problem=problem, parameters=parameters, max_evaluations=evaluations).best_fitness)
    return np.array(errors)
