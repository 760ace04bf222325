# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Every fault that the diagnosis knows, made on purpose: in the terminal and the result file."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.identify import diagnosis
from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.model.simulation import quantised, simulate
from pendubot_identification.recordings.joint_states import write_trajectory
from test.identify.test_diagnosis import FAULTS

OPTIONS = ('--criterion=weak', '--model=viscous', '--optimizer=lsq', '--hold=zero')


def early(motion):
    """The effort's stamps 20 ms early."""
    return replace(motion, tau=np.concatenate([motion.tau[2:], np.repeat(motion.tau[-1:], 2, axis=0)]))


#: By name: what is done to a good recording, and the beginning of what is said.
EVERY = {
    **FAULTS,
    'early effort': (early, r'the effort acts 20 ms later than it is stamped'),
    "the shoulder's effort": (lambda m: replace(m, tau=m.tau * [-1, 1]), "the shoulder's effort has the wrong sign"),
    "the elbow's effort": (lambda m: replace(m, tau=m.tau * [1, -1]), "the elbow's effort has the wrong sign"),
    'efforts exchanged': (lambda m: replace(m, tau=m.tau[:, ::-1]), "the joints' efforts are in the wrong order"),
    'offset': (
        lambda m: replace(m, tau=m.tau + np.array([0.05, 0])),
        r"the shoulder's effort is off by a constant 0\.05 N m",
    ),
    'no pendubot': (lambda m: replace(m, tau=m.tau[::-1]), 'the motion does not fit any pendubot'),
    'length': (lambda m: m, r'the elbow moves as on a link 1 of 0\.15. \+- 0\.\d+ m, 0\.300 m is expected'),
}
#: Parameters are good where the delay was estimated along, and of another length than was measured they may be.
MILD = ('late effort', 'early effort', 'length')


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    """A bag for each fault, of a rig with a motor at both joints."""
    t = np.arange(900) * 0.01
    tau = np.column_stack([[PulseTrain(seed=seed).torque(x) for x in t] for seed in (1, 2)]) * [1, 0.4]
    good = quantised(simulate(BALANCE, t, tau), 4000)
    folder = tmp_path_factory.mktemp('faults')
    for name, (spoil, _) in EVERY.items():
        spoiled = spoil(good)
        q, tau = np.ascontiguousarray(spoiled.q), np.ascontiguousarray(spoiled.tau)
        write_trajectory(folder / name, replace(spoiled, q=q, tau=tau))
    return folder


def test_there_is_a_recording_for_every_fault_that_the_diagnosis_knows():
    made = [found.replace('\\', '') for _, found in EVERY.values()]
    for name, sentence, *_ in diagnosis._TURNS:
        # What is in degrees often turns too fast to be read at all; the disguises have it.
        assert name == 'degrees' or any(sentence.startswith(found) for found in made), sentence


@pytest.mark.parametrize('fault', EVERY)
def test_a_named_fault_loses_no_result(bags, run, tmp_path, fault):
    length, output, mild = ['--link-length=0.3'] * (fault == 'length'), tmp_path / 'result.yaml', fault in MILD
    status, out, err = run('identify', bags / fault, *OPTIONS, *length, '--output', output)
    assert (status, err) == (0 if mild else 3, '')
    data = yaml.safe_load(output.read_text())
    (named,), (warning,) = data['faults'], data['warnings']
    assert re.match(EVERY[fault][1], named['found'])
    assert named['found'] in warning
    assert named['remedy'] in warning
    assert data['level'] == ('WARN' if mild else 'ERROR')
    assert bool(data['consequences']) != mild
    # In the terminal, one fault and where to find what follows from it.
    shown = ' '.join(out.split())
    assert f'{data["level"]}: {" ".join(warning.split())}' in shown
    if not mild:
        followed = sum(len(answer['consequences']) for answer in data['criteria'].values())
        assert f'{followed} more follow from that' in shown
        assert len(out.splitlines()) < 30
