# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Print the differences between exported rigs in other engines and this package: ``python -m benchmarks.exports``."""

import mujoco
import numpy as np

from pendubot_identification.formats.masses import rig_of
from pendubot_identification.formats.robots import mjcf
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.model.rollout import roll
from test.formats.test_engines import CASES, Mujoco, compared, smooth, states, thetas


def integrators():
    """How far MuJoCo's angles are from the exact ones after a second [rad]: by integrator, and by law of dry friction.

    Returns:
        By name, one value a rig, shape (100,).
    """

    def after(parameters, integrator, q, v, tau):
        there = Mujoco(mjcf(rig_of(parameters)), parameters)
        there.model.opt.integrator = integrator
        there.model.dof_frictionloss = [parameters.Fc1, parameters.Fc2]
        return there.motion(q, v, tau)[-1]

    def exact(parameters, q, v, tau):
        steps = 20000
        torques = np.repeat(tau[:, None, None], steps, axis=1)
        return roll(parameters.vector('rotor'), np.array([*q, *v])[:, None], torques, 1 / steps)[-1, :, 0]

    rng, found = np.random.default_rng(2), {}
    kinds = {name.removeprefix('mjINT_'): kind for name, kind in mujoco.mjtIntegrator.__members__.items()}
    for theta in thetas('coulomb'):
        at = states(rng)
        dry, free = Parameters.from_vector(theta), smooth(theta)
        errors = {f'{name}, no dry friction': after(free, kind, *at) - exact(free, *at) for name, kind in kinds.items()}
        errors['RK4, dry friction'] = after(dry, kinds['RK4'], *at) - exact(dry, *at)
        errors['what dry friction does'] = exact(dry, *at) - exact(free, *at)
        for name, error in errors.items():
            found.setdefault(name, []).append(abs(error[:2]).max())
    return found


if __name__ == '__main__':
    print('| engine | file | model | mass matrix | bias | states of 1 s |\n|---|---|---|---|---|---|')
    for engine, write, model in CASES:
        errors = ' | '.join(f'{error:.0e}' for error in compared(engine, write, model))
        print(f'| {engine.__name__} | {write.__name__} | {model} | {errors} |')
    print('\n| angles in MuJoCo after 1 s [rad] | median | 9 of 10 within |\n|---|---|---|')
    for name, errors in integrators().items():
        print(f'| {name} | {np.median(errors):.1g} | {np.quantile(errors, 0.9):.1g} |')
