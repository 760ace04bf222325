# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Faults of recordings: terminal and result file name them with a remedy."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.model.simulation import quantised, simulate
from pendubot_identification.recordings.joint_states import write_trajectory

OPTIONS = ('--criterion=weak', '--model=viscous', '--optimizer=lsq', '--hold=zero')


def early(m):
    """Make the timestamps of the effort two samples early."""
    return replace(m, tau=np.concatenate([m.tau[2:], m.tau[-1:], m.tau[-1:]]))


def torques(T, offset=0.0):
    """Return a function that transforms the torques by a matrix and an offset [N m] at the shoulder."""
    return lambda m: replace(m, tau=m.tau @ np.array(T) + np.array([offset, 0.0]))


#: By name: change of a good recording of a rig with two motors, message, and whether the parameters stay accurate.
FAULTS = {
    'early effort': (early, 'the effort acts 20 ms later than it is stamped', True),
    "the shoulder's effort": (torques([[-1, 0], [0, 1]]), "the shoulder's effort has the wrong sign", False),
    "the elbow's effort": (torques([[1, 0], [0, -1]]), "the elbow's effort has the wrong sign", False),
    'efforts exchanged': (torques([[0, 1], [1, 0]]), "the joints' efforts are in the wrong order", False),
    'offset': (torques(np.eye(2), 0.05), r"the shoulder's effort is off by a constant 0\.05 N m", False),
    'no pendubot': (lambda m: replace(m, tau=m.tau[::-1]), 'the motion does not fit any pendubot', False),
}


@pytest.fixture(scope='module')
def good():
    t = np.arange(900) * 0.01
    tau = np.column_stack([PulseTrain(seed=seed).torques(t) for seed in (1, 2)]) * [1, 0.4]
    return quantised(simulate(BALANCE, t, tau), 4000)


@pytest.mark.parametrize('fault', FAULTS)
def test_a_fault_is_named_with_a_remedy_and_the_result_is_still_written(good, run, tmp_path, fault):
    spoil, sentence, mild = FAULTS[fault]
    spoiled = spoil(good)
    write_trajectory(tmp_path / 'bag', replace(spoiled, tau=np.ascontiguousarray(spoiled.tau)))
    output = tmp_path / 'result.yaml'
    status, out, err = run('identify', tmp_path / 'bag', *OPTIONS, '--output', output)
    assert (status, err) == (0 if mild else 3, '')
    data = yaml.safe_load(output.read_text())
    (named,), (warning,) = data['faults'], data['warnings']
    assert re.match(sentence, named['found'])
    assert named['found'] in warning
    assert named['remedy'] in warning
    assert data['level'] == ('WARN' if mild else 'ERROR')
    assert bool(data['consequences']) != mild
    # The terminal shows one fault, and the number of its consequences.
    assert f'{data["level"]}: {" ".join(warning.split())}' in ' '.join(out.split())
    assert mild or 'more follow from that' in out
    assert run('identify', tmp_path / 'bag', *OPTIONS, '--fail-on', 'never')[0] == 0
