# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One recording in other conventions: following the messages gives the parameters of the original."""

import json
import shlex
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.simulation import HANGING
from test.identified import swing
from test.recordings.bags import csv
from test.simulated_rig import Rig, record
from test.virtual import trajectory

QUICK = ('--criterion', 'weak', '--model', 'viscous', '--optimizer', 'lsq', '--hold', 'zero', '--delay', '0', '--json')
COLUMNS = ('--columns', 't=time,q1=a,q2=b,tau1=u')


def from_hanging(q):
    return np.degrees(q - HANGING)


#: By name of the file: function that returns its text, and the options that the messages name.
VARIANTS = {
    'absolute elbow': (lambda motion: csv(motion, convert=partial(np.cumsum, axis=1)), ['--elbow absolute']),
    'flipped elbow': (lambda motion: csv(motion, convert=lambda q: q * [1, -1]), ['--negate q2']),
    'flipped torque': (lambda motion: csv(replace(motion, tau=-motion.tau)), ['--negate tau1,tau2']),
    'exchanged': (lambda motion: csv(motion, convert=np.fliplr), ['--swap positions']),
    'all at once': (
        lambda motion: csv(replace(motion, t=1e6 * motion.t, tau=1000 * motion.tau), ';', ',', convert=from_hanging),
        ['--decimal comma', '--time-unit us', '--degrees', '--torque-unit mNm', '--zero hanging'],
    ),
}


@pytest.fixture(scope='module')
def motion():
    return swing()[:900]


@pytest.fixture(scope='module')
def expected(motion):
    """Parameters identified from the motion in memory."""
    settings = Settings(('weak',), 'viscous', optimizer='lsq', hold='zero', delays=(0.0, 0.0))
    return identify([motion[:450]], [motion[450:]], settings).best.theta


@pytest.fixture
def identified(run):
    def identified(file, *options):
        status, out, err = run('identify', file, *QUICK, *options)
        assert status in (0, 3), err
        result = json.loads(out)
        return result, [entry['value'] for entry in result['parameters'].values()]

    return identified


@pytest.mark.parametrize('name', VARIANTS)
def test_following_the_messages_gives_the_same_parameters(motion, identified, expected, run, tmp_path, name):
    text_of, named = VARIANTS[name]
    file, following = tmp_path / f'{name}.csv', []
    file.write_text(text_of(motion))
    while left := [option for option in named if option not in following]:
        _, out, err = run('identify', file, '--check', *shlex.split(' '.join(following)))
        message = ' '.join((out + err).split())
        following += (advised := [option for option in left if option in message])
        assert advised, message
    found, theta = identified(file, '--apply-remedies')
    np.testing.assert_allclose(theta, expected, rtol=1e-6)
    assert sorted(found['made_by']['applied']) == sorted(named)
    assert len({*found['warnings']}) == len(found['warnings'])
    assert any('applied corrections of the recordings' in warning for warning in found['warnings'])


@pytest.fixture
def lab(motion, tmp_path, monkeypatch):
    """The working directory, with a file in the conventions of a lab."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'run.csv').write_text(csv(motion, names=('time', 'a', 'b', 'u'), convert=from_hanging))


def test_a_result_serves_as_settings_file_for_its_recordings(lab, run, identified, expected):
    assert run('identify', 'run.csv', *COLUMNS, '--apply-remedies', '--output', 'lab.yaml', *QUICK)[0] == 0
    same = ('--settings', 'lab.yaml')
    found, theta = identified('run.csv', *same)
    np.testing.assert_allclose(theta, expected, rtol=1e-6)
    assert found['reading']['zero'] == 'hanging'
    assert run('report', 'lab.yaml')[2] == '', 'the report must be complete'
    assert run('compare', 'lab.yaml', 'lab_report/result.yaml', '--on', 'run.csv', *same)[0] == 0
    assert run('import', 'run.csv', '--output', 'bag', *same)[0] == 0
    # Options also apply to bags, and are added to saved settings.
    _, of_bag = identified('bag', '--negate', 'q2')
    _, of_table = identified('run.csv', *same, '--negate=q2')
    np.testing.assert_allclose(of_bag, of_table, rtol=1e-6)


def test_an_empty_option_in_a_settings_file_has_its_default(lab, run, tmp_path):
    (tmp_path / 'empty.yaml').write_text('degrees: true\nsheet:\noffset:\n')
    found = json.loads(run('info', 'run.csv', *COLUMNS, '--settings', 'empty.yaml', '--json')[1])
    assert found['read_with'] == ['--columns t=time,q1=a,q2=b,tau1=u', '--degrees']


def test_info_shows_columns_rate_and_conversion_of_a_file(lab, run):
    found = json.loads(run('info', 'run.csv', *COLUMNS, '--json')[1])
    assert found['columns'] == {'t': 'time', 'q1': 'a', 'q2': 'b', 'tau1': 'u'}
    assert (found['samples'], round(found['rate'], 1), found['gaps']) == (900, 100.0, 0)
    text = run('info', 'run.csv', *COLUMNS, '--degrees')[1]
    assert text.startswith('run.csv: 900 samples, 8.990 s, 100.0 Hz\n')
    assert 'read      --columns t=time,q1=a,q2=b,tau1=u --degrees\n' in text


def test_a_wrong_zero_that_stops_the_filter_is_named_and_a_rest_is_located(run, tmp_path):
    (recorded,) = record([11], [Rig()], seconds=6.0, step=0.0025)
    motion = trajectory(recorded)
    resting = np.where(motion.t[:, None] < 3, HANGING, motion.q)
    for name, q in (('hanging.csv', motion.q - HANGING), ('resting.csv', resting)):
        (tmp_path / name).write_text(csv(replace(motion, q=q)))
    command = ('identify', '--model', 'coulomb', '--hold', 'zero', '--delay', '0')
    status, _, err = run(*command, tmp_path / 'hanging.csv')
    assert (status, 'add --zero hanging' in err) == (1, True)
    assert run(*command, tmp_path / 'hanging.csv', '--apply-remedies')[0] == 0
    assert 'resting.csv, 0 to 2.995 s: the joints moved by only' in run(*command, tmp_path / 'resting.csv')[2]


def test_the_check_names_the_one_recording_that_differs(motion, run, tmp_path):
    for k in range(3):
        part = motion[300 * k : 300 * (k + 1)]
        (tmp_path / f'take {k}.csv').write_text(csv(part, convert=lambda q, k=k: q * [1, -1 if k == 1 else 1]))
    _, out, _ = run('identify', *(tmp_path / f'take {k}.csv' for k in range(3)), '--check')
    message = ' '.join(out.split())
    assert 'take 1.csv contradicts the other recordings' in message
    assert "in it, the elbow's position has the wrong sign" in message
