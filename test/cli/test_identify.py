# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""pendubot identify from outside: results, files, and one sentence for each thing that a user can do wrong."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from pendubot_identification.cli import identify as command
from pendubot_identification.cli.main import main
from pendubot_identification.identify.settings import CRITERIA, HOLDS, OPTIMIZERS
from pendubot_identification.model.parameters import MODELS, NAMES, PAPER
from pendubot_identification.recordings.csv_import import import_csv
from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.results.result_file import read_parameters
from pendubot_identification.trajectories.trajectory import Trajectory
from test.conftest import RECORDINGS, ROOT
from test.processes import run_program
from test.virtual import recording

SAMPLE = ROOT / 'bags' / 'paper_experiment'
PAPERS = ('--criterion', 'energy', '--model', 'viscous', '--optimizer', 'mde')
FAST = (*PAPERS[:4], '--optimizer', 'lsq')
SEVEN = NAMES[:7]


@pytest.fixture(scope='session')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('bags') / 'swing'
    assert main(['simulate', '--output', str(path)]) == 0
    return path


def identify(capsys, *arguments):
    status = main(['identify', *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def said(out):
    """Return what was printed, without its lines."""
    return ' '.join(out.split())


def refused(capsys, *arguments, status=1):
    """Assert this exit status with one line, no traceback and nothing printed; return the sentence."""
    ended, out, err = identify(capsys, *arguments)
    assert ended == status
    assert out == ''
    line = err.strip().splitlines()[-1]
    assert line.startswith('pendubot: ')
    assert 'Traceback' not in err
    return line


def one(capsys, *arguments):
    """Return the result of one criterion and the paper's model, quickly."""
    status, out, _ = identify(capsys, *arguments, '--model', 'viscous', '--json')
    assert status == 0
    return json.loads(out)


def test_the_papers_way(capsys, tmp_path):
    """1800 samples at 100 Hz; every one of ten runs of MDE reaches the exact minimum, which stays where it was."""
    output = tmp_path / 'result.yaml'
    status, out, _ = identify(capsys, SAMPLE, *PAPERS, '--output', output)
    assert status == 0
    result = yaml.safe_load(output.read_text())
    assert (result['criterion'], result['model'], list(result['criteria'])) == ('energy', 'viscous', ['energy'])
    assert [b['samples'] for b in result['bags']] == [900, 900]
    how = {'runs': 10, 'population': 30, 'generations': 4000, 'per_component': True, 'spread': 1e-9}
    assert result['criteria']['energy']['mde'] == how
    assert result['J']['runs_at_least_squares'] == 10
    assert max(result['J']['training_runs']) <= result['J']['least_squares'] * (1 + 1e-6)
    assert len(result['J']['validation_runs']) == 10
    for name in SEVEN:
        assert name in out
        assert result['parameters'][name]['unit']
    assert read_parameters(output).unphysical() == ()
    np.testing.assert_allclose(result['parameters']['P1']['value'], PAPER.P1, rtol=0.2)
    np.testing.assert_allclose(result['parameters']['P4']['value'], PAPER.P4, rtol=0.1)
    assert sum(f.stat().st_size for f in SAMPLE.iterdir()) < 2e6


def test_by_default_all_criteria_the_model_chosen_and_the_best_published(capsys, tmp_path):
    output = tmp_path / 'result.yaml'
    status, out, err = identify(capsys, SAMPLE, '--output', output)
    assert (status, err) == (0, ''), 'no progress where nobody watches'
    result = yaml.safe_load(output.read_text())
    assert list(result['criteria']) == list(CRITERIA)
    assert [(score['model'], score['exact']) for score in result['models']['compared']] == [('viscous', True)]
    assert result['model'] == 'viscous', 'the virtual rig has no other friction'
    errors = {name: np.array(e['prediction']['error']) for name, e in result['criteria'].items()}
    assert (errors[result['criterion']] < errors['energy']).all()
    assert result['level'] == 'OK'
    theta = [result['parameters'][name]['value'] for name in SEVEN]
    np.testing.assert_allclose(theta, PAPER.vector(), rtol=0.02)
    for name in ('energy', 'weak'):
        assert result['criteria'][name]['J']['runs_at_least_squares'] == 10
    assert 'viscous was chosen' in out
    assert out.rstrip().endswith(f'written to {output}')


def test_json_is_the_result_and_nothing_else(capsys, bag):
    status, out, _ = identify(capsys, bag, '--json', *FAST)
    assert status == 0
    result = json.loads(out)
    assert result['schema'] == 1
    assert list(result['parameters']) == list(SEVEN)
    assert len(result['covariance']) == 7
    assert result['made_by']['optimizer'] == 'lsq'
    assert all(len(b['sha256']) == 64 for b in result['bags'])


@pytest.mark.parametrize(
    ('arguments', 'roles'),
    [
        (['{}'], {'training': [900], 'validation': [900]}),
        (['{}@0:9'], {'training': [900], 'validation': [900]}),
        (['{}@5:9'], {'training': [400], 'validation': [500, 900]}),
        (['{}@:9', '--validate', '{}@12:'], {'training': [900], 'validation': [600]}),
        (['{}@0:6', '{}@12:'], {'training': [600, 600], 'validation': [600]}),
        (['{}', '{}'], {'training': [1800, 1800], 'validation': []}),
        (['{}@0:'], {'training': [1800], 'validation': []}),
        (['{}@0.9:9'], {'training': [810], 'validation': [900]}),
    ],
)
def test_windows_divide_a_bag_as_documented(capsys, bag, arguments, roles):
    status, out, _ = identify(capsys, *(a.format(bag) for a in arguments), '--json', *FAST)
    assert status == 0
    bags = json.loads(out)['bags']
    for role, samples in roles.items():
        assert [b['samples'] for b in bags if b['role'] == role] == samples


def test_a_remainder_too_short_to_judge_by_costs_no_result(capsys, tmp_path):
    """0.2 s at 500 Hz: samples enough, but shorter than a bump of the weak criterion."""
    fast = tmp_path / 'fast'
    assert main(['simulate', '--output', str(fast), '--rate', '500', '--samples', '3000']) == 0
    capsys.readouterr()
    options = ('--criterion', 'weak', '--optimizer', 'lsq', '--hold', 'zero', '--delay', '0')
    result = one(capsys, f'{fast}@0.2:4', *options)
    assert [b['bag'] for b in result['bags']] == [f'{fast}@0.2:4', f'{fast}@4:']
    alone = one(capsys, f'{fast}@0.2:5.8', *options)
    assert [b['role'] for b in alone['bags']] == ['training']


def test_same_seed_same_result(capsys, bag):
    options = (bag, '--json', *PAPERS, '--generations', '40', '--runs', '3')
    first, again, other = (identify(capsys, *options, '--seed', s)[1] for s in (4, 4, 5))
    assert first == again
    assert first != other


def test_a_bag_that_was_killed_is_used_and_named(capsys, bag, tmp_path):
    cut = tmp_path / 'killed'
    cut.mkdir()
    (file,) = bag.glob('*.mcap')
    (cut / 'killed_0.mcap').write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    status, out, _ = identify(capsys, cut, *FAST)
    assert status == 0
    assert 'never closed' in said(out)


def test_works_where_ros_cannot_be_imported(bag, tmp_path):
    """rclpy and the messages are made impossible to import; so are the wheels' hooks, which -S leaves out."""
    blocker = tmp_path / 'without_ros.py'
    blocker.write_text(
        'import sys\n'
        'class Blocker:\n'
        '    def find_spec(self, name, path=None, target=None):\n'
        "        if name.split('.')[0] in ('rclpy', 'rosidl_pycommon') or name.split('.')[0].endswith('_msgs'):\n"
        "            raise ModuleNotFoundError(f'no module named {name!r}: there is no ROS here')\n"
        'sys.meta_path.insert(0, Blocker())\n'
        'from pendubot_identification.cli.main import main\n'
        'raise SystemExit(main(sys.argv[1:]))\n'
    )
    env = {k: v for k, v in os.environ.items() if not k.startswith(('ROS', 'AMENT', '_ROS'))}
    env['PYTHONPATH'] = os.pathsep.join([str(ROOT), *(p for p in sys.path if p.endswith('site-packages'))])

    def without_ros(*arguments):
        command = [sys.executable, '-S', str(blocker), *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, env=env, timeout=120)

    result = without_ros('identify', bag, *PAPERS, '--output', tmp_path / 'result.yaml')
    assert result.returncode == 0, result.stderr
    assert '10 of 10 runs' in result.stdout
    demo = without_ros('demo')
    assert demo.returncode == 1
    assert 'the demo needs ROS 2' in demo.stderr
    assert 'Traceback' not in demo.stderr


@pytest.mark.recordings
@pytest.mark.parametrize('rig', ['dfki_C1_sysid', 'dfki_A0_sysid'])
def test_the_real_recordings_of_each_rig_pooled(capsys, tmp_path, rig):
    roles = {}
    for row in (RECORDINGS / 'manifest.csv').read_text().splitlines()[1:]:
        name, group, role, *_ = row.split(',')
        if group == rig:
            path = tmp_path / Path(name).stem
            write_trajectory(path, import_csv(RECORDINGS / name))
            roles.setdefault(role, []).append(path)
    output = tmp_path / 'result.yaml'
    bags = (*roles['train'], '--validate', *roles['test'])
    status, _, _ = identify(capsys, *bags, '--output', output, *PAPERS)
    assert status == 0
    result = yaml.safe_load(output.read_text())
    assert result['J']['runs_at_least_squares'] == 10
    assert result['J']['validation'] > 0
    assert result['level'] in ('WARN', 'ERROR'), 'this criterion does not predict this rig, and says so'
    assert result['warnings']


def test_hold_and_delay_are_as_asked_for(capsys, bag):
    asked = one(capsys, bag, '--criterion', 'weak', '--hold', 'linear', '--delay', '0.004')['effort']
    assert (asked['hold'], asked['delay'], asked['linear_lag']) == ('linear', 0.004, 0.004)
    found = one(capsys, bag, '--criterion', 'weak', '--hold', 'zero', '--delay=-0.02:0.02')
    assert abs(found['effort']['delay']) < 0.002
    assert found['made_by']['delays'] == [-0.02, 0.02]


def test_no_delay_at_all_is_no_end_of_a_search(capsys):
    """The torque of the sample bag acts at once, where a search from 0 on ends; one from 2 ms on ends elsewhere."""
    for searched, warned in (('0:0.02', False), ('0.002:0.02', True)):
        result = one(capsys, SAMPLE, '--criterion', 'weak', '--optimizer', 'lsq', '--hold', 'zero', '--delay', searched)
        assert result['effort']['delay'] == pytest.approx(float(searched.split(':')[0]), abs=1e-4)
        assert any('the end of where it was searched' in w for w in result['warnings']) == warned


def test_a_link_of_another_length_is_named(capsys, bag):
    """Of the virtual rig it is P3 / P5, 30 mm."""
    for length, warned in (('0.0304', False), ('0.3', True)):
        result = one(
            capsys, bag, '--criterion', 'weak', '--optimizer', 'lsq', '--hold', 'zero', '--link-length', length
        )
        assert any('as on a link 1 of 0.03' in warning for warning in result['warnings']) == warned
        assert result['link_length']['expected'] == float(length)


def test_trajectory_starts_where_it_is_told(capsys, bag, tmp_path):
    output = tmp_path / 'result.yaml'
    assert identify(capsys, bag, *FAST, '--output', output)[0] == 0
    result = one(capsys, f'{bag}@0:4', '--criterion', 'trajectory', '--hold', 'zero', '--start', output)
    assert result['criteria']['trajectory']['steps'][0] == 'start: given parameters'
    assert result['made_by']['start'][:7] == list(read_parameters(output).vector())
    np.testing.assert_allclose([e['value'] for e in result['parameters'].values()], PAPER.vector(), rtol=0.05)


def test_trajectory_by_mde_takes_what_suits_it_unless_told(capsys, bag):
    options = (f'{bag}@0:4', '--criterion', 'trajectory', '--hold', 'zero', '--optimizer', 'mde')
    result = one(capsys, *options)
    how = {'runs': 1, 'population': 40, 'generations': 120, 'per_component': False, 'spread': 1e-6}
    assert result['criteria']['trajectory']['mde'] == how
    np.testing.assert_allclose([e['value'] for e in result['parameters'].values()], PAPER.vector(), rtol=0.05)
    told = one(capsys, *options, '--generations', '3', '--population', '10', '--runs', '2')
    assert told['criteria']['trajectory']['mde'] == how | {'runs': 2, 'population': 10, 'generations': 3}


def test_several_bags_are_predicted_from_each_other(capsys, bag, tmp_path):
    """Without bags to validate, each of several is left out in turn; the estimates use all of them."""
    others = [tmp_path / name for name in 'ab']
    for seed, other in enumerate(others, start=2):
        assert main(['simulate', '--output', str(other), '--seed', str(seed), '--samples', '600']) == 0
    capsys.readouterr()
    result = one(capsys, *others, bag, '--criterion', 'weak,energy', '--hold', 'zero')
    assert list(result['criteria']) == ['weak', 'energy']
    assert [b['role'] for b in result['bags']] == ['training'] * 3
    assert result['prediction']['method'] == 'each recording predicted from the others'
    assert result['J']['validation'] is None
    assert all(error > 0 for entry in result['criteria'].values() for error in entry['prediction']['error'])


def broken(bag, tmp_path, **changes):
    """Return a bag like the given one but for some arrays."""
    from pendubot_identification.recordings.bag_reader import read_trajectory

    t = read_trajectory(bag).trajectory
    values = {'t': t.t, 'q': t.q, 'tau': t.tau} | changes
    path = tmp_path / 'broken'
    write_trajectory(path, Trajectory(**values))
    return path


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        (['/nowhere'], 'there is no bag /nowhere'),
        (['{root}/README.md'], 'is no MCAP file'),
        (['{root}/docs'], 'is no bag that can be read here'),
        (['{bag}', '--topic', '/imu'], 'holds nothing on /imu; its topics are /joint_states'),
        (['{bag}', '--joints', 'a,b'], "has no joint 'a'; its joints are shoulder, elbow"),
        (['b' * 300], 'there is no bag bbb'),
        (['{bag}@50:60'], 'holds no sample'),
        (['{bag}@1e300:'], '@1e+300:: the window holds no sample'),
        (['{bag}@1:1.1'], '10 samples over 0.090 s are too few'),
        (['{bag}', '--sliding', '100'], 'shorter than the sliding window'),
        (['{bag}', '--output', '{root}/README.md'], 'exists already'),
        (['{bag}', '--start', '/nowhere.yaml'], '/nowhere.yaml cannot be read'),
        (['{bag}', '--start', '{root}/package.xml'], 'is no YAML file'),
        # Before anything is read.
        (['/nowhere', '--output', '/nowhere/result.yaml'], '/nowhere/result.yaml cannot be written (No such file'),
        (['/nowhere', '--output', '/proc/result.yaml'], '/proc/result.yaml cannot be written'),
        (['/nowhere', '--output', '{root}/docs', '--force'], '/docs is a folder; name a file in it'),
    ],
)
def test_what_a_user_did_wrong_is_one_sentence(capsys, bag, arguments, sentence):
    assert sentence in refused(capsys, *(a.format(bag=bag, root=ROOT) for a in arguments))


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        (['{bag}', '--joints', 'elbow,elbow'], 'names 1 joints; two are expected'),
        (['{bag}', '--runs', '100000000'], 'at most 100000'),
        (['{bag}', '--joints', 'a'], 'names 1 joints; two are expected'),
        (['{bag}@9:2'], 'reversed'),
        (['{bag}@3:3'], 'empty or reversed'),
        (['{bag}@one:2'], 'must be numbers of seconds'),
        (['{bag}', '--bounds', 'P1=2:1'], 'bounds of P1 are inverted'),
        (['{bag}', '--bounds', 'P1=2'], 'NAME=LOW:HIGH is expected'),
        (['{bag}', '--bounds', 'P8=0:1'], "no parameter 'P8'"),
        (['{bag}', '--population', '4'], 'NP is 4; at least 5'),
        (['{bag}', '--generations', '0'], 'at least 1'),
        (['{bag}', '--runs', '0'], '0 runs'),
        (['{bag}', '--seed', '-1'], 'seed is -1'),
        (['{bag}', '--sliding', '-3'], 'sliding window is -3 s'),
        (['{bag}', '--smoothing', '-0.1'], 'smoothing window is -0.1 s'),
        (['{bag}', '--delay', '0.02:0.01'], 'searched from 0.02 to 0.01 s'),
        (['{bag}', '--bounds', 'Fc1=0:1', '--model', 'viscous'], 'that --model viscous does not have'),
        (['{bag}', '--runs', '3', '--optimizer', 'lsq'], '--runs is of MDE, and --optimizer lsq does without'),
        (['{bag}', '--population', '30', '--optimizer', 'lsq'], '--population is of MDE'),
        (['{bag}', '--per-vector', '--optimizer', 'lsq'], '--per-vector is of MDE'),
        (['{bag}', '--spread', '0', '--optimizer', 'lsq'], '--spread is of MDE'),
        (['{bag}', '--criterion', 'trajectory', '--runs', '5'], '--runs is of MDE, and --criterion trajectory does'),
        (['{bag}', '--criterion', 'trajectory', '--per-vector'], '--per-vector is of MDE, and --criterion trajectory'),
        (['{bag}', '--criterion', 'energy', '--delay', '0:0.02'], '--delay is of weak and trajectory, and --criterion'),
        (['{bag}', '--criterion', 'energy', '--start', 'x.yaml'], '--start is of trajectory, and --criterion energy'),
        (['{bag}', '--criterion', 'energy,weak', '--start', 'x.yaml'], 'and --criterion energy,weak does without'),
        (['{bag}', '--criterion', 'weak', '--sliding', '0.3'], '--sliding is of energy, and --criterion weak does'),
        (['{bag}', '--spread', '-1'], '--spread is -1; 0, which takes every generation, or a number above it'),
        (['{bag}', '--delay', '3'], 'two times within half a second are expected'),
        (['{bag}', '--link-length', '0'], 'length of link 1 is 0 m'),
    ],
)
def test_what_can_be_told_from_the_command_line_alone_is_wrong_usage(capsys, bag, arguments, sentence):
    assert sentence in refused(capsys, *(a.format(bag=bag) for a in arguments), status=2)


def test_what_is_read_is_never_written_over(capsys, bag, tmp_path):
    (file,), start = bag.glob('*.mcap'), tmp_path / 'result.yaml'
    start.write_text('mine')
    before = file.read_bytes()
    for options in (
        ('--output', file),
        ('--output', bag / 'metadata.yaml'),
        ('--output', start, '--start', start),
        ('--report', tmp_path, '--reference', start),
    ):
        assert 'is read, so it cannot be written as well' in refused(capsys, bag, *options, '--force')
    assert (file.read_bytes(), start.read_text()) == (before, 'mine')
    assert not list(tmp_path.glob('*.html'))


@pytest.mark.parametrize('options', [(), ('--json',)])
def test_a_result_that_cannot_be_written_in_the_end_is_printed_all_the_same(bag, tmp_path, options):
    output = tmp_path / 'result.yaml'
    ended = run_program('pendubot', 'identify', bag, *FAST, '--output', output, *options, file_limit=0)
    assert ended.returncode == 1
    assert ended.stderr == f'pendubot: {output} cannot be written (File too large); choose a folder that can be\n'
    if options:
        assert list(json.loads(ended.stdout)['parameters']) == list(SEVEN)
    else:
        assert 'kg m^2' in ended.stdout
        assert 'written to' not in ended.stdout
    assert not list(tmp_path.iterdir())


def test_a_result_may_stand_in_the_folder_of_its_report(capsys, bag, tmp_path):
    output = tmp_path / 'look' / 'mine.yaml'
    assert identify(capsys, bag, *FAST, '--report', output.parent, '--output', output)[0] == 0
    assert output.read_text() == output.with_name('result.yaml').read_text()


def test_a_motion_without_excitation_names_what_cannot_be_told(capsys, bag, tmp_path):
    still = np.tile([-np.pi / 2, 0.0], (1800, 1))
    assert 'none of P1, P2' in refused(capsys, broken(bag, tmp_path, q=still))


def test_a_torque_that_does_no_work_is_refused(capsys, bag, tmp_path):
    assert 'the torque does no work' in refused(capsys, broken(bag, tmp_path, tau=np.zeros((1800, 2))))


@pytest.mark.parametrize('options', [PAPERS, FAST])
def test_a_torque_of_the_wrong_sign_is_an_error(capsys, bag, tmp_path, options):
    from pendubot_identification.recordings.bag_reader import read_trajectory

    wrong = broken(bag, tmp_path, tau=-read_trajectory(bag).trajectory.tau)
    status, out, _ = identify(capsys, wrong, '--json', *options)
    result = json.loads(out)
    assert (status, result['level']) == (3, 'ERROR')
    assert result['warnings'][0].startswith('the effort has the wrong sign')
    assert 'not physical: P1 = 0 is not positive' in result['consequences']
    assert any('energy and work do not balance' in said for said in result['consequences'])


def test_a_level_of_ok_names_the_parameters_that_it_does_not_cover(capsys, tmp_path):
    """Dry friction and no other: b1 and b2 end on their bounds, and nothing else is wrong."""
    write_trajectory(tmp_path / 'dry', recording(rig=replace(PAPER, b1=0.0, b2=0.0, Fc1=0.02, Fc2=0.0005), seed=3))
    options = ('--criterion', 'weak', '--model', 'coulomb', '--optimizer', 'lsq', '--hold', 'zero')
    output, look = tmp_path / 'result.yaml', tmp_path / 'look'
    status, out, _ = identify(capsys, tmp_path / 'dry', *options, '--output', output, '--report', look)
    assert status == 0
    result = yaml.safe_load(output.read_text())
    assert result['level'] == 'OK'
    assert result['not_covered'] == {'b1': 'on its bound', 'b2': 'on its bound'}
    sentence = 'OK: use these parameters, but do not rely on b1 (on its bound), b2 (on its bound)'
    assert sentence in said(out)
    page = (look / 'report.html').read_text()
    assert sentence in page
    assert 'nothing speaks against' not in out + page


@pytest.mark.parametrize(
    ('turned', 'options', 'status'),
    [
        (1, (), 0),
        (1, ('--fail-on', 'warn'), 0),
        (-1, (), 3),
        (-1, ('--fail-on', 'warn'), 3),
        (-1, ('--fail-on', 'never'), 0),
    ],
)
def test_a_result_of_level_error_has_an_exit_status_of_its_own_and_is_written(
    capsys, bag, tmp_path, turned, options, status
):
    from pendubot_identification.recordings.bag_reader import read_trajectory

    path, output = broken(bag, tmp_path, tau=turned * read_trajectory(bag).trajectory.tau), tmp_path / 'result.yaml'
    weak = ('--criterion', 'weak', '--model', 'viscous', '--optimizer', 'lsq', '--hold', 'zero')
    ended, out, err = identify(capsys, path, *weak, '--output', output, *options)
    assert (ended, err) == (status, '')
    assert out.rstrip().endswith(f'written to {output}')
    assert yaml.safe_load(output.read_text())['level'] == ('OK' if turned == 1 else 'ERROR')


def test_fail_on_warn_fails_where_there_are_warnings(capsys, bag):
    options = (bag, '--criterion', 'weak', '--model', 'viscous', '--optimizer', 'lsq', '--link-length', '0.3')
    assert [identify(capsys, *options, *more)[0] for more in ((), ('--fail-on', 'warn'))] == [0, 3]


def test_missing_samples_are_counted(capsys, bag, tmp_path):
    from pendubot_identification.recordings.bag_reader import read_trajectory

    t = read_trajectory(bag).trajectory
    kept = np.arange(1800) % 20 != 7
    status, out, _ = identify(capsys, broken(bag, tmp_path, t=t.t[kept], q=t.q[kept], tau=t.tau[kept]), *FAST)
    assert status == 0
    assert 'about 45 of 900 samples are missing' in said(out)


@pytest.mark.parametrize('arguments', [['{}', '{}'], ['{}@0:9', '{}@5:12'], ['{}', '--validate', '{}@3:9']])
def test_data_used_twice_are_named(capsys, bag, arguments):
    status, out, _ = identify(capsys, *(a.format(bag) for a in arguments), *FAST)
    assert status == 0
    assert 'share samples: they count twice' in said(out)


def test_a_gap_outside_the_window_does_no_harm(capsys, bag, tmp_path):
    t = np.arange(1800) * 0.01
    gap = broken(bag, tmp_path, t=t + np.where(t > 10, 5, 0))
    assert '5.010 s without a sample begin at 1.000 s' in refused(capsys, gap, *FAST)
    assert identify(capsys, f'{gap}@0:9', *FAST)[0] == 0


def test_a_value_far_too_large_is_said_in_few_digits(capsys, bag, tmp_path):
    from pendubot_identification.recordings.bag_reader import read_trajectory

    q = read_trajectory(bag).trajectory.q.copy()
    q[50, 0] = 1e300
    line = refused(capsys, broken(bag, tmp_path, q=q))
    assert 'e+301 rad/s' in line
    assert len(line) < 400


def test_not_a_number_in_the_samples(capsys, tmp_path, bag):
    from pendubot_identification.recordings.bag_writer import BagWriter
    from pendubot_identification.recordings.joint_states import encode_joint_state

    for label, values, stamps in (
        ('nan', [np.nan, 0.0], range(200)),
        ('backwards', [0.0, 0.0], [*range(100), 50, *range(101, 200)]),
        ('repeats', [0.0, 0.0], [*range(100), 99, *range(101, 200)]),
    ):
        path = tmp_path / label
        with BagWriter(path) as writer:
            channel = writer.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
            for k, stamp in enumerate(stamps):
                data = encode_joint_state(10**18 + stamp * 10**7, ['shoulder', 'elbow'], values, [], [0.0, 0.0])
                writer.write(channel, data, 10**18 + k * 10**7)
        expected = {'nan': 'not a finite number', 'backwards': 'runs backwards', 'repeats': 'repeats'}[label]
        assert expected in refused(capsys, path)


@pytest.mark.parametrize(
    ('failure', 'sentence'),
    [(OSError(28, 'No space left on device'), 'the system refused: '), (MemoryError('80 GB'), 'not enough memory')],
)
def test_what_the_system_refuses_is_one_sentence(capsys, monkeypatch, failure, sentence):
    def refuse(args):
        raise failure

    monkeypatch.setattr('pendubot_identification.cli.info.run', refuse)
    assert main(['info', 'bag']) == 1
    assert capsys.readouterr().err.startswith(f'pendubot: {sentence}')


def test_a_rate_that_no_recording_has_is_refused(capsys, tmp_path):
    for rate in ('1e-9', 'nan', 'inf'):
        assert main(['simulate', '--output', str(tmp_path / 'bag'), '--rate', rate]) == 2
        assert 'a rate from 1 to 100000 Hz' in capsys.readouterr().err


def test_wrong_usage_exits_2(capsys):
    for option in ('criterion', 'model', 'optimizer', 'hold', 'delay', 'runs'):
        with pytest.raises(SystemExit) as stopped:
            main(['identify', 'x', f'--{option}', 'magic'])
        assert stopped.value.code == 2
        assert "'magic'" in capsys.readouterr().err.splitlines()[-1]
    for arguments in ([], ['identify'], ['identify', 'x', '--criterion', 'energy,'], ['fly']):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 2
    capsys.readouterr()


def test_help_of_every_subcommand_is_worth_reading(capsys):
    for arguments in (['--help'], *([c, '--help'] for c in ('identify', 'import-csv', 'simulate', 'info', 'demo'))):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 0
        assert len(capsys.readouterr().out.splitlines()) > 8


def test_the_choices_are_those_of_the_core_and_help_does_not_wait_for_it():
    assert command.CRITERIA == CRITERIA
    assert command.OPTIMIZERS == OPTIMIZERS
    assert command.HOLDS == HOLDS
    assert set(command.MODELS) == {'auto', *MODELS}
    code = (
        'import sys\n'
        'from pendubot_identification.cli.main import main\n'
        'try: main(["identify", "--help"])\n'
        'except SystemExit: assert not {"numpy", "scipy", "yaml"} & set(sys.modules)'
    )
    result = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr


def test_what_cannot_be_encoded_costs_no_result(bag):
    command = [sys.executable, '-m', 'pendubot_identification.cli.main', 'identify', bag, *FAST]
    env = os.environ | {'PYTHONIOENCODING': 'ascii'}
    child = subprocess.run(command, capture_output=True, text=True, env=env, timeout=120)
    assert (child.returncode, child.stderr) == (0, '')
    assert all(re.search(rf'^{name} ', child.stdout, re.MULTILINE) for name in SEVEN)
    assert r'\xb1' in child.stdout, 'in the place of a sign that ASCII lacks'


def test_debug_shows_where(capsys):
    for arguments in (['--debug', 'identify', '/nowhere'], ['identify', '/nowhere', '--debug']):
        assert main(arguments) == 1
        assert 'Traceback' in capsys.readouterr().err


def test_simulate_is_reproducible_and_refuses_nonsense(capsys, bag, tmp_path):
    assert main(['simulate', '--output', str(tmp_path / 'swing')]) == 0
    (first,), (second,) = bag.glob('*.mcap'), (tmp_path / 'swing').glob('*.mcap')
    assert first.read_bytes() == second.read_bytes()
    for options in (
        ['--samples', '0'],
        ['--samples', '9' * 30],
        ['--rate', 'nan'],
        ['--width', '2'],
        ['--amplitude', '1', '-1'],
        ['--hold', '0'],
    ):
        assert main(['simulate', '--output', str(tmp_path / 'never'), *options]) == 2
    assert main(['simulate', '--output', str(bag)]) == 1
    assert not (tmp_path / 'never').exists()
    assert 'exists already' in capsys.readouterr().err
