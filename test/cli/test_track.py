# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The subcommand track."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.results.result import read_result
from test.changing_rig import Day, truth
from test.processes import small_disk
from test.recordings.bags import csv
from test.virtual import recording_of_a_day

DAY = Day(payload=0.2, payload_at=16.0)


@pytest.fixture(scope='module')
def motion():
    return recording_of_a_day(DAY, 26)


@pytest.fixture(scope='module')
def bag(motion, tmp_path_factory):
    path = tmp_path_factory.mktemp('bags') / 'day'
    write_trajectory(path, motion)
    return path


def test_a_bag_is_tracked_and_written_as_a_result_with_a_report(run, refused, bag, tmp_path):
    now, look = tmp_path / 'now.yaml', tmp_path / 'look'
    status, out, err = run('track', bag, '--output', now, '--report', look, '--figures')
    assert (status, err) == (0, '')
    assert 'payload on link 2, at 15.' in out
    assert 'level OK' in out
    result = read_result(now)
    assert (np.abs(result.theta.vector('coulomb') / truth(DAY, [25.0])[0] - 1) < 0.01)[:5].all()
    assert result.level.name == 'OK'
    tracked = yaml.safe_load(now.read_text())['tracked']
    assert tracked['events'][0]['kind'] == 'payload on link 2'
    assert len(tracked['t']) == len(tracked['values']['P1']) > 20
    assert {path.name for path in look.iterdir()} == {'report.html', 'result.yaml', 'track.png', 'track.svg'}
    assert f'OK at {max(tracked["t"]):.0f} s' in (look / 'report.html').read_text()
    # A later run starts from the result.
    status, out, _ = run('track', f'{bag}@17:', '--start', now, '--json')
    assert status == 0
    assert json.loads(out)['tracked']['events'] == []
    # A result of level ERROR, or an identification that failed, is refused.
    now.write_text(now.read_text().replace('level: OK', 'level: ERROR'))
    assert 'is of level ERROR' in refused('track', bag, '--start', now)
    assert 'no parameters were identified: 8 s of motion without a gap are needed' in refused('track', f'{bag}@0:3')
    assert 'so it cannot be written' in refused('track', bag, '--output', bag / 'metadata.yaml', '--force')


def test_the_summary_is_printed_even_if_the_disk_is_full(run, bag, tmp_path):
    with small_disk(0):
        status, out, err = run('track', f'{bag}@:12', '--output', tmp_path / 'now.yaml')
    assert status == 1
    assert 'no change' in out
    assert err.endswith('cannot be written (File too large); choose another folder\n')
    assert 'written to' not in out


def test_consecutive_recordings_are_tracked_as_one(run, motion, tmp_path):
    for name, part in (('a', motion[motion.t < 16]), ('b', motion[motion.t >= 16])):
        (tmp_path / f'{name}.csv').write_text(csv(part))
    status, out, err = run('track', tmp_path / 'a.csv', tmp_path / 'b.csv')
    assert (status, err) == (0, '')
    assert 'payload on link 2' in out
    assert 'a gap between samples, 1 times' in out


def test_without_parameters_at_the_end_an_earlier_file_is_named_as_not_written(run, motion, tmp_path):
    lost = np.cumsum(np.random.default_rng(1).normal(0.0, 0.2, motion.q.shape) * (motion.t[:, None] > 16.0), axis=0)
    (tmp_path / 'run.csv').write_text(csv(replace(motion, q=motion.q + lost)))
    now = tmp_path / 'now.yaml'
    now.write_text('of yesterday')
    status, out, err = run('track', tmp_path / 'run.csv', '--output', now, '--force')
    assert status == 3
    assert 'no parameters are tracked at the end: ' in out
    assert err == f'pendubot: {now} is not written: no parameters are tracked at the end\n'
    assert now.read_text() == 'of yesterday'
