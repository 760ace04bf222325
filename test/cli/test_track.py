# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""pendubot track from outside."""

import json

import numpy as np
import pytest
import yaml

from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.results import track_file
from pendubot_identification.results.result_file import read_result
from pendubot_identification.trajectories.trajectory import Trajectory
from test.changing_rig import Day, record, truth
from test.processes import run_program

DAY = Day(payload=0.2, payload_at=16.0)


@pytest.fixture(scope='module')
def motion():
    t, q, tau = record([4], [DAY], seconds=26.0)
    return Trajectory(t, q[0], np.column_stack([tau[0], 0 * t]))


@pytest.fixture(scope='module')
def bag(motion, tmp_path_factory):
    path = tmp_path_factory.mktemp('bags') / 'day'
    write_trajectory(path, motion)
    return path


def test_a_bag_is_followed_and_written_as_a_result_with_a_figure(run, refused, bag, tmp_path):
    now, look = tmp_path / 'now.yaml', tmp_path / 'look'
    status, out, err = run('track', bag, '--output', now, '--report', look, '--figures')
    assert (status, err) == (0, '')
    assert 'payload on link 2, at 15.' in out
    assert 'level OK' in out
    result = read_result(now)
    assert (np.abs(result.theta.vector('coulomb') / truth(DAY, [25.0])[0] - 1) < 0.01)[:5].all()
    assert result.level.name == 'OK'
    told = yaml.safe_load(now.read_text())['tracked']
    assert told['events'][0]['kind'] == 'payload on link 2'
    assert len(told['t']) == len(told['values']['P1']) > 20
    assert {path.name for path in look.iterdir()} == {'report.html', 'result.yaml', 'track.png', 'track.svg'}
    assert f'OK at {max(told["t"]):.0f} s' in (look / 'report.html').read_text()
    # What was written is where the next one begins; and is read by what reads results.
    status, out, _ = run('track', f'{bag}@17:', '--start', now, '--json')
    assert status == 0
    assert json.loads(out)['tracked']['events'] == []
    assert run('compare', now, look / 'result.yaml')[0] == 0
    # But not at level ERROR.
    now.write_text(now.read_text().replace('level: OK', 'level: ERROR'))
    assert 'is of level ERROR' in refused('track', bag, '--start', now)


def test_the_page_shows_the_newest_state_though_of_many_some_are_forgotten(run, bag, tmp_path, monkeypatch):
    _, out, _ = run('track', bag, '--json')
    newest = max(json.loads(out)['tracked']['t'])
    monkeypatch.setattr(track_file, 'KEPT', 4)
    run('track', bag, '--output', tmp_path / 'now.yaml', '--report', tmp_path / 'look')
    assert max(yaml.safe_load((tmp_path / 'now.yaml').read_text())['tracked']['t']) < newest - 1
    assert f'OK at {newest:.0f} s' in (tmp_path / 'look' / 'report.html').read_text()


def test_what_was_followed_is_said_though_the_disk_is_full(bag, tmp_path):
    ended = run_program('pendubot', 'track', bag, '--report', tmp_path / 'look', file_limit=20_000)
    assert ended.returncode == 1
    assert 'payload on link 2, at 15.' in ended.stdout
    assert ended.stderr.endswith('cannot be written (File too large); choose a folder that can be\n')
    assert 'written to' not in ended.stdout


def test_parts_one_after_the_other_are_one_stream(run, motion, tmp_path):
    for name, part in (('a', motion[motion.t < 16]), ('b', motion[motion.t >= 16])):
        rows = np.column_stack([part.t, part.q, part.tau[:, 0]])
        np.savetxt(tmp_path / f'{name}.csv', rows, delimiter=',', header='t,q1,q2,tau1', comments='')
    status, out, err = run('track', tmp_path / 'a.csv', tmp_path / 'b.csv')
    assert (status, err) == (0, '')
    assert 'payload on link 2' in out
    assert 'a gap between samples, 1 times' in out


@pytest.mark.parametrize(
    ('words', 'status', 'said'),
    [
        ('none', 1, 'there is no bag none'),
        ('BAG@0:3', 1, 'no parameters were found: 8 s of motion without a gap are needed'),
        ('BAG --joints a', 2, 'two are expected'),
        ('BAG --output BAG/metadata.yaml --force', 1, 'is read, so it cannot be written'),
    ],
)
def test_a_mistake_is_one_sentence(refused, bag, tmp_path, monkeypatch, words, status, said):
    monkeypatch.chdir(tmp_path)
    assert said in refused('track', *words.replace('BAG', str(bag)).split(), status=status)
    assert not list(tmp_path.iterdir())
