# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The design of an excitation: predicted standard errors, and limits."""

import math

import numpy as np
import pytest

from pendubot_identification.errors import ExcitationError, ParameterError
from pendubot_identification.excitation.design import Experiment, Limits, design, predict
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.model.parameters import PAPER, Parameters
from pendubot_identification.model.simulation import HANGING, simulate
from test.virtual import GEARED

SHORT = Experiment(duration=2.0)


def paper_pulses(torque):
    return PulseTrain(amplitude_min=-torque, amplitude_max=torque)


def simulated(parameters, train, experiment, *start):
    t = np.arange(round(experiment.duration / experiment.interval)) * experiment.interval
    return simulate(parameters, t, np.column_stack([train.torques(t), np.zeros(len(t))]), *start)


def expected_errors(parameters, train, experiment):
    """Return standard errors by central differences of simulated motions."""
    theta = parameters.vector()

    def motion(change):
        p = Parameters.from_vector(theta * (1 + change[5:]))
        result = simulated(p, train, experiment, tuple(HANGING + change[:2]), tuple(change[2:4]))
        return result.q - change[4] * result.qd

    size = 5 + len(theta)
    step = 1e-4
    columns = [(motion(step * e) - motion(-step * e)).ravel() / (2 * step) for e in np.eye(size)]
    noise = 2 * math.pi / experiment.counts / math.sqrt(12)
    jacobian = np.column_stack(columns) / noise
    return np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))[5:] * np.abs(theta)


@pytest.mark.parametrize('interval', [0.02, 0.004])
def test_predicted_standard_errors_agree_with_finite_differences_of_simulations(interval):
    experiment = Experiment(duration=1.0, interval=interval)
    train = PulseTrain(period=0.5, width=0.2, amplitude_min=-0.6, amplitude_max=0.6, hold=0.05, seed=3)
    (found,) = predict(PAPER, [train], experiment)
    np.testing.assert_allclose(found.std_error, expected_errors(PAPER, train, experiment), rtol=0.03)
    motion = simulated(PAPER, train, experiment)
    np.testing.assert_allclose(found.speed, np.abs(motion.qd).max(axis=0), rtol=0.03)
    np.testing.assert_allclose(found.angle, np.abs(motion.q - HANGING).max(axis=0), rtol=0.01)


def test_standard_errors_are_proportional_to_the_encoder_step_and_huge_without_motion():
    train = paper_pulses(1.0)
    coarse, fine = (predict(PAPER, [train], Experiment(2.0, 0.01, n))[0] for n in (4000, 8000))
    np.testing.assert_allclose(coarse.std_error, 2 * fine.std_error, rtol=1e-6)
    (still,) = predict(PAPER, [PulseTrain(amplitude_min=-1e-9, amplitude_max=1e-9)], SHORT)
    assert not (still.std_error < 1000 * coarse.std_error).any()


def test_a_design_is_more_informative_than_the_papers_pulses_and_keeps_the_limits():
    limits = Limits(torque=0.8, speed=18.0, angle=(2.0, 5.0))
    reports = []
    found = design(PAPER, limits, SHORT, generations=3, progress=lambda *report: reports.append(report))
    (paper,) = predict(PAPER, [paper_pulses(0.8)], SHORT)
    assert found.log_information > paper.log_information
    assert max(-found.train.amplitude_min, found.train.amplitude_max) <= 0.8
    motion = simulated(PAPER, found.train, SHORT)
    assert np.abs(motion.qd).max() <= 18.0
    assert (np.abs(motion.q - HANGING).max(axis=0) <= (2.0, 5.0)).all()
    assert sorted({done for done, _ in reports}) == [1, 2, 3]
    assert np.diff([best for _, best in reports]).min() >= 0
    assert design(PAPER, limits, SHORT, generations=3).train == found.train, 'same seed, same design'


def test_a_rig_with_dry_friction_and_a_rotor_gets_a_design():
    rig = Parameters.from_vector(GEARED)
    experiment = Experiment(duration=1.0, interval=0.01)
    found = design(rig, Limits(torque=4.0, speed=25.0), experiment, generations=1)
    assert np.isfinite(found.std_error[:-1]).all()
    assert np.isinf(found.std_error[-1]), 'k2 is not identifiable without a torque at the elbow'
    assert found.speed.max() <= 25.0


def test_limits_without_a_feasible_design_and_unphysical_rigs_are_refused():
    with pytest.raises(ExcitationError, match=r'below 0.001 .* limits of the angles; allow a greater speed or angle'):
        design(PAPER, Limits(torque=1.0, speed=1e-3), SHORT, generations=2)
    with pytest.raises(ParameterError, match='no rig moves like this'):
        predict(Parameters(1e-3, 1e-3, 1e-3, 0, 0, 0, 0), [paper_pulses(1.0)], SHORT)


@pytest.mark.filterwarnings('error')
def test_torques_that_make_every_simulation_diverge_give_an_error_without_a_warning():
    limits = Limits(torque=1000, speed=1e5)
    assert limits.used(np.full(2, np.inf), np.full(2, np.inf)) == np.inf
    with pytest.raises(ExcitationError, match='no pulses up to 1000 N m were found'):
        design(Parameters.from_vector(0.1 * PAPER.vector()), limits, SHORT, generations=1)


def test_pulses_begin_with_each_period_hold_each_torque_and_are_reproducible():
    options = {'period': 0.5, 'width': 0.1, 'amplitude_min': -0.5, 'amplitude_max': 1.0, 'hold': 0.02, 'seed': 3}
    train, t = PulseTrain(**options), np.arange(-10, 150) * 0.01
    torques = train.torques(t)
    np.testing.assert_array_equal(torques, [PulseTrain(**options).torque(x) for x in t])
    assert ((torques >= -0.5) & (torques <= 1.0)).all()
    assert not torques[:10].any(), 'before the start'
    pulses = torques[10:].reshape(3, 50)
    assert (pulses[:, :5] != 0).all()
    assert not pulses[:, 5:].any()
    np.testing.assert_array_equal(pulses[:, :4:2], pulses[:, 1:4:2])
    assert len(np.unique(pulses[:, :5:2])) == 9
    assert train.torque(0.53) == pulses[1, 3]
