# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Prints the differences between exported rigs in other engines and this package: ``python -m benchmarks.exports``.

A second table compares the prediction errors of identified parameters in MuJoCo and in this package.
"""

import importlib
import tempfile

import mujoco
import numpy as np

from benchmarks.markdown import table
from pendubot_identification import read
from pendubot_identification.criteria import prediction_error
from pendubot_identification.criteria.prediction_error import ASSESSED, HORIZONS, STRIDE, Simulations, state_scale
from pendubot_identification.formats.robots import mjcf, rig_of, urdf
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.model.dynamics import GRAVITY
from pendubot_identification.model.parameters import MODELS, Parameters
from pendubot_identification.trajectories.motion import Motion
from test.formats.test_engines import STEP, STEPS, Mujoco, compared
from test.real import RIGS, recorded
from test.simulated_rig import runge_kutta


class Engine:
    """An engine with accelerations that this class integrates."""

    def motion(self, q, v, tau):
        def slope(x):
            M, bias = self.terms(x[:2], x[2:])
            return np.array([*x[2:], *np.linalg.solve(M, tau - bias - self.damping * x[2:])])

        x, found = np.array([*q, *v]), []
        for _ in range(STEPS):
            x = runge_kutta(slope, x, STEP)
            found.append(x)
        return np.array(found)


class Pinocchio(Engine):
    """A robot description file in Pinocchio."""

    def __init__(self, text, parameters):
        self.engine = importlib.import_module('pinocchio')
        if '<mujoco' in text:
            with tempfile.NamedTemporaryFile('w', suffix='.xml') as file:
                file.write(text)
                file.flush()
                self.model = self.engine.buildModelFromMJCF(file.name)
        else:
            self.model = self.engine.buildModelFromXML(text)
            self.model.armature = np.array([0.0, parameters.J2])
        self.data, self.damping = self.model.createData(), np.array([parameters.b1, parameters.b2])

    def at(self, q):
        """Return Pinocchio's coordinates; a joint without limits has two."""
        return self.engine.integrate(self.model, self.engine.neutral(self.model), q)

    def terms(self, q, v):
        M = self.engine.crba(self.model, self.data, self.at(q))
        return np.triu(M) + np.triu(M, 1).T, self.engine.nonLinearEffects(self.model, self.data, self.at(q), v).copy()


class Drake(Engine):
    """A robot description file in Drake."""

    def __init__(self, text, parameters):
        multibody, parsing = (importlib.import_module(f'pydrake.multibody.{name}') for name in ('plant', 'parsing'))
        self.plant = plant = multibody.MultibodyPlant(0.0)
        parsing.Parser(plant).AddModelsFromString(text, 'urdf')
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName('base_link'))
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -GRAVITY])
        plant.Finalize()
        self.damping = np.array([plant.GetJointByName(name).default_damping() for name in ('shoulder', 'elbow')])
        assert [*self.damping] == [parameters.b1, parameters.b2]
        self.context, self.rotor = plant.CreateDefaultContext(), np.diag([0.0, parameters.J2])

    def terms(self, q, v):
        self.plant.SetPositions(self.context, q)
        self.plant.SetVelocities(self.context, v)
        gravity = self.plant.CalcGravityGeneralizedForces(self.context)
        return self.plant.CalcMassMatrix(self.context) + self.rotor, self.plant.CalcBiasTerm(self.context) - gravity


def predictions(recording):
    """Return the prediction errors of a recording's second half by its first one, here and in MuJoCo."""
    halves = recording[: len(recording) // 2], recording[len(recording) // 2 :]
    found = identify(halves[:1], halves[1:])
    best = found.best
    training, validation = (Motion.prepare(half, found.smoothing, best.effort.hold) for half in halves)
    given = best.theta, best.effort.delay, best.zeros.angles[:, 1]
    simulations = Simulations.of([validation], *given, HORIZONS[:ASSESSED], STRIDE)
    model = mujoco.MjModel.from_xml_string(mjcf(rig_of(Parameters.from_vector(best.theta))))
    return best.prediction.error[:ASSESSED], errors_in_mujoco(model, simulations, state_scale([training]), 2)


def errors_in_mujoco(model, simulations, scale, substeps=1):
    """Return the RMS prediction error of a MuJoCo model at every horizon, divided by the scale of the states."""
    data, states = mujoco.MjData(model), np.empty((max(simulations.at) + 1, 4, len(simulations.t)))
    model.opt.timestep = prediction_error.STEP / simulations.substeps / substeps
    for lane, start in enumerate(simulations.start.T):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel = start[:2], start[2:]
        for k, tau in enumerate(simulations.tau[:, :, lane].T, 1):
            data.qfrc_applied = tau
            mujoco.mj_step(model, data, substeps)
            states[k, :, lane] = [*data.qpos, *data.qvel]
    errors = (states[list(simulations.at)] - simulations.end) / scale[:, None]
    return np.sqrt((errors**2).mean(axis=(1, 2)))


CASES = [
    *((Mujoco, mjcf, model) for model in MODELS),
    (Pinocchio, mjcf, 'geared'),
    (Mujoco, urdf, 'geared'),
    (Pinocchio, urdf, 'geared'),
    (Drake, urdf, 'geared'),
]


if __name__ == '__main__':
    differences = (
        (engine.__name__, write.__name__, model, *(f'{e:.0e}' for e in compared(engine, write, model, 100)))
        for engine, write, model in CASES
    )
    table(('engine', 'file', 'model', 'mass matrix', 'bias', 'states of 1 s'), differences)
    motions = read('bags/paper_experiment'), *(recorded(rig, 'train')[0] for rig in RIGS)
    errors = ((m.name, *(' / '.join(f'{e:.4f}' for e in each) for each in predictions(m))) for m in motions)
    table(('recording', 'error here', 'in MuJoCo'), errors)
