# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A motor that gives less torque than commanded, identified from its measured current (--torque-constant)."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import quantised, simulate
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.joint_states import (
    EPOCH_NS,
    JOINT_STATE,
    JOINT_STATES_TOPIC,
    encode_joint_state,
    write_trajectory,
)

#: The motor's constant [N m/A], and the part of the commanded torque that it gives with a winding 50 K warmer.
K, LEFT = 0.05, 0.8
IDENTIFY = ('--criterion', 'likelihood', '--model', 'viscous', '--json')
INERTIAL = ('P1', 'P2', 'P3', 'P4', 'P5')


@pytest.fixture(scope='module')
def motion():
    """What encoders read of the rig, with the torque that truly acted."""
    t = np.arange(3600) / 200
    tau = np.column_stack([PulseTrain().torques(t), np.zeros_like(t)])
    return quantised(simulate(PAPER, t, tau), 4000)


@pytest.fixture(scope='module')
def warm(motion, tmp_path_factory):
    """A folder with a bag as the bridge's messages make it, and one without the current."""
    folder = tmp_path_factory.mktemp('warm')
    commanded, current = motion.tau[:, 0] / LEFT, motion.tau[:, 0] / K
    names = ('shoulder', 'elbow', 'shoulder_current')
    with BagWriter(folder / 'bag') as bag:
        channel = bag.add_topic(JOINT_STATES_TOPIC, JOINT_STATE)
        for at, q, torque, ampere in zip(motion.t, motion.q, commanded, current, strict=True):
            stamp = EPOCH_NS + round(at * 1e9)
            bag.write(channel, encode_joint_state(stamp, names, [*q, 0], [0, 0, 0], [torque, 0, ampere]), stamp)
    write_trajectory(folder / 'without', replace(motion, tau=motion.tau / LEFT))
    return folder


@pytest.fixture
def identified(run):
    """Identifies; returns the result as JSON gives it."""

    def identified(*arguments):
        status, out, err = run('identify', *arguments, *IDENTIFY)
        assert (status, err) == (0, '')
        return json.loads(out)

    return identified


def test_a_bag_is_identified_from_the_current_and_else_from_the_commanded_torque(identified, refused, warm):
    result = identified(warm / 'bag', '--torque-constant', K)
    assert result['reading'] == {'torque_constant': str(K)}
    for name in INERTIAL:
        low, high = result['parameters'][name]['interval']
        assert low < getattr(PAPER, name) < high, name
        assert high - low < 0.1 * getattr(PAPER, name), name
    commanded = identified(warm / 'bag')
    assert commanded['reading'] == {}
    ratios = [commanded['parameters'][name]['value'] / getattr(PAPER, name) for name in INERTIAL]
    np.testing.assert_allclose(ratios, 1 / LEFT, rtol=0.03)
    assert 'has no measured current' in refused('identify', warm / 'without', '--torque-constant', K)
    for value, found in (('x', "'x'"), ('-1', 'torque_constant is -1.0'), ('nan', 'is nan')):
        assert found in refused('identify', warm / 'bag', f'--torque-constant={value}', status=2)
