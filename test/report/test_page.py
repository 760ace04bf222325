# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The page: its numbers are the result file's, nothing comes from elsewhere, nothing a user typed is markup."""

import html
import re
from html.parser import HTMLParser

import pytest

from pendubot_identification.report.figures import draw_correlation
from pendubot_identification.report.page import Bag, failure_page, result_page
from pendubot_identification.report.plots import Timeline, plot_recordings, plot_simulation
from test.identified import plain
from test.identified import result as typed
from test.report.pictures import every_picture, motion, simulation

VOID = {'meta', 'link', 'img'}


class Page(HTMLParser):
    """A page taken apart: its text, the texts of its table rows, its links, and whether its tags match."""

    def __init__(self, text):
        super().__init__()
        self.text, self.rows, self.links, self.tags, self._open = [], [], [], set(), []
        self.feed(text)
        self.close()
        assert not self._open

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.links += [value for key, value in attributes if key in ('src', 'href')]
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

    def row(self, *words):
        """The words of the first row of a table that begins with these."""
        return next(row.split() for row in self.rows if row.split()[: len(words)] == [*words])


def values(result):
    """Every number of a result, but for those of single runs and matrices."""
    if isinstance(result, dict):
        return [number for key, value in result.items() if not key.endswith('_runs') for number in values(value)]
    if isinstance(result, (list, tuple)):
        return [number for value in result for number in values(value)]
    return [float(result)] if isinstance(result, (int, float)) and not isinstance(result, bool) else []


@pytest.mark.parametrize(
    'options', [{}, {'optimizer': 'mde', 'criteria': ('energy',)}, {'criteria': ('energy',), 'validate': False}]
)
def test_every_number_in_a_table_is_one_of_the_result_file(options):
    """Or the half-width of an interval, or of an earlier result beside it."""
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
    for name, entry in result['parameters'].items():
        assert float(page.row(name)[page.row(name).index('±') - 1]) == pytest.approx(entry['value'], abs=5.1e-5)


def test_all_that_the_file_says_of_its_making_is_at_the_foot():
    result = plain()
    text = ' '.join(Page(result_page(typed(result), [])).text)
    for name, value in result['made_by'].items():
        assert name.replace('_', ' ') in text
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            assert str(value) in text
    assert ', '.join(map(str, result['made_by']['upper_bounds'])) in text
    for bag in result['bags']:
        assert all(str(bag[name]) in text for name in ('bag', 'sha256', 'samples'))


def test_every_picture_is_shown_with_what_a_good_one_looks_like():
    text = result_page(typed(plain()), every_picture(), (typed(plain()), 'reference'))
    shown = text.split('<figure')[1:]
    assert len(shown) == 10
    for figure in shown:
        (good,) = re.findall(r'<p class="good">(.+?)</p>', figure, re.DOTALL)
        assert re.search(r'\b[Gg]ood\b', good)
        assert '. ' not in good, 'one sentence'
    assert 'black: reference.' in text
    assert 'one after the other' not in text, 'there is but one recording'


def test_captions_follow_from_what_was_drawn():
    several = plot_recordings([motion(name='a@0:3'), motion(name='b')], [])
    fitted = plot_simulation(simulation(), Timeline(), validation=False)
    text = ' '.join(result_page(typed(plain()), [several, fitted]).split())
    for said in ('these recordings one after the other', 'There are no validation data', 'for 1 s from the measured'):
        assert said in text
    assert 'on the training data' in text


def test_nothing_comes_from_elsewhere():
    bags = [Bag('swing', 'file:///data/swing', '2026-11-20')]
    page = Page(result_page(typed(plain()), draw_correlation(typed(plain())), bags=bags))
    assert len([link for link in page.links if link.startswith('data:')]) == 2, 'the figure, and an icon that is none'
    assert {link for link in page.links if not link.startswith(('data:', '#'))} == {'result.yaml', 'file:///data/swing'}
    assert 'recorded' in ' '.join(page.text)
    assert not page.tags & {'script', 'iframe', 'object', 'form'}, 'without plots over time nothing runs'
    source = result_page(typed(plain()), [plot_simulation(simulation(), Timeline(), validation=True)])
    assert source.count('<script') == 2
    assert 'Permission is hereby granted' in source, "the library's licence"
    assert not any(word in source for word in (' src="http', '@import', 'url('))


def test_warnings_stand_at_the_top_in_words():
    result = plain()
    result |= {'level': 'ERROR', 'warnings': ['not physical: P1 < 0', 'cut & dried'], 'consequences': ['b1 < 0']}
    result['criteria']['weak']['consequences'] = ['b1 < 0']
    text = result_page(typed(result), [])
    for said in ('not physical: P1 &lt; 0', 'cut &amp; dried', 'weak: b1 &lt; 0'):
        assert text.index(said) < text.index('<h2 ')
    assert 'do not use these parameters in a controller' in text
    others = [w for e in result['criteria'].values() for w in e['warnings'] if w not in result['warnings']]
    assert all(html.escape(warning) in text for warning in others)


def test_what_a_user_named_is_no_markup():
    result = plain()
    result['bags'][0]['bag'] = '<script>alert(1)</script>'
    result['zeros'] = [{'recording': '<script>', 'q1': 0, 'q1_std_error': 0, 'q2': 0, 'q2_std_error': 0}]
    assert 'script' not in Page(result_page(typed(result), [], notes=['<script>'])).tags
    named = plot_recordings([motion(name='</script><iframe>'), motion(name='b')], [])
    assert 'iframe' not in Page(result_page(typed(result), [named])).tags
    assert 'script' not in Page(failure_page('<script>', ['<script>'])).tags


def test_doubts_stand_beside_their_parameter_and_advice_below_it():
    """Other advice stands below the table."""
    result = plain()
    result['parameters']['P4'] |= {'on_bound': True, 'std_error': None}
    result |= {'not_covered': {'P4': 'on its bound', 'b1': 'its 95 % interval reaches 0'}}
    result |= {'advice': ['the motion is little informative of b1 (a, b); to improve: speed', 'warm it up']}
    text = result_page(typed(result), [])
    rows = dict(re.findall(r'<th scope="row">(\w+)<small>.*?</th>(.*?)(?=<th scope|</tbody>)', text, re.DOTALL))
    assert rows['P4'].count('on its bound') == 1
    assert 'reaches 0' in rows['b1']
    assert 'to improve: speed' in rows['b1']
    assert text.count('to improve: speed') == 1
    assert 'warm it up' in text.partition('</tbody>')[2]
    matrix = result['criteria'][result['criterion']]['correlation']
    for k, name in enumerate(result['parameters']):
        together = {other for j, other in enumerate(result['parameters']) if j != k and abs(matrix[k][j] or 0) > 0.95}
        assert set(re.findall(r'with (\w+):', rows[name])) == together
