# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""pendubot report and identify --report from outside: what lies in the folder, and what is said of bad input."""

import re
import shutil

import pytest
import yaml

from pendubot_identification.cli.main import main
from test.conftest import ROOT
from test.processes import run_program
from test.report.test_page import Page

SAMPLE = ROOT / 'bags' / 'paper_experiment'
FAST = ('--criterion', 'energy', '--model', 'viscous', '--optimizer', 'lsq')
FIGURES = {'recordings', 'simulation', 'residuals_energy', 'parameters', 'correlation', 'excitation'}


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """A folder with a copy of the sample bag, a result, and its report."""
    folder = tmp_path_factory.mktemp('made')
    shutil.copytree(SAMPLE, folder / 'swing')
    arguments = (folder / 'swing', '--output', folder / 'result.yaml', '--report', folder / 'look', *FAST)
    assert main(['identify', *map(str, arguments)]) == 0
    return folder


def run(capsys, *arguments):
    status = main([*map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def refused(capsys, *arguments, status=1):
    """Assert this exit status with one line, no traceback and nothing printed; return the sentence."""
    ended, out, err = run(capsys, *arguments)
    assert (ended, out) == (status, '')
    (line,) = err.strip().splitlines()
    assert line.startswith('pendubot: ')
    return line


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_a_folder_with_a_page_its_figures_and_the_result(made):
    files = {f'{figure}.{kind}' for figure in FIGURES for kind in ('svg', 'png')}
    assert names(made / 'look') == {'report.html', 'result.yaml', *files}
    assert (made / 'look' / 'result.yaml').read_bytes() == (made / 'result.yaml').read_bytes()
    page = Page((made / 'look' / 'report.html').read_text())
    assert len([link for link in page.links if link.startswith('data:image/svg+xml;base64,')]) == len(FIGURES)
    assert all(link.startswith('data:') for link in page.links)
    text = ' '.join(page.text)
    assert 'data that no parameter was estimated from' in text
    assert 'Not shown' not in text


def test_the_same_from_the_result_file_later(made, capsys):
    """The bags are read again and divided as they were: the same numbers, the same figures."""
    status, out, err = run(capsys, 'report', made / 'result.yaml')
    assert (status, err) == (0, '')
    later = made / 'result_report'
    assert out == f'written to {later / "report.html"}\n'
    for file in (made / 'look').iterdir():
        assert (later / file.name).read_bytes() == file.read_bytes(), file.name


def test_nothing_is_overwritten_unless_told_to(made, capsys):
    before = {file: file.read_bytes() for file in (made / 'look').iterdir()}
    assert 'look exists already and holds something' in refused(
        capsys, 'report', made / 'result.yaml', '--output', made / 'look'
    )
    assert 'holds something' in refused(capsys, 'identify', made / 'swing', '--report', made / 'look', *FAST)
    assert before == {file: file.read_bytes() for file in (made / 'look').iterdir()}


def test_an_identification_anew_stands_beside_the_earlier_one(made, tmp_path, capsys):
    shutil.copytree(made / 'look', tmp_path / 'look')
    arguments = (made / 'swing', '--report', tmp_path / 'look', '--force', *FAST)
    assert run(capsys, 'identify', *arguments)[0] == 0
    page = Page((tmp_path / 'look' / 'report.html').read_text())
    assert 'earlier result' in ' '.join(page.text)
    assert {a['data-of'] for a, _ in page.data if 'data-of' in a} == {'reference'}


def test_a_reference_stands_beside_the_result(made, tmp_path, capsys):
    by_hand = {'schema': 1, 'parameters': {f'P{k}': {'value': 0.1 * k} for k in range(1, 6)}}
    by_hand['parameters'] |= {'b1': {'value': 0.0}, 'b2': {'value': 0.7}}
    (tmp_path / 'hand.yaml').write_text(yaml.safe_dump(by_hand))
    arguments = ('report', made / 'result.yaml', '--reference', tmp_path / 'hand.yaml', '--output', tmp_path / 'out')
    assert run(capsys, *arguments)[0] == 0
    page = Page((tmp_path / 'out' / 'report.html').read_text())
    values = {a['data-entry']: float(a['value']) for a, _ in page.data if a.get('data-of')}
    assert values == {f'parameters.{name}.value': e['value'] for name, e in by_hand['parameters'].items()}
    assert 'earlier result' not in ' '.join(page.text)


def test_a_reference_may_write_numbers_without_a_point(made, tmp_path, capsys):
    """As YAML does not."""
    by_hand = ', '.join(f'{name}: {{value: 4e-4}}' for name in ('P1', 'P2', 'P4', 'P5', 'b1', 'b2'))
    (tmp_path / 'hand.yaml').write_text(f'schema: 1\nparameters: {{{by_hand}, P3: {{value: 1e-4}}}}\n')
    arguments = ('report', made / 'result.yaml', '--reference', tmp_path / 'hand.yaml', '--output', tmp_path / 'out')
    status, _, err = run(capsys, *arguments)
    assert (status, err) == (0, '')
    page = Page((tmp_path / 'out' / 'report.html').read_text())
    assert {float(a['value']) for a, _ in page.data if a.get('data-of')} == {4e-4, 1e-4}


def test_a_reference_that_no_rig_has_is_said_to_be_so(made, tmp_path, capsys):
    by_hand = yaml.safe_load((made / 'result.yaml').read_text())
    by_hand['parameters']['P1']['value'] = -0.0022
    (tmp_path / 'hand.yaml').write_text(yaml.safe_dump(by_hand))
    arguments = ('report', made / 'result.yaml', '--reference', tmp_path / 'hand.yaml', '--output', tmp_path / 'out')
    status, _, err = run(capsys, *arguments)
    assert status == 0
    assert f'{tmp_path / "hand.yaml"}: not physical: P1 = -0.0022 is not positive' in err


def test_a_reference_is_not_written_over(made, tmp_path, capsys):
    shutil.copy(made / 'result.yaml', tmp_path)
    arguments = ('report', made / 'result.yaml', '--reference', tmp_path / 'result.yaml', '--output', tmp_path)
    assert 'is read, so it cannot be written as well' in refused(capsys, *arguments, '--force')


def test_a_failed_identification_has_a_page_that_says_why(made, tmp_path, capsys):
    status, out, err = run(capsys, 'identify', f'{made / "swing"}@0:0.2', '--report', tmp_path / 'look', *FAST)
    assert status == 1
    sentence = err.strip().removeprefix('pendubot: ')
    assert 'samples over 0.190 s are too few' in sentence
    assert str(tmp_path / 'look' / 'report.html') in out
    page = Page((tmp_path / 'look' / 'report.html').read_text())
    text = ' '.join(page.text)
    assert sentence in text
    assert f'{made / "swing"}@0:0.2' in text


def test_where_the_data_could_be_read_the_page_of_a_failure_shows_them(made, tmp_path, capsys):
    assert main(['simulate', '--output', str(tmp_path / 'rest'), '--amplitude', '-0.000001', '0.000001']) == 0
    capsys.readouterr()
    status, _, err = run(capsys, 'identify', tmp_path / 'rest', '--report', tmp_path / 'look', *FAST)
    assert status == 1
    assert 'excite the rig' in err
    assert names(tmp_path / 'look') == {'report.html', 'recordings.svg', 'recordings.png'}


def files(folder):
    return {path: path.read_bytes() for path in folder.rglob('*') if path.is_file()}


@pytest.mark.parametrize('way', ['identify', 'report'])
def test_a_report_that_fails_leaves_no_folder_and_an_earlier_one_as_it_was(made, tmp_path, capsys, monkeypatch, way):
    """Whatever fails while it is drawn; the result, which is written apart, is there."""

    def fail(*_):
        raise RuntimeError('a figure that cannot be drawn')

    monkeypatch.setattr('pendubot_identification.report.figures.draw_parameters', fail)
    new, output = tmp_path / 'new' / 'look', tmp_path / 'result.yaml'
    shutil.copytree(made / 'look', tmp_path / 'look')
    before = files(tmp_path / 'look')
    if way == 'identify':
        command = ('identify', made / 'swing', *FAST, '--output', output, '--report')
    else:
        command = ('report', made / 'result.yaml', '--output')
    for folder, options in ((new, ()), (tmp_path / 'look', ('--force',))):
        status, _, err = run(capsys, *command, folder, *options)
        assert (status, err) == (
            1,
            'pendubot: RuntimeError: a figure that cannot be drawn; run again with --debug to see where\n',
        )
    assert not (tmp_path / 'new').exists()
    assert files(tmp_path / 'look') == before
    assert output.exists() == (way == 'identify')


def test_a_report_on_a_full_disk_leaves_no_folder_and_an_earlier_one_as_it_was(made, tmp_path):
    """Figures may still find room where the page does not."""
    shutil.copytree(made / 'look', tmp_path / 'look')
    before = files(tmp_path / 'look')
    limit = (made / 'look' / 'report.html').stat().st_size - 1
    for folder, options in ((tmp_path / 'new', ()), (tmp_path / 'look', ('--force',))):
        ended = run_program('pendubot', 'report', made / 'result.yaml', '--output', folder, *options, file_limit=limit)
        assert ended.returncode == 1
        assert (
            ended.stderr
            == f'pendubot: {folder}/report.html cannot be written (File too large); choose a folder that can be\n'
        )
    assert not (tmp_path / 'new').exists()
    assert files(tmp_path / 'look') == before


def test_what_fails_unforeseen_has_a_page_that_says_what(made, tmp_path, capsys, monkeypatch):
    def fail(*_):
        raise MemoryError('80 GB')

    monkeypatch.setattr('pendubot_identification.identify.identification.identify', fail)
    status, _, err = run(capsys, 'identify', made / 'swing', *FAST, '--report', tmp_path / 'look')
    assert (status, err) == (1, 'pendubot: not enough memory (80 GB); ask for less\n')
    text = ' '.join(Page((tmp_path / 'look' / 'report.html').read_text()).text)
    assert 'not enough memory (80 GB); ask for less' in text


@pytest.mark.parametrize('way', ['identify', 'report'])
@pytest.mark.parametrize('place', ['file/look', 'file', '/proc/look'])
def test_a_folder_that_cannot_be_written_is_refused_before_anything_is_computed(made, tmp_path, capsys, way, place):
    (tmp_path / 'file').write_text('in the way')
    option = '--report' if way == 'identify' else '--output'
    subject = '/nowhere' if way == 'identify' else made / 'result.yaml'
    sentence = refused(capsys, way, subject, option, tmp_path / place)
    assert re.search(r'\S+ cannot be written \(.+\); choose a folder that can be', sentence)


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        (None, 'cannot be read (No such file or directory); name a file that pendubot identify wrote'),
        ('schema: 2\nparameters: {}\n', 'is no result of schema 1'),
        ('[1, 2]', 'is no result of schema 1'),
        (': : :', 'is no YAML file'),
        (
            'schema: 1\nparameters: {P1: {value: 1}}\n',
            'has no parameter vector: look at P2, P3, P4, P5, b1, b2; a number each is expected',
        ),
    ],
)
def test_what_is_no_result_is_refused(tmp_path, capsys, text, sentence):
    if text is not None:
        (tmp_path / 'r.yaml').write_text(text)
    assert sentence in refused(capsys, 'report', tmp_path / 'r.yaml')
    assert names(tmp_path) <= {'r.yaml'}


def test_a_reference_that_is_none_is_refused(made, tmp_path, capsys):
    (tmp_path / 'r.yaml').write_text('schema: 7\n')
    assert 'no result of schema 1' in refused(
        capsys, 'report', made / 'result.yaml', '--reference', tmp_path / 'r.yaml', '--output', tmp_path / 'out'
    )
    assert 'add --report DIR' in refused(
        capsys, 'identify', made / 'swing', '--reference', made / 'result.yaml', status=2
    )
    assert not (tmp_path / 'out').exists()


def test_bags_that_were_moved_are_named_and_found_again(made, tmp_path, capsys):
    """Without them the page shows what the file holds, and says what is missing and why."""
    result = yaml.safe_load((made / 'result.yaml').read_text())
    for bag in result['bags']:
        bag['bag'] = '/gone/swing'
    (tmp_path / 'moved.yaml').write_text(yaml.safe_dump(result))
    status, _, err = run(capsys, 'report', tmp_path / 'moved.yaml')
    assert status == 0
    assert 'there is no bag /gone/swing, of which this result was made' in err
    folder = tmp_path / 'moved_report'
    assert names(folder) >= {'report.html', 'parameters.svg', 'correlation.svg'}
    assert not names(folder) & {'recordings.svg', 'simulation.svg', 'excitation.svg'}
    assert 'there is no bag /gone/swing' in (folder / 'report.html').read_text()
    found = ('report', tmp_path / 'moved.yaml', '--bags', made, '--output', tmp_path / 'found')
    assert run(capsys, *found)[::2] == (0, '')
    assert (tmp_path / 'found' / 'simulation.svg').read_bytes() == (made / 'look' / 'simulation.svg').read_bytes()


def test_a_bag_that_is_another_one_by_now_is_not_drawn(made, tmp_path, capsys):
    assert main(['simulate', '--output', str(tmp_path / 'swing'), '--seed', '2']) == 0
    capsys.readouterr()
    status, _, err = run(capsys, 'report', made / 'result.yaml', '--bags', tmp_path, '--output', tmp_path / 'out')
    assert status == 0
    assert 'is not the bag of which this result was made' in err
    assert not (tmp_path / 'out' / 'recordings.svg').exists()


def test_a_window_without_validation_data_is_shown_for_what_it_is(made, tmp_path, capsys):
    arguments = (f'{made / "swing"}@0:', '--report', tmp_path / 'look', *FAST)
    assert run(capsys, 'identify', *arguments)[0] == 0
    text = ' '.join(Page((tmp_path / 'look' / 'report.html').read_text()).text)
    assert 'There are no validation data' in text
    assert 'parts of it that were left out in turn' in text


def test_help_says_what_there_is_to_see(capsys):
    with pytest.raises(SystemExit):
        main(['report', '--help'])
    assert 'what a good one looks like' in ' '.join(capsys.readouterr().out.split())
