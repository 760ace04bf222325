# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Simulated recordings of known rigs."""

from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.model.dynamics import forward_dynamics
from pendubot_identification.model.parameters import MODELS, PAPER, Parameters
from pendubot_identification.model.rollout import roll
from pendubot_identification.model.simulation import quantised, simulate
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory
from test.changing_rig import truth
from test.simulated_rig import STRENGTH, pulses

#: A bench-top rig with geared motors; each model takes its leading parameters.
GEARED = np.array([0.06, 0.05, 0.032, 0.23, 0.16, 0.01, 0.005, 0.25, 0.19, 0.0026, 0.1, 0.05, 0.15, 0.2])

#: The published parameters of a real rig with geared motors, and pulses that keep its motion chaotic.
C1 = Parameters(0.0596, 0.0505, 0.0320, 0.2298, 0.1600, 0.001, 0.001, 0.251, 0.188, 0.0026)
CHAOTIC = {'rig': C1, 'strength': 3.0, 'width': 0.5, 'hold': 0.2}

#: A small rig with geared motors: dry friction stops its elbow within 0.6 ms.
STIFF = Parameters(0.015, 0.0069, 0.0079, 0.124, 0.063, 0.017, 0.0058, 0.083, 0.088, 5e-4, 0.04, 0.0085, 0.02, 0.118)


def recording(
    samples=900, interval=0.01, *, seed=1, counts=4000, rig=PAPER, delay=0.0, strength=1.0, name=None, **pulses
):
    """Return a recording of a rig under pulses; ``delay`` [s], in whole ms, is from recorded to acting effort."""
    t = np.arange(samples) * interval
    train = PulseTrain(seed=seed, amplitude_min=-strength, amplitude_max=strength, **pulses)
    tau = np.column_stack([[train.torque(x) for x in t], np.zeros(samples)])
    if delay:
        every, lead = round(interval * 1000), round(1000 * abs(delay))
        fine = np.arange(-lead, samples * every) * 1e-3
        index = np.floor((fine - delay) / interval + 1e-6).astype(int)
        acting = np.where((index >= 0)[:, None], tau[np.clip(index, 0, samples - 1)], 0.0)
        moved = simulate(rig, fine, acting)[lead::every]
    else:
        moved = simulate(rig, t, tau)
    motion = replace(moved, t=t, tau=tau, name=name or f'virtual rig, seed {seed}')
    return quantised(motion, counts) if counts else motion


def held_torques(samples, every, strength, seed):
    """Return random torques [N m] at the shoulder, each held for ``every`` samples, shape (N, 2)."""
    torques = np.random.default_rng(seed).uniform(-strength, strength, samples // every)
    return np.outer(np.repeat(torques, every), [1, 0])


def recording_of_a_day(day, seconds, rate=200, *, rests=(0, 0), push=(0, 0, 0.0)):
    """Return a recording of a rig of test/changing_rig.py on a day when only the payload changes.

    ``rests``: begin and end of a pause of the torque [s]; ``push``: begin and end [s] and torque [N m] of a hand.
    """
    t, parts, state = np.arange(seconds * rate) / rate, [], {}
    tau = pulses(np.random.default_rng([4, 23]), len(t), rate, STRENGTH, 0.1, 0.5)
    tau[(t >= rests[0]) & (t < rests[1])] = 0.0
    acting = tau + np.where((t >= push[0]) & (t < push[1]), push[2] * np.sin(2 * np.pi * (t - push[0])), 0.0)
    change = round(day.payload_at * rate)
    for begin, end in ((0, change), (change, len(t))):
        rig = Parameters(*truth(day, t[[begin]])[0])
        found = simulate(rig, t[begin : end + 1], np.outer(acting, [1, 0])[begin : end + 1], **state)
        state = {'q': tuple(found.q[-1]), 'qd': tuple(found.qd[-1])}
        parts.append(quantised(found, 4096).q[: end - begin])
    return Trajectory(t, np.concatenate(parts), np.outer(tau, [1, 0]))


def trajectory(recording, name='trajectory'):
    """Return a recording of test/simulated_rig.py as a trajectory."""
    return Trajectory(recording.t, recording.q, np.outer(recording.tau, [1, 0]), name=name)


def exact_motion(theta, samples=500, interval=0.004, *, seed=1, start=0.0, strength=1.0, delay=0):
    """Return a motion without errors: simulated with the integration step of its analysis, with exact velocities.

    Args:
        theta: of the rig, shape (D,).
        samples: number of samples.
        interval: time between samples [s].
        seed: of the torques, random at every sample, and of the initial state.
        start: time of the first sample [s].
        strength: largest torque [N m].
        delay: of the motion behind the recorded effort [samples].
    """
    rng = np.random.default_rng(seed)
    tau = strength * rng.uniform(-1, 1, (samples + 2 * abs(delay), 2))
    x = rng.normal(scale=[[0.5], [0.5], [1], [1]], size=(4, 1))
    states = roll(theta, x, tau.T[:, :-1, None], interval)[:, :, 0]
    here = slice(abs(delay), abs(delay) + samples)
    there = slice(here.start + delay, here.stop + delay)
    t = start + np.arange(samples) * interval
    recorded = Trajectory(t, states[here, :2], tau[there], name=f'exact motion, seed {seed}')
    return replace(Motion.prepare(recorded, 0.0), smoothed=CubicSpline(t, states[here]))


def integrated(theta, state, torques, interval):
    """Return the state after torques, shape (N, 2), each held for an interval [s], by an adaptive integrator."""
    for tau in torques:
        state = solve_ivp(
            lambda _, x, tau=tau: [*x[2:], *forward_dynamics(theta, x[:2], x[2:], tau)],
            (0, interval),
            state,
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
    return state


def vector(model):
    """Return the parameters of the geared rig for a model."""
    return GEARED[: MODELS[model]].copy()
