# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import argparse

import numpy as np
import pytest

from pendubot_identification.cli import import_csv
from pendubot_identification.cli.main import main
from pendubot_identification.errors import BagError, CsvError
from pendubot_identification.recordings.bag_reader import BagReader, read_trajectory


def run(*arguments):
    parser = argparse.ArgumentParser()
    import_csv.add_parser(parser.add_subparsers())
    args = parser.parse_args(['import-csv', *map(str, arguments)])
    return args.run(args)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / 'run.csv'
    rows = [f'{0.01 * k:.2f},{k},{90 + k},{k / 2}' for k in range(101)]
    path.write_text('\n'.join(['time,a,b,u', *rows]))
    return path


COLUMNS = ('--columns', 't=time,q1=a,q2=b,tau1=u')


def test_a_file_becomes_a_bag(file, tmp_path, capsys):
    options = ('--degrees', '--zero', 'hanging', '--elbow', 'absolute')
    assert run(file, '--output', tmp_path / 'bag', *COLUMNS, *options) == 0
    assert '101 samples, 1.000 s, 100.0 Hz' in capsys.readouterr().out
    trajectory = read_trajectory(tmp_path / 'bag').trajectory
    np.testing.assert_allclose(trajectory.q[10], np.deg2rad([10 - 90, 90]))
    np.testing.assert_array_equal(trajectory.tau[10], [5, 0])
    assert trajectory.qd is None


def test_a_bag_is_replaced_only_by_force(file, tmp_path):
    run(file, '--output', tmp_path / 'bag', *COLUMNS)
    with pytest.raises(BagError, match=r'exists already.*--force'):
        run(file, '--output', tmp_path / 'bag', *COLUMNS)
    assert run(file, '--output', tmp_path / 'bag', *COLUMNS, '--force') == 0
    assert BagReader(tmp_path / 'bag').count == 101


def test_a_file_that_cannot_be_used_leaves_no_bag(file, tmp_path):
    with pytest.raises(CsvError, match=r"no column 't' for t; its columns are time, a, b, u"):
        run(file, '--output', tmp_path / 'bag')
    assert not (tmp_path / 'bag').exists()


def test_a_time_beyond_what_a_stamp_can_hold_leaves_no_bag(file, tmp_path):
    file.write_text(file.read_text() + '\n9.3e9,0,0,0\n')
    with pytest.raises(BagError, match='a stamp of ROS ends in 2038'):
        run(file, '--output', tmp_path / 'bag', *COLUMNS)
    assert not (tmp_path / 'bag').exists()


@pytest.mark.parametrize('columns', ['time', 't=', '=time', 't=a,t=b', ''])
def test_columns_that_are_not_understood_are_wrong_usage(file, tmp_path, columns, capsys):
    with pytest.raises(SystemExit) as ended:
        run(file, '--output', tmp_path / 'bag', '--columns', columns)
    assert ended.value.code == 2
    assert 't=NAME,q1=NAME' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('columns', 'sentence'),
    [
        ('q1=a,q2=a', "column 'a' stands for both q1 and q2; name one column for each quantity, such as q2=NAME"),
        ('q1=q2', "column 'q2' stands for both q1 and q2"),
        ('q3=a', "'q3' is no quantity of a motion; columns can be named for t, q1"),
    ],
)
def test_columns_that_cannot_be_meant_are_wrong_usage(file, tmp_path, columns, sentence, capsys):
    assert main(['import-csv', str(file), '--output', str(tmp_path / 'bag'), '--columns', columns]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / 'bag').exists()
