# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Likelihoods of simulated rigs, with start and bounds."""

import numpy as np

from pendubot_identification.criteria.likelihood import FilterData, Likelihood, LikelihoodSettings
from pendubot_identification.model.parameters import default_bounds
from pendubot_identification.trajectories.motion import Motion
from test.virtual import C1, CHAOTIC, recording

#: Parameters of a rig with geared motors.
TRUE = C1.vector('geared')


def motions(seeds=(1, 2), samples=1000, smoothing=0.05, **options):
    """Return recordings of the geared rig, by default sampled every 5 ms."""
    options = {'interval': 0.005, **CHAOTIC, **options}
    return [Motion.prepare(recording(samples, seed=seed, **options), smoothing) for seed in seeds]


def likelihood(prepared, theta=TRUE, effects=(), **settings):
    """Return the likelihood of recordings, a start with this theta, and lower and upper bounds."""
    filter_data = FilterData.of(prepared, LikelihoodSettings(**settings))
    torque = np.sqrt(np.mean(np.concatenate([m.recorded.tau for m in prepared]) ** 2, axis=0)).max()
    speed = max(m.states(m.recorded.t)[2:].std() for m in prepared)
    inertia, weight = theta[:2].sum(), theta[3:5].sum()
    own = [inertia] * 3 + [weight] * 2 + [torque / speed] * 2 + [torque] * 2 + [inertia] + [torque] * 2 + [1, 1]
    extra = [
        np.array([getattr(u, n) for e in effects for u in e.unknowns]) for n in ('scale', 'start', 'lower', 'upper')
    ]
    like = Likelihood(filter_data, tuple(effects), np.concatenate([own, [0.01] * 3, extra[0]]))
    quantization, box = np.log(filter_data.quantization) / 2, default_bounds()
    noise = [*(quantization + 0.4), *np.log([0.03 * torque] * 2)] * like.levels
    low, high = [*quantization, -20, -20] * like.levels, [*(quantization + 3), 5, 5] * like.levels
    x = np.concatenate([theta, [0, 0, 0], extra[1], noise])
    return (
        like,
        x,
        *(
            np.concatenate([side, [sign * 0.1] * 3, more, noise])
            for side, sign, more, noise in ((box.lower, -1, extra[2], low), (box.upper, 1, extra[3], high))
        ),
    )
