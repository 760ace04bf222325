# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Search bounds: default bounds are scaled to the rig, given bounds are kept."""

import numpy as np
import pytest

from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import Parameters, default_bounds
from pendubot_identification.model.simulation import quantised, simulate

#: Links of 1 m, 20 and 10 kg, and of 20 cm, 100 and 50 g, with the same ratio of friction to torque.
LARGE = Parameters(17.0, 3.3, 5.0, 20.0, 5.0, b1=2.0, b2=0.4, Fc1=6.0, Fc2=1.0)
SMALL = Parameters(0.0034, 0.00067, 0.001, 0.02, 0.005, b1=0.0009, b2=0.0002, Fc1=0.006, Fc2=0.001)


def motion(rig):
    t = np.arange(1200) * 0.01
    tau = np.repeat(np.random.default_rng(1).uniform(-1, 1, 60), 20) * 9.81 * rig.P4
    return quantised(simulate(rig, t, np.column_stack([tau, 0 * tau])), 4000)


@pytest.fixture(scope='module')
def large():
    return motion(LARGE)


def test_default_bounds_are_scaled_to_the_rig_by_powers_of_ten(large):
    upper = default_bounds().upper
    box = Settings().of_rig([large]).bounds
    # The elbow has no motor, hence no friction under load; k1 has no unit, hence no scale.
    np.testing.assert_array_equal(box.upper, [*(100 * upper[:12]), upper[12], 0.0])
    np.testing.assert_array_equal(box.lower, np.zeros(14))
    np.testing.assert_array_equal(Settings().of_rig([motion(SMALL)]).bounds.upper[:12], upper[:12])


def test_given_bounds_are_kept(large):
    given = default_bounds().replaced('P1', 0.0, 3.0).replaced('b2', 0.4, 0.4).replaced('Fc1', 0.0, 2.0)
    box = Settings(bounds=given).of_rig([large]).bounds
    assert dict(zip(box.names, box.upper, strict=True)).items() >= {'P1': 3.0, 'b2': 0.4, 'Fc1': 2.0}.items()
    assert (box.lower[6], box.upper[3]) == (0.4, 500.0)


@pytest.mark.parametrize('criterion', ['energy', 'weak'])
def test_a_rig_beyond_the_default_bounds_is_identified(large, criterion):
    found = identify([large], (), Settings((criterion,), 'coulomb', optimizer='mde', hold='zero', runs=2))
    np.testing.assert_allclose(found.best.theta[:5], LARGE.vector()[:5], rtol=0.02)
    assert not any('lies on its bound' in warning for warning in found.warnings)
    assert criterion == 'energy' or found.level is Level.OK
