# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Exported rigs in MuJoCo, compared with the package's equations of motion; see ``benchmarks.exports``, too."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.formats.robots import mjcf, rig_of, urdf
from pendubot_identification.model.dynamics import forward_dynamics, mass_matrix
from pendubot_identification.model.parameters import BALANCE, MODELS, Parameters
from pendubot_identification.model.rollout import roll
from test.strategies import theta

RIGS, STEP, STEPS = 4, 0.002, 500
#: Largest difference of mass matrix and bias, relative, and of the states within a second [rad, rad/s].
TOLERANCE = 1e-6


def rigs(model, count):
    rng = np.random.default_rng(1)
    for _ in range(count):
        length, mass = rng.uniform(0.08, 0.5, 2), rng.uniform(0.05, 1.5, 2)
        centre, radius = length * rng.uniform(0.2, 1.1, 2), length * rng.uniform(0.15, 0.5, 2)
        vector = theta(*mass, length[0], *centre, *(mass * radius**2))
        friction = rng.uniform(0, [0.02, 0.005, 0.05, 0.01, 0.2 * vector[1], 0.02, 0.005, 0.1, 0.0])
        yield Parameters.from_vector([*vector, *friction][: MODELS[model]])


class Mujoco:
    """An exported file in MuJoCo: mass matrix, bias, and a second of motion by MuJoCo's integrator."""

    def __init__(self, text, parameters):
        self.engine = pytest.importorskip('mujoco')
        self.model = model = self.engine.MjModel.from_xml_string(text)
        p = parameters
        np.testing.assert_array_equal(model.dof_damping, [p.b1, p.b2])
        np.testing.assert_array_equal(model.dof_frictionloss, [p.Fc1, p.Fc2])
        model.dof_frictionloss = 0.0
        if '<mujoco' not in text:  # URDF has no such entries
            model.dof_armature, model.opt.integrator = [0.0, p.J2], self.engine.mjtIntegrator.mjINT_RK4
        self.data = self.engine.MjData(model)

    def terms(self, q, v):
        self.data.qpos, self.data.qvel = q, v
        self.engine.mj_forward(self.model, self.data)
        M = np.zeros((2, 2))
        self.engine.mj_fullM(self.model, self.data, M)
        return M, self.data.qfrc_bias.copy()

    def motion(self, q, v, tau):
        self.engine.mj_resetData(self.model, self.data)
        self.data.qpos, self.data.qvel, self.data.qfrc_applied = q, v, tau
        found = []
        for _ in range(STEPS):
            self.engine.mj_step(self.model, self.data)
            found.append([*self.data.qpos, *self.data.qvel])
        assert self.data.time == pytest.approx(STEPS * STEP), 'the time step of the file'
        return np.array(found)


def compared(engine, write, model, count=RIGS):
    """Return the largest differences of mass matrix and bias, relative, and of motions [rad, rad/s]."""
    rng, largest = np.random.default_rng(2), np.zeros(3)
    for parameters in rigs(model, count):
        exported = engine(write(rig_of(parameters), ['a <bag> -- & more ---']), parameters)
        q, v, tau = rng.uniform(-4, 4, 2), rng.uniform(-4, 4, 2), np.array([rng.uniform(-0.5, 0.5), 0.0])
        M, bias = exported.terms(q, v)
        # MuJoCo models dry friction differently.
        smooth = replace(parameters, Fc1=0.0, Fc2=0.0, Fs1=0.0, Fs2=0.0, k1=0.0, k2=0.0)
        vector = smooth.vector('rotor')
        M_ours = mass_matrix(vector, q)
        bias_ours = -M_ours @ forward_dynamics(replace(smooth, b1=0.0, b2=0.0).vector('rotor'), q, v, (0, 0))
        torques = np.repeat(tau[:, None, None], STEPS, axis=1)
        ours = roll(vector, np.array([*q, *v])[:, None], torques, STEP)[1:, :, 0]
        errors = (
            abs(M - M_ours).max() / abs(M_ours).max(),
            abs(bias - bias_ours).max() / abs(bias_ours).max(),
            abs(exported.motion(q, v, tau) - ours).max(),
        )
        largest = np.maximum(largest, errors)
    return largest


def revolute(rig, comments):
    return urdf(rig, comments, revolute=True)


@pytest.mark.parametrize(
    ('write', 'model'), [(mjcf, 'viscous'), (mjcf, 'geared'), (urdf, 'geared'), (revolute, 'geared')]
)
def test_random_rigs_move_in_mujoco_by_the_equations_of_the_package(write, model):
    assert max(compared(Mujoco, write, model)) < TOLERANCE


def test_the_exported_rig_starts_hanging_and_limits_its_torque():
    engine = pytest.importorskip('mujoco')
    model = engine.MjModel.from_xml_string(mjcf(rig_of(BALANCE), torque_limit=0.5))
    data = engine.MjData(model)
    engine.mj_resetDataKeyframe(model, data, model.key('hanging').id)
    for _ in range(STEPS):
        engine.mj_step(model, data)
    np.testing.assert_allclose([*data.qpos, *data.qvel], [-np.pi / 2, 0, 0, 0], atol=1e-9)
    data.ctrl = 3.0
    engine.mj_step(model, data)
    np.testing.assert_allclose(data.qfrc_actuator, [0.5, 0.0])


def test_a_delayed_torque_moves_the_rig_later():
    """The last stage of RK4 uses the next torque, an error of a sixth of a time step."""
    engine, late = pytest.importorskip('mujoco'), 5
    model = engine.MjModel.from_xml_string(mjcf(rig_of(BALANCE), delay=late * STEP))
    data, torques, found = engine.MjData(model), np.zeros((2, STEPS + late, 1)), []
    torques[0, late:, 0] = np.random.default_rng(3).uniform(-0.5, 0.5, STEPS // 10).repeat(10)
    engine.mj_resetDataKeyframe(model, data, model.key('hanging').id)
    start = np.array([*data.qpos, *data.qvel])[:, None]
    for tau in torques[0, late:, 0]:
        data.ctrl = tau
        engine.mj_step(model, data)
        found.append([*data.qpos, *data.qvel])
    delayed, prompt = (roll(BALANCE.vector(), start, torques[:, k : k + STEPS], STEP)[1:, :, 0] for k in (0, late))
    assert np.abs(found - delayed).max() < 0.05 * np.abs(found - prompt).max()
