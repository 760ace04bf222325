# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Made-up data for every picture of a report."""

import functools

import numpy as np

from pendubot_identification.report import plots
from pendubot_identification.report.figure_data import Residuals, Simulation
from pendubot_identification.trajectories.trajectory import Trajectory
from test.identified import made


def motion(samples=300, interval=0.01, name='swing', start=0.0):
    t = start + np.arange(samples) * interval
    q = np.column_stack([np.sin(t), np.cos(3 * t)])
    return Trajectory(t, q, np.column_stack([np.sign(np.sin(9 * t)), 0 * t]), name=name)


def simulation(**changes):
    """Three seconds of a motion, and simulations that stand still; of 1 s each, as the page makes them."""
    t = np.arange(601) * 0.005
    values = {'name': 'swing', 't': t, 'measured': np.vstack([np.sin(t), np.cos(3 * t)] * 2), 'scale': np.ones(4)}
    values |= {'tau': np.zeros((2, 600)), 'simulated': np.zeros((201, 4, 3)), 'complete': True}
    return Simulation(**values | changes)


def residuals(samples=300, interval=0.01, channels=3):
    t = np.arange(samples) * interval
    values = np.sin(t[:, None] * np.arange(1, channels + 1))
    parts = (('swing', t, values), ('other', t, values))
    lags, flat = np.arange(100) * interval, np.ones((100, channels))
    return Residuals('weak', 'N m', tuple('abcd'[:channels]), parts, 0.3, lags, flat, 0.1)


def unexplained_torque():
    t = 0.02 * np.arange(200)
    torque = np.column_stack([np.sin(7 * t), np.zeros_like(t)])
    seen = {'its angle [rad]': np.concatenate([torque, torque]), 'its speed [rad/s]': np.zeros((400, 2))}
    return [('a', t, torque), ('b', t, torque)], seen


@functools.cache
def every_picture():
    result = made(optimizer='mde', criteria=('energy',))
    energy = result.criteria['energy']
    timeline = plots.Timeline()
    return [
        *plots.plot_recordings([motion()], [motion(start=3.0)]),
        *plots.plot_simulation(simulation(), timeline, validation=True),
        *plots.draw_residuals(residuals(), timeline),
        *plots.draw_unexplained_torque(*unexplained_torque(), timeline),
        *plots.draw_convergence('energy', energy.J.least_squares, energy.convergence),
        *plots.draw_correlation(result),
        *plots.draw_excitation(list(result.parameters), np.ones((7, 3)), np.ones((7, 3)), np.ones(3)),
    ]
