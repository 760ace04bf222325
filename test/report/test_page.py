# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The page of a result: its numbers, downloads, command, and independence of other files."""

import html
import re
import shlex
from html.parser import HTMLParser

import pytest

from pendubot_identification.cli.main import main
from pendubot_identification.files import OutputFolder
from pendubot_identification.report.page import result_page, write_report
from pendubot_identification.results import provenance
from pendubot_identification.results.provenance import IN_MEMORY
from pendubot_identification.results.result import read_complete_result
from test.identified import made, plain
from test.identified import result as typed
from test.report.test_plots import every_picture, motion, pictures

VOID = {'meta', 'link', 'img', 'input'}


class Page(HTMLParser):
    """A parsed page: its text, its table rows and its tags, which must match."""

    def __init__(self, text):
        super().__init__()
        self.text, self.rows, self.tags, self._open = [], [], set(), []
        self.feed(text)
        self.close()
        assert not self._open

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        if tag == 'tr':
            self.rows.append('')
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, text):
        if not {'style', 'script'} & {*self._open}:
            self.text.append(text)
            if 'tr' in self._open:
                self.rows[-1] += f'{text} '


def values(result):
    """Return every number of a result, without the numbers of single runs."""
    if isinstance(result, dict):
        return [number for key, value in result.items() if not key.endswith('_runs') for number in values(value)]
    if isinstance(result, (list, tuple)):
        return [number for value in result for number in values(value)]
    return [float(result)] if isinstance(result, (int, float)) and not isinstance(result, bool) else []


@pytest.mark.parametrize(
    'options', [{}, {'optimizer': 'mde', 'criteria': ('energy',)}, {'criteria': ('energy',), 'validate': False}]
)
def test_every_number_in_a_table_is_in_the_result_file(options):
    """It may also be the half-width of an interval, or from the reference."""
    result, reference = plain(**options), plain(('weak',))
    zero = {'recording': 'swing', 'q1': -3.26, 'q1_std_error': 0.24, 'q2': None, 'q2_std_error': None, 'unit': 'degree'}
    result |= {'zeros': [zero], 'advice': ['move the elbow']}
    page = Page(result_page(typed(result), [], (typed(reference), 'reference')))
    assert 'move the elbow' in ' '.join(page.text)
    known = [*values(result), *values(reference)]
    for parameters in (result['parameters'], *(answer['parameters'] for answer in result['criteria'].values())):
        known += [entry['interval'][1] - entry['value'] for entry in parameters.values() if entry['std_error']]
    known += [1.96 * number for number in values(result)]
    shown = re.findall(r'(?<![\w.^])-?\d+\.\d+(?:e-?\d+)?', ' '.join(page.rows).replace('−', '-'))
    assert len(shown) > 40
    for number in shown:
        mantissa, _, power = number.partition('e')
        rounding = 0.51 * 10.0 ** (int(power or 0) - len(mantissa.partition('.')[2]))
        assert any(abs(float(number) - value) <= rounding + 1e-9 * abs(value) for value in known), number


@pytest.fixture(scope='module')
def complete():
    """The page of a result with all pictures and a reference."""
    return result_page(made(), every_picture(), (made(), 'reference'), text='schema: 1')


def test_every_picture_has_a_sentence_about_a_good_result(complete):
    shown = complete.split('<figure')[1:]
    assert len(shown) == len(every_picture()) == 6
    for figure in shown:
        (good,) = re.findall(r'<p class="good">(.+?)</p>', figure, re.DOTALL)
        assert re.search(r'\b[Gg]ood\b', good)
    assert 'Diamond: reference.' in complete
    assert 'one after the other' not in complete, 'there is only one recording'


def test_captions_describe_the_drawn_data_and_names_of_the_user_are_escaped():
    result = plain(('weak',))
    result['bags'][0]['bag'] = '<script>alert(1)</script>'
    result['zeros'] = [{'recording': '<script>', 'q1': 0, 'q1_std_error': 0, 'q2': 0, 'q2_std_error': 0}]
    drawn = pictures(made(('weak',)), [motion(name='me@home/</script><iframe>'), motion(name='me@home/b')])
    page = result_page(typed(result), [drawn['recordings'], drawn['simulation']], notes=['<script>'])
    assert page.count('<script') == 2, "the page's scripts"
    assert 'iframe' not in Page(page).tags
    text = ' '.join(page.split())
    assert 'these recordings one after the other' in text
    assert 'There are no validation data' in text
    assert 'for 1 s from the measured' in text
    assert 'on the training data' in text


def test_the_page_depends_on_no_other_file(complete):
    assert re.findall(r'(?:src|href)="(?!#)(?!data:)[^"]*|@import|url\(http', complete) == []
    assert not Page(complete).tags & {'iframe', 'object', 'form'}
    assert 'Permission is hereby granted' in ' '.join(complete.split()), "the library's licence"


@pytest.mark.parametrize(
    'options',
    [
        '--model viscous',
        '--criterion energy,weak --model coulomb --optimizer lsq --seed 3 --delay=-0.01:0.02 --bounds b2=0 --sliding 2',
        '--validate swing@4:6 --criterion weak --hold zero --link-length 0.03 --link-mass 0.03 --bounds P1=0:0.5',
        '--criterion weak --model viscous --negate tau1,tau2 --apply-remedies',
        '--criterion energy --model viscous --spread 0 --settings fast.yaml',
        '--criterion energy --model viscous --bounds P1=0:0.1 --bounds P5=0.0033261234567',
    ],
)
def test_the_command_on_the_page_reproduces_the_result(options, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(['simulate', '--output', 'swing', '--samples', '800']) == 0
    (tmp_path / 'fast.yaml').write_text('{generations: 90, per_vector: true, population: 20, runs: 3}\n')
    main(['identify', 'swing@0:4', *options.split(), '--output', 'first.yaml'])
    first = read_complete_result(tmp_path / 'first.yaml')
    command = provenance.command(first)
    page = result_page(first, [])
    assert f'data-copy="{html.escape(command)}"' in page
    command, _, file = command.partition('  # with --settings, a file with ')
    assert file == ((tmp_path / 'fast.yaml').read_text().strip() if 'fast.yaml' in options else '')
    again = ['--settings', 'fast.yaml'] if file else []
    main([*shlex.split(command)[1:], *again, '--output', 'again.yaml'])
    again = read_complete_result(tmp_path / 'again.yaml')
    assert again.parameters == first.parameters
    assert again.criteria == first.criteria


def test_no_absolute_path_is_on_the_page(tmp_path):
    """This holds for sentences, plots, links, downloads and the command."""
    result = plain(('weak',))
    result['bags'][0]['bag'] = 'swing' + IN_MEMORY
    assert 'data-copy=' not in result_page(typed(result), []), 'no command can repeat it'
    result['bags'][0]['bag'] = '/home/ann & co/swing@0:4'
    result['warnings'] = ['in /home/ann & co/swing@0:4 a link stands still']
    named = motion(name='/home/ann & co/swing@0:4'), motion(name='b')
    with OutputFolder(tmp_path / 'look') as folder:
        text = write_report(folder, typed(result), ([named[0]], [named[1]])).read_text()
    assert 'ann' not in text.replace('mann', '')
    assert text.count('swing@0:4') >= 4


def test_warnings_are_at_the_top_of_the_page():
    result = plain()
    result |= {'level': 'ERROR', 'warnings': ['not physical: P1 < 0', 'cut & dried'], 'consequences': ['b1 < 0']}
    result['criteria']['weak']['consequences'] = ['b1 < 0']
    text = result_page(typed(result), [])
    for sentence in ('not physical: P1 &lt; 0', 'cut &amp; dried', 'weak: b1 &lt; 0'):
        assert text.index(sentence) < text.index('<h2 id="parameters"')
    assert 'do not use these parameters in a controller' in text
    others = [w for e in result['criteria'].values() for w in e['warnings'] if w not in result['warnings']]
    assert all(html.escape(warning) in text for warning in others)


def test_reservations_and_correlations_are_in_the_row_of_their_parameter():
    result = plain()
    result['parameters']['P4'] |= {'on_bound': True, 'std_error': None}
    result |= {'not_covered': {'P4': 'on its bound', 'b1': 'its 95 % interval reaches 0'}}
    result |= {'advice': ['the motion is little informative of b1 (a, b); to improve: speed']}
    text = result_page(typed(result), [])
    detail = text.partition('<div class="detail"')[2].partition('</table>')[0]
    rows = dict(re.findall(r'<th scope="row">(\w+) \[.*?</th>(.*?)</tr>', detail, re.DOTALL))
    assert rows['P4'].count('on its bound') == 1
    assert 'reaches 0' in rows['b1']
    assert text.count('to improve: speed') == 1
    matrix = result['criteria'][result['criterion']]['correlation']
    for k, name in enumerate(result['parameters']):
        correlated = {other for j, other in enumerate(result['parameters']) if j != k and abs(matrix[k][j] or 0) > 0.95}
        assert set(re.findall(r'with (\w+):', rows[name])) == correlated
