# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The subcommands for bags: import, simulate, info and repair."""

import json
import re
import shutil
from dataclasses import asdict, replace

import numpy as np
import pytest
import yaml

from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import simulate
from pendubot_identification.recordings.bag_reader import BagReader, read_trajectory
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.joint_states import JOINT_STATE, encode_joint_state
from pendubot_identification.results.result import SCHEMA
from test.cli.conftest import contents
from test.processes import small_disk
from test.recordings import damage
from test.recordings.bags import START, STEP, TOPIC
from test.recordings.independent import by_mcap

GEARED = replace(PAPER, Fc1=0.004, Fc2=0.001, J2=1e-4, Fs1=0.002, Fs2=0.0005, k1=0.1, k2=0.1)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_CSV_file_becomes_a_bag_and_force_replaces_one(run, tmp_path):
    rows = [f'{0.01 * k:.2f},{k},{90 + k},{k / 2}' for k in range(101)]
    (tmp_path / 'run.csv').write_text('\n'.join(['time,a,b,u', *rows]))
    assert run('simulate', '--output', 'bag', '--samples', '50')[0] == 0
    options = ('--columns', 't=time,q1=a,q2=b,tau1=u', '--degrees', '--zero', 'hanging', '--elbow', 'absolute')
    status, out, err = run('import', 'run.csv', '--output', 'bag', *options, '--force')
    assert (status, out.splitlines()[0], err) == (0, 'bag: 101 samples, 1.000 s, 100.0 Hz', '')
    trajectory = read_trajectory(tmp_path / 'bag').trajectory
    np.testing.assert_allclose(trajectory.q[10], np.deg2rad([10 - 90, 90]))
    np.testing.assert_array_equal(trajectory.tau[10], [5, 0])
    assert trajectory.qd is None


@pytest.mark.parametrize('rig', [PAPER, replace(PAPER, Fc1=0.004), GEARED])
def test_simulate_uses_the_papers_rig_or_the_parameters_of_a_result(run, tmp_path, rig):
    """A file written by hand may omit zero parameters."""
    values = {name: {'value': value} for name, value in asdict(rig).items() if value}
    (tmp_path / 'rig.yaml').write_text(yaml.safe_dump({'schema': SCHEMA, 'parameters': values}))
    options = () if rig == PAPER else ('--parameters', 'rig.yaml')
    for name in 'ab':
        command = ('simulate', '--output', f'{name}/bag', '--samples', '150', '--counts', '0', *options)
        assert run(*command)[0] == 0
    motion = read_trajectory(tmp_path / 'a/bag').trajectory
    np.testing.assert_allclose(motion.q, simulate(rig, np.arange(150) / 100, motion.tau).q, atol=1e-9)
    first, second = (next(tmp_path.glob(f'{name}/bag/*.mcap')) for name in 'ab')
    assert first.read_bytes() == second.read_bytes(), 'the same options must give the same bag'


def test_irregular_and_missing_messages_are_counted(run, tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        channel = bag.add_topic(TOPIC, JOINT_STATE)
        for k in range(100):
            if k in (40, 41):
                continue
            # Timestamps 3 ms before reception; one is repeated, one runs backwards.
            stamp = START + {70: 69, 80: 60}.get(k, k) * STEP
            data = encode_joint_state(stamp, ('a', 'b'), [0, 0], [], [0, 0])
            bag.write(channel, data, START + k * STEP + 3_000_000, sequence=k + 1)
    (topic,) = json.loads(run('info', 'bag', '--json')[1])['topics']
    expected = {'gaps': 3, 'missing': 4, 'first_gap': 0.39, 'repeated': 1, 'backwards': 1, 'lost': 2}
    assert topic.items() >= (expected | {'period': 0.01, 'latency': 0.003, 'latency_max': 0.203}).items()
    # Three of 95 intervals are longer than the period, by 20, 10 and 10 ms.
    assert topic['jitter'] == pytest.approx(0.0106)
    text = run('info', 'bag')[1]
    assert 'first after 0.390 s' in text
    assert 'at most 203.000 ms' in text


def test_a_killed_bag_becomes_a_closed_copy(run, tmp_path):
    """The bag lacks its end, and one byte is changed."""
    sent = damage.write(tmp_path / 'swing', closed=False)
    file = tmp_path / 'swing' / 'swing_0.mcap'
    damage.flip(file, file.read_bytes().index(sent[200][2]) + 20)
    before = contents(tmp_path / 'swing')
    assert 'pendubot repair makes a closed copy' in run('info', 'swing')[1]
    assert run('repair', 'swing/')[0] == 0
    bag = BagReader(tmp_path / 'swing_repaired')
    assert (bag.closed, bag.count) == (True, len(by_mcap(tmp_path / 'swing_repaired')))
    assert damage.COUNT - 11 <= bag.count < damage.COUNT
    summary = json.loads(run('repair', 'swing', '--output', 'whole', '--json')[1])
    (saved,) = summary['files']
    assert (summary['output'], summary['intact'], saved['closed']) == ('whole', False, False)
    assert sum(saved['saved'].values()) + sum(saved['missing'].values()) == damage.COUNT
    assert [set(place) for place in saved['damaged']] == [{'offset', 'size'}]
    assert contents(tmp_path / 'swing') == before
    assert run('repair', 'swing/swing_0.mcap')[0] == 0
    assert BagReader(tmp_path / 'swing' / 'swing_0_repaired').closed, 'the copy of a single file must be beside it'


@pytest.mark.parametrize(('command', 'samples'), [('identify', 40), ('track', 70)])
def test_a_truncated_bag_is_named_as_the_cause_of_a_failure(run, tmp_path, command, samples):
    assert run('simulate', '--output', 'swing', '--samples', samples)[0] == 0
    (file,) = (tmp_path / 'swing').glob('*.mcap')
    file.write_bytes(file.read_bytes()[:-200])
    status, _, message = run(command, 'swing')
    assert status == 1
    assert 'was never closed, or is truncated or damaged' in message


@pytest.mark.parametrize(
    ('command', 'name'), [('import {}/run.csv', 'earlier'), ('simulate', 'new'), ('repair {}/sim', 'earlier')]
)
def test_on_a_full_disk_no_bag_is_left_and_an_earlier_one_is_unchanged(run, inputs, tmp_path, command, name):
    rows = (f'{0.01 * k},{np.sin(k)},{np.cos(k)},{np.sin(k)}' for k in range(2000))
    (tmp_path / 'run.csv').write_text('\n'.join(['t,q1,q2,tau1', *rows]))
    before = contents(shutil.copytree(inputs / 'sim', tmp_path / 'earlier'))
    words = command.format(tmp_path if 'csv' in command else inputs).split()
    with small_disk(100_000):
        status, out, err = run(*words, '--output', tmp_path / name, '--force')
    assert (status, out) == (1, '')
    assert re.fullmatch(rf'pendubot: {tmp_path / name} is not written: .*\n', err)
    assert contents(tmp_path / 'earlier') == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ['earlier', 'run.csv']
