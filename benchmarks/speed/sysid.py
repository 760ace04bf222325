# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Compares this package with mujoco.sysid, a common tool for robots: `pip install mujoco[sysid]`.

    python -m benchmarks.speed.sysid [--test]

Prints a Markdown table. Both fit the same recordings and predict the same others, from the same smoothed states, each
by its own simulation. This package has its defaults. mujoco.sysid gets the settings that its user must choose: masses,
segments of 0.5 s with smoothed states, angles and velocities as signals of the state (its jointpos comes a step late),
RK4, and a start with all lengths wrong by a fifth. --test evaluates the test recordings; without it, the last train
recording replaces them.
"""

import argparse
import contextlib
import io
import logging

import mujoco
import numpy as np
from mujoco import sysid
from scipy.signal import savgol_filter

import pendubot_identification as pendubot
from benchmarks.exports import errors_in_mujoco
from benchmarks.markdown import table
from benchmarks.speed import measure
from pendubot_identification.criteria.prediction_error import (
    ASSESSED,
    HORIZONS,
    STRIDE,
    Simulations,
    predict,
    state_scale,
)
from pendubot_identification.formats.robots import mjcf, rig_of
from pendubot_identification.model.parameters import NAMES, PAPER, Parameters
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import choose_smoothing, evenly_stamped
from test.real import recorded
from test.virtual import C1

#: Initial guesses: the published parameters, from the README beside the recordings.
PUBLISHED = {
    'dfki_C1_sysid': C1,
    'dfki_A0_sysid': Parameters(0.1112, 0.0235, 0.0333, 0.3491, 0.1111, 0.001, 0.001, 0.146, 0.123, 0.0032),
}
CHUNK, STEP = 0.5, 0.002


def fit(recordings, guess):
    """Fit a rig by mujoco.sysid from a guess. Return model, ten parameters and their standard errors."""
    spec = mujoco.MjSpec.from_string(mjcf(rig_of(guess)))
    elbow = spec.add_actuator(name='elbow', target='elbow', trntype=mujoco.mjtTrn.mjTRN_JOINT)
    elbow.set_to_motor()
    spec.option.timestep = STEP
    model = spec.compile()

    def setting(kind, name, attribute):
        def set_to(spec, p):
            part, value = getattr(spec, kind)(name), p.value[0]
            before = getattr(part, attribute)
            several = 3 * [value] if attribute == 'inertia' else [value, *np.ravel(before)[1:]]
            setattr(part, attribute, several if np.ndim(before) else value)

        return set_to

    first, second = spec.body('link_1'), spec.body('link_2')
    params = sysid.ParameterDict()
    for kind, name, attribute, start, most in (
        ('body', 'link_2', 'pos', second.pos[0], None),
        ('body', 'link_1', 'ipos', first.ipos[0], None),
        ('body', 'link_1', 'inertia', first.inertia[0], None),
        ('body', 'link_2', 'ipos', second.ipos[0], None),
        ('body', 'link_2', 'inertia', second.inertia[0], None),
        ('joint', 'shoulder', 'damping', 0.01, 0.5),
        ('joint', 'elbow', 'damping', 0.01, 0.5),
        ('joint', 'shoulder', 'frictionloss', 0.01, 1.0),
        ('joint', 'elbow', 'frictionloss', 0.01, 1.0),
        ('joint', 'elbow', 'armature', 1e-3, 0.05),
    ):
        reach = (start, 0.0, most) if most else (1.2 * start, 0.05 * start, 5 * start)
        params.add(sysid.Parameter(f'{name} {attribute}', *reach, modifier=setting(kind, name, attribute)))

    states, controls, sensors = [], [], []
    kinds = sysid.SignalType.MjStateQPos, sysid.SignalType.MjStateQVel
    observed = [(name, kind) for kind in kinds for name in ('shoulder', 'elbow')]
    for motion in recordings:
        interval = STEP * max(1, round(np.median(np.diff(motion.t)) / STEP))
        t = np.arange(motion.t[0], motion.t[-1], interval)
        raw = np.column_stack([np.interp(t, motion.t, q) for q in motion.q.T])
        window = max(5, 2 * round(0.02 / interval) + 1)
        q, qd = (savgol_filter(raw, window, 3, deriv, interval, axis=0) for deriv in (0, 1))
        fine = np.arange(t[0], t[-1], STEP)
        tau = sysid.TimeSeries(motion.t, motion.tau).interpolate(fine, 'linear')
        per, sub = round(CHUNK / interval), round(interval / STEP)
        for k in range(0, len(t) - per - 2, per):
            times, steps = interval * np.arange(per + 1), slice(k * sub, (k + per) * sub + 1)
            data = np.column_stack([q, qd])[k : k + per + 1]
            if np.any(np.ptp(data, axis=0) < 0.05 * np.ptp(np.column_stack([q, qd]), axis=0)):
                continue  # residuals are divided by the signal's range, which is zero at rest
            states.append(sysid.create_initial_state(model, q[k], qd[k]))
            controls.append(sysid.TimeSeries.from_control_names(STEP * np.arange(per * sub + 1), tau[steps], model))
            sensors.append(sysid.TimeSeries.from_names(times, data, model, observed))
    names = [str(k) for k in range(len(states))]
    sequences = sysid.ModelSequences('rig', spec, names, states, controls, sensors, allow_missing_sensors=True)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    with contextlib.redirect_stdout(io.StringIO()):
        found, result = sysid.optimize(params, residual, verbose=False, x_scale='jac')
    residuals, _, _ = residual(result.x, found)
    covariance, _ = sysid.calculate_intervals(residuals, np.asarray(result.jac))
    model = sysid.apply_param_modifiers(found, spec)
    return model, *ten_of(found, covariance, first.mass, second.mass)


def ten_of(params, covariance, m1, m2):
    """Return P1 to P5, b1, b2, Fc1, Fc2, J2, shape (10,), and their standard errors by the slope."""

    def ten(x):
        l1, d1, I1, d2, I2, b1, b2, Fc1, Fc2, J2 = x
        P = [I1 + m1 * d1**2 + m2 * l1**2, I2 + m2 * d2**2, m2 * l1 * d2, m1 * d1 + m2 * l1, m2 * d2]
        return np.array([*P, b1, b2, Fc1, Fc2, J2])

    x = params.as_vector()
    step = np.diag(1e-6 * np.maximum(np.abs(x), 1e-6))
    slope = np.column_stack([(ten(x + h) - ten(x - h)) / (2 * h.sum()) for h in step])
    return ten(x), np.sqrt(np.einsum('ij,jk,ik->i', slope, covariance, slope))


def simulated(model, motions, scale):
    """Return the errors of a MuJoCo model's predictions, defined as in criteria.prediction_error."""
    parts = (Simulations.of(motions, PAPER.vector(), 0.0, np.zeros(2), (h,), STRIDE) for h in HORIZONS[:ASSESSED])
    return [errors_in_mujoco(model, part, scale)[0] for part in parts]


def ours(recordings, motions, scale):
    """Return this package's parameters, standard errors, prediction errors and selected model."""
    found = pendubot.identify(*recordings)
    value, error = (np.zeros(len(NAMES)) for _ in range(2))
    index = [NAMES.index(name) for name in found.names]
    value[index], error[index] = found.theta, np.nan_to_num(found.std_error)
    effort = found.result.effort
    predicted = predict(motions(effort.hold), found.pendubot.theta, effort.delay, scale).error[:ASSESSED]
    return value[:10], error[:10], predicted, found.result.model


def agree(a, b):
    """Return the number of parameters with overlapping 95 % intervals in two fits, and the number of parameters."""
    known = (a[1] > 0) & (b[1] > 0)
    near = np.abs(a[0] - b[0]) <= 1.96 * (a[1] + b[1])
    return f'{int((near & known).sum())} of {int(known.sum())}'


def rows(rig, guess, use_test):
    """Yield the two rows of a rig: tool, model, errors, times, and figures of the intervals."""
    train = recorded(rig, 'train')
    test = recorded(rig, 'test') if use_test else [train.pop()]
    parts = [evenly_stamped(part) for part in test]
    smoothing = choose_smoothing(parts)

    def motions(hold):
        return [Motion.prepare(part, smoothing, hold) for part in parts]

    scale = state_scale(motions('linear'))
    half = len(train) // 2

    def theirs(recordings):
        model, value, error = fit(recordings, guess)
        return value, error, simulated(model, motions('linear'), scale), 'rotor'

    for name, way in (
        ('mujoco.sysid', theirs),
        ('this package', lambda recordings: ours(recordings, motions, scale)),
    ):
        cpu, wall = measure.cpu(), measure.wall()
        value, error, predicted, model = way(train)
        times = f'{measure.cpu() - cpu:.0f} s', f'{measure.wall() - wall:.0f} s'
        first, second = way(train[:half]), way(train[half:])
        width = np.median(1.96 * error[:5] / np.abs(value[:5]))
        errors = ' / '.join(f'{e:.3f}' for e in predicted)
        yield rig, name, model, errors, *times, f'{100 * width:.2g} %', agree(first, second)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.speed.sysid', description=__doc__.split('\n\n')[0])
    parser.add_argument('--test', action='store_true', help='evaluate the test recordings; seldom')
    args = parser.parse_args()
    logging.getLogger('absl').setLevel(logging.ERROR)
    print(f'{measure.machine()}, mujoco {mujoco.__version__}')
    errors = f'error after {" / ".join(f"{h:g}" for h in HORIZONS[:ASSESSED])} s'
    rest = 'processor', 'wall', 'half of 95 %, P1 to P5', 'two halves agree in'
    of_rigs = (row for rig, guess in PUBLISHED.items() for row in rows(rig, guess, args.test))
    table(('recordings', 'by', 'model', errors, *rest), of_rigs)


if __name__ == '__main__':
    main()
