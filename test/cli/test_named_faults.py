# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Every fault that the diagnosis knows, made on purpose: through result file, report, comparison and node."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from pendubot_identification.cli.main import main
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.identify import diagnosis
from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.model.simulation import quantised, simulate
from pendubot_identification.recordings.joint_states import write_trajectory
from test.identify.test_diagnosis import FAULTS
from test.nodes.test_identifier import listener  # noqa: F401
from test.report.test_page import Page

FAST = {'criterion': 'weak', 'model': 'viscous', 'optimizer': 'lsq', 'hold': 'zero'}
OPTIONS = [f'--{name}={value}' for name, value in FAST.items()]


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
    """A bag for each fault, of a rig with a motor at both joints, and a good one."""
    t = np.arange(900) * 0.01
    tau = np.column_stack([[PulseTrain(seed=seed).torque(x) for x in t] for seed in (1, 2)]) * [1, 0.4]
    good = quantised(simulate(BALANCE, t, tau), 4000)
    folder = tmp_path_factory.mktemp('faults')
    write_trajectory(folder / 'good', good)
    for name, (spoil, _) in EVERY.items():
        spoiled = spoil(good)
        q, tau = np.ascontiguousarray(spoiled.q), np.ascontiguousarray(spoiled.tau)
        write_trajectory(folder / name, replace(spoiled, q=q, tau=tau))
    return folder


def test_there_is_a_recording_for_every_fault_that_the_diagnosis_knows():
    made = [found.replace('\\', '') for _, found in EVERY.values()]
    for turn in diagnosis._TURNS:
        assert any(turn.found.startswith(found) for found in made), turn.found


@pytest.fixture(scope='module')
def good(bags):
    """The result of the recording without a fault."""
    assert main(['identify', str(bags / 'good'), *OPTIONS, '--output', str(bags / 'good.yaml')]) == 0
    return bags / 'good.yaml'


@pytest.mark.parametrize('fault', EVERY)
def test_a_named_fault_loses_no_result(bags, good, tmp_path, capsys, fault):
    said, output, length = EVERY[fault][1], tmp_path / 'result.yaml', ['--link-length=0.3'] * (fault == 'length')
    capsys.readouterr()
    arguments = [*OPTIONS, *length, '--output', str(output), '--report', str(tmp_path / 'look')]
    assert main(['identify', str(bags / fault), *arguments]) == (0 if fault in MILD else 3)
    printed = capsys.readouterr()
    assert not printed.err
    data = yaml.safe_load(output.read_text())
    (named,) = data['faults']
    assert re.match(said, named['found'])
    assert named['found'] in data['warnings'][0]
    assert named['remedy'] in data['warnings'][0]
    assert data['level'] == ('WARN' if fault in MILD else 'ERROR')
    assert bool(data['consequences']) == (fault not in MILD)
    assert len(data['warnings']) == 1
    # In the terminal, one fault and where to find what follows from it.
    shown = ' '.join(printed.out.split())
    assert f'{data["level"]}: {" ".join(data["warnings"][0].split())}' in shown
    if fault not in MILD:
        assert f'{len(data["consequences"])} more follow from that' in shown
        assert len(printed.out.splitlines()) < 25
    # And back.
    assert (tmp_path / 'look' / 'result.yaml').read_bytes() == output.read_bytes()
    text = ' '.join(Page((tmp_path / 'look' / 'report.html').read_text()).text)
    assert all(sentence in text for sentence in [*data['warnings'], *data['consequences']])
    assert main(['compare', str(good), str(output)]) == 0
    assert 'P1 [kg m^2]' in capsys.readouterr().out


def test_the_report_of_a_fault_is_made_again_from_the_file(bags, tmp_path):
    output, look = tmp_path / 'result.yaml', tmp_path / 'look'
    assert main(['identify', str(bags / 'effort'), *OPTIONS, '--output', str(output), '--report', str(look)]) == 3
    assert main(['report', str(output)]) == 0
    for file in look.iterdir():
        assert (tmp_path / 'result_report' / file.name).read_bytes() == file.read_bytes(), file.name


@pytest.mark.ros
def test_the_identifier_publishes_every_named_fault(bags, listener, tmp_path):  # noqa: F811
    for fault, (_, said) in EVERY.items():
        output, length = tmp_path / f'{fault}.yaml', 0.3 if fault == 'length' else 0.0
        asked = FAST | {'output': str(output), 'link_length': length}
        status, values, (params,) = listener.identified(bags / fault, **asked)
        data = yaml.safe_load(output.read_text())
        assert status.level == (b'\x01' if fault in MILD else b'\x02')
        assert re.match(said, status.message)
        assert (f'{len(data["consequences"])} more follow from that' in status.message) == (fault not in MILD)
        assert values['faults.0.found'] == data['faults'][0]['found']
        assert [values[f'consequences.{k}'] for k in range(len(data['consequences']))] == data['consequences']
        assert list(params.data) == [entry['value'] for entry in data['parameters'].values()]
