# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The page: every number is the result file's, nothing comes from elsewhere, nothing a user typed is markup."""

import html
import math
import re
from html.parser import HTMLParser

import pytest

from pendubot_identification.report.figures import draw_correlation, draw_recordings, draw_simulation
from pendubot_identification.report.page import Bag, failure_page, result_page
from test.identified import plain
from test.identified import result as typed
from test.report.test_figures import every_picture, motion, simulation

VOID = {'meta', 'link', 'img'}


class Page(HTMLParser):
    """A page taken apart: its data elements, its text without them, its links, and whether its tags match."""

    def __init__(self, text):
        super().__init__()
        self.data, self.text, self.links, self.tags, self._open = [], [], [], set(), []
        self.feed(text)
        self.close()
        assert not self._open

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        attributes = dict(attributes)
        self.links += [value for key, value in attributes.items() if key in ('src', 'href')]
        if tag == 'data':
            self.data.append([attributes, ''])
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, text):
        if self._open and self._open[-1] == 'data':
            self.data[-1][1] += text
        elif not {'style', 'script'} & {*self._open}:
            self.text.append(text)


def entry(result, path):
    for key in path.split('.'):
        result = result[int(key)] if isinstance(result, list) else result[key]
    return result


def sentences(node):
    """Every text of a result with a number in it that is no unit; the page may print it as it is."""
    if isinstance(node, str):
        return {node} if re.search(r'\d', node) and len(node) > 4 else set()
    children = [*node, *node.values()] if isinstance(node, dict) else node if isinstance(node, list) else []
    return {text for child in children for text in sentences(child)}


def unit_of_last_digit(text):
    mantissa, _, power = text.partition('e')
    return 10.0 ** (int(power or 0) - len(mantissa.partition('.')[2]))


@pytest.mark.parametrize(
    'options', [{}, {'optimizer': 'mde', 'criteria': ('energy',)}, {'criteria': ('energy',), 'validate': False}]
)
def test_every_number_is_the_one_of_the_result_file(options):
    result, reference = plain(**options), plain(('weak',))
    zero = {'recording': 'swing', 'q1': -3.26, 'q1_std_error': 0.24, 'q2': None, 'q2_std_error': None, 'unit': 'degree'}
    result |= {'zeros': [zero], 'advice': ['move the elbow']}
    page = Page(result_page(typed(result), [], (typed(reference), 'reference')))
    assert len(page.data) > 70
    for attributes, shown in page.data:
        source = reference if attributes.get('data-of') == 'reference' else result
        value = entry(source, attributes['data-entry'])
        assert attributes['value'] == repr(value)
        value *= float(attributes.get('data-times', 1))
        number, unit = (shown.rstrip('%'), 0.01) if '%' in shown else (shown, 1.0)
        rounding = 0.51 * unit * unit_of_last_digit(number)
        assert math.isclose(unit * float(number), value, rel_tol=1e-12, abs_tol=rounding), shown
    assert {'zeros.0.q1', 'zeros.0.q1_std_error'} <= {attributes['data-entry'] for attributes, _ in page.data}
    # And no number stands anywhere else, but in what the file says in words and in names and prose.
    text = ' '.join(page.text)
    assert 'move the elbow' in text
    for known in sorted(sentences(result), key=len, reverse=True):
        text = text.replace(known, ' ')
    text = re.sub(r'95 % interval|link [12]|\b[A-Za-z]+[0-9](\^2)?|\^2', ' ', text)
    assert re.findall(r'\d+', text) == []


def test_all_that_the_file_says_of_its_making_is_at_the_foot():
    result = plain()
    page = Page(result_page(typed(result), []))
    shown = {attributes['data-entry'] for attributes, _ in page.data}
    text = ' '.join(page.text)
    for name, value in result['made_by'].items():
        assert name.replace('_', ' ') in text
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            assert f'made_by.{name}' in shown
    assert {f'made_by.upper_bounds.{k}' for k in range(14)} <= shown
    for k, bag in enumerate(result['bags']):
        assert bag['sha256'] in text
        assert bag['bag'] in text
        assert f'bags.{k}.samples' in shown


def test_every_figure_is_shown_with_what_a_good_one_looks_like():
    text = result_page(typed(plain()), every_picture(), (typed(plain()), 'reference'))
    shown = text.split('<figure class')[1:]
    assert len(shown) == 10
    for figure in shown:
        (good,) = re.findall(r'<p class="good">(.+?)</p>', figure, re.DOTALL)
        assert re.search(r'\b[Gg]ood\b', good)
        assert '. ' not in good, 'one sentence'
    assert 'black: reference.' in text
    assert 'one after the other' not in text, 'there is but one recording'


def test_captions_follow_from_what_was_drawn():
    several = draw_recordings([motion(name='a@0:3'), motion(name='b')], [])
    fitted = draw_simulation(simulation(), validation=False)
    text = ' '.join(result_page(typed(plain()), [several, fitted]).split())
    assert 'The recordings stand one after the other' in text
    assert 'There are no validation data' in text
    assert 'over 1 s at a time' in text
    assert 'the very data that were fitted' in text


def test_nothing_comes_from_elsewhere():
    result = plain()
    bags = [Bag('swing', 'file:///data/swing', '2026-11-20')]
    page = Page(result_page(typed(result), [draw_correlation(typed(result))], bags=bags))
    assert len([link for link in page.links if link.startswith('data:')]) == 2, 'the figure, and an icon that is none'
    others = {link for link in page.links if not link.startswith(('data:', '#'))}
    assert others == {'result.yaml', 'file:///data/swing'}
    assert 'recorded' in ' '.join(page.text)
    assert not page.tags & {'script', 'iframe', 'object', 'form'}, 'without plots over time nothing runs'
    source = result_page(typed(result), [draw_simulation(simulation(), validation=True)])
    source = re.sub('src="data:[^"]*"', '', source)  # a figure refers to parts of itself
    assert source.count('<script') == 2
    assert ' src="http' not in source
    assert 'Permission is hereby granted' in source, "the library's licence"
    assert '@import' not in source
    assert 'url(' not in source


def test_warnings_stand_at_the_top_in_words():
    result = plain()
    result |= {'level': 'ERROR', 'warnings': ['not physical: P1 < 0', 'cut & dried'], 'consequences': ['b1 < 0']}
    result['criteria']['weak']['consequences'] = ['b1 < 0']
    text = result_page(typed(result), [])
    assert text.index('not physical: P1 &lt; 0') < text.index('<h2 ')
    assert text.index('cut &amp; dried') < text.index('<h2 ')
    assert text.index('weak: b1 &lt; 0') < text.index('<h2 ')
    assert 'do not use these parameters in a controller' in text
    others = [w for e in result['criteria'].values() for w in e['warnings'] if w not in result['warnings']]
    assert all(html.escape(warning) in text for warning in others)


def test_what_a_user_named_is_no_markup():
    result = plain()
    result['bags'][0]['bag'] = '<script>alert(1)</script>'
    assert 'script' not in Page(result_page(typed(result), [], notes=['<script>'])).tags
    named = draw_recordings([motion(name='</script><iframe>'), motion(name='b')], [])
    assert 'iframe' not in Page(result_page(typed(result), [named])).tags
    assert 'script' not in Page(failure_page('<script>', ['<script>'])).tags


def test_doubts_stand_beside_their_parameter_and_advice_below_it():
    """Whatever else there is to advise stands below the table."""
    result = plain()
    result['parameters']['P4'] |= {'on_bound': True, 'std_error': None}
    result |= {'not_covered': {'P4': 'on its bound', 'b1': 'its 95 % interval reaches 0'}}
    result |= {'advice': ['this motion tells little of b1 (a, b); what helps: speed', 'warm it up']}
    text = result_page(typed(result), [])
    rows = dict(re.findall(r'<th scope="row">(\w+)<small>.*?</th>(.*?)(?=<th scope|</tbody>)', text, re.DOTALL))
    doubts = {
        name: ' '.join(
            Page(
                f'<b>{row.rpartition("</tr>")[0]}'.replace('</tr>', '').replace('<tr class="advice">', '') + '</b>'
            ).text
        )
        for name, row in rows.items()
    }
    assert doubts['P4'].count('on its bound') == 1
    assert 'reaches 0' in doubts['b1']
    assert 'what helps: speed' in doubts['b1']
    assert text.count('what helps: speed') == 1
    assert 'warm it up' in text.partition('</tbody>')[2]
    matrix = result['criteria'][result['criterion']]['correlation']
    for k, name in enumerate(result['parameters']):
        together = {other for j, other in enumerate(result['parameters']) if j != k and abs(matrix[k][j] or 0) > 0.95}
        assert set(re.findall(r'with (\w+):', doubts[name])) == together


def test_a_mapping_where_none_belongs_is_shown():
    result = plain()
    result['made_by']['lower_bounds'] = {'P1': 0.0, 'P2': None}
    made = typed(plain())
    object.__setattr__(made.made_by, 'lower_bounds', result['made_by']['lower_bounds'])
    assert 'P1: 0.0, P2: -' in re.sub(r'<data[^>]*>|</data>|\n', '', result_page(made, []))
