# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The subcommand report, and identify --report: contents of the folder, and failures."""

import re
import shutil

import pytest
import yaml

from pendubot_identification.cli.main import main
from test.cli.conftest import FAST, PAPERS, contents
from test.report.test_page import Page

PLOTS = {'recordings', 'simulation', 'torque_left', 'residuals_energy'}
FIGURES = {'torque_means', 'whiteness_energy'}


def text(folder):
    return ' '.join(' '.join(Page((folder / 'report.html').read_text()).text).split())


def plots(folder):
    return set(re.findall(r'data-plot="(\w+)"', (folder / 'report.html').read_text()))


@pytest.fixture(scope='module')
def look(inputs, tmp_path_factory):
    """The report of the command that makes the result."""
    folder = tmp_path_factory.mktemp('reported') / 'look'
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.chdir(inputs)
        assert main(['identify', 'swing', *PAPERS, '--report', str(folder)]) == 0
    return folder


def test_the_folder_has_a_self_contained_page_and_the_result(inputs, look):
    assert set(contents(look)) == {'report.html', 'result.yaml'}
    assert plots(look) == PLOTS
    assert (look / 'result.yaml').read_bytes() == (inputs / 'result.yaml').read_bytes()
    assert str(inputs) not in (look / 'report.html').read_text()
    assert 'data that were not used to estimate them' in text(look)
    assert 'Not shown' not in text(look)


@pytest.mark.usefixtures('in_inputs')
def test_the_same_report_is_made_later_from_the_result_file(look, tmp_path, run):
    """--figures writes every picture."""
    shutil.copy('result.yaml', tmp_path)
    status, out, err = run('report', tmp_path / 'result.yaml', '--figures')
    later = tmp_path / 'result_report'
    assert (status, out, err) == (0, f'written to {later / "report.html"}\n', '')
    for file in look.iterdir():
        assert (later / file.name).read_bytes() == file.read_bytes(), file.name
    files = {f'{name}.{ending}' for name in PLOTS | FIGURES for ending in ('svg', 'png')}
    assert set(contents(later)) == {'report.html', 'result.yaml', *files}


def test_reference_parameters_written_by_hand_are_shown_beside_the_result(inputs, tmp_path, run):
    """An unphysical value is reported and shown; the bag is not found, so nothing is drawn."""
    shutil.copy(inputs / 'result.yaml', tmp_path)
    by_hand = ', '.join(f'{name}: {{value: 4e-4}}' for name in ('P2', 'P3', 'P4', 'P5', 'b1', 'b2'))
    hand, out = tmp_path / 'hand.yaml', tmp_path / 'out'
    hand.write_text(f'schema: 1\nparameters: {{{by_hand}, P1: {{value: -0.0022}}}}\n')
    status, _, err = run('report', tmp_path / 'result.yaml', '--reference', hand, '--output', out)
    assert status == 0
    assert f'{hand}: not physical: P1 = -0.0022 is not positive' in err
    rows = Page((out / 'report.html').read_text()).rows
    assert any(row.startswith('P1 ') and '−0.0022' in row for row in rows)


def test_a_failed_report_leaves_no_folder_and_an_earlier_one_unchanged(inputs, look, tmp_path, run, monkeypatch):
    """The result file is written nevertheless."""

    def fail(*_):
        raise RuntimeError('a figure that cannot be drawn')

    monkeypatch.setattr('pendubot_identification.report.plots.Prepared.data', fail)
    shutil.copytree(look, tmp_path / 'look')
    before = contents(tmp_path / 'look')
    command = ('identify', inputs / 'swing', *FAST, '--output', tmp_path / 'result.yaml', '--force', '--report')
    for folder in ('look', 'new/look'):
        status, _, err = run(*command, tmp_path / folder)
        message = 'pendubot: RuntimeError: a figure that cannot be drawn; run again with --debug to see where\n'
        assert (status, err) == (1, message)
    assert {path.name for path in tmp_path.iterdir()} == {'look', 'result.yaml'}
    assert contents(tmp_path / 'look') == before


def test_moved_or_changed_bags_are_reported_and_found_with_the_option_bags(inputs, tmp_path, run):
    """Without them the page shows the values of the file, and the reason for missing figures."""
    result = yaml.safe_load((inputs / 'result.yaml').read_text())
    for bag in result['bags']:
        bag['bag'] = '/gone/swing'
    (tmp_path / 'moved.yaml').write_text(yaml.safe_dump(result))
    assert run('simulate', '--output', tmp_path / 'swing', '--seed', '2')[0] == 0
    for options, sentence in (
        ((), 'there is no bag /gone/swing, from which this result was made'),
        (('--bags', tmp_path, '--force'), 'is not the bag from which this result was made'),
    ):
        status, _, err = run('report', tmp_path / 'moved.yaml', *options)
        look = tmp_path / 'moved_report'
        assert status == 0
        assert sentence in err
        assert sentence.replace('/gone/', '') in text(look)
        assert plots(look) == set()
    found = ('report', tmp_path / 'moved.yaml', '--bags', inputs, '--output', tmp_path / 'found')
    assert run(*found)[::2] == (0, '')
    assert plots(tmp_path / 'found') == PLOTS
