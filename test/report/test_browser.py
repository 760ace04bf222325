# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The report in a real browser: interaction, dark mode, print, without JavaScript, on a telephone, accessibility."""

import json
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pendubot_identification.files import OutputFolder
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.report.page import write_report, write_track
from pendubot_identification.report.plots import plot_track
from pendubot_identification.report.tables import Table
from pendubot_identification.results.result import Parameter, PartialResult
from pendubot_identification.tracking.events import Change, Disturbance, State
from test.browser import BRIGHTNESS, NEEDS_BROWSER, accessible, watched
from test.identified import made, swing

pytestmark = NEEDS_BROWSER

#: Time ranges of the charts by plot.
RANGES = """() => Object.fromEntries([...document.querySelectorAll('.plot')].map(
  (box) => [box.dataset.plot, box.charts.map((chart) => [chart.scales.x.min, chart.scales.x.max])]))"""


@pytest.fixture(scope='module')
def real(tmp_path_factory):
    """Return the page of a result with its recordings, and a reference with a larger P1."""
    bag, result = swing(), made()
    guess = {n: Parameter(value=entry.value * (1.1 if n == 'P1' else 1)) for n, entry in result.parameters.items()}
    reference = PartialResult(parameters=guess), 'reference'
    with OutputFolder(tmp_path_factory.mktemp('real') / 'look') as folder:
        advice = ['the motion is little informative of b1 (a, b); to improve: speed']
        result = replace(result, advice=advice, unmodelled=(1.0, 0.984))
        return write_report(folder, result, ([bag[:400]], [bag[400:1000]]), beside=reference)


@pytest.fixture
def opened(browser, real):
    """Return a function that opens a page; fail on console messages and on requests to other hosts."""
    defaults = {'viewport': {'width': 1280, 'height': 900}, 'reduced_motion': 'reduce'}
    with watched(browser) as shown:
        yield lambda file=real, **options: shown(file.as_uri(), ('file:', 'data:'), **defaults | options)


def over(page, plot, panel=0):
    """Return the box of a panel of a plot on the screen."""
    chart = page.locator(f'[data-plot={plot}] .u-over').nth(panel)
    chart.scroll_into_view_if_needed()
    return chart.bounding_box()


def drag(page, box, begin, end):
    y = box['y'] + box['height'] / 2
    page.mouse.move(box['x'] + begin * box['width'], y)
    page.mouse.down()
    page.mouse.move(box['x'] + end * box['width'], y, steps=4)
    page.mouse.up()


def test_all_plots_zoom_together_by_mouse_buttons_and_keys(opened):
    page = opened()
    before = page.evaluate(RANGES)
    last = before['recordings'][0][1]
    begin, end = before['simulation'][0]
    assert len(before['simulation']) == 6, 'states and errors'
    drag(page, over(page, 'simulation'), 0.25, 0.5)
    page.wait_for_function(f'({RANGES})().simulation[0][1] < {end} - 1')
    after = page.evaluate(RANGES)
    low, high = after['simulation'][0]
    assert (low, high) == pytest.approx((begin + (end - begin) / 4, (begin + end) / 2), abs=0.05)
    shown = [panel for name in ('simulation', 'recordings') for panel in after[name]]
    assert all(panel == pytest.approx((low, high)) for panel in shown)
    page.locator('[data-plot=recordings] button[title="zoom in"]').click()
    page.wait_for_function(f'({RANGES})().recordings[0][0] > {low}')
    begin, end = page.evaluate(RANGES)['recordings'][0]
    assert end - begin == pytest.approx((high - low) / 1.6)
    page.locator('[data-plot=recordings]').focus()
    page.keyboard.press('ArrowRight')
    page.wait_for_function(f'({RANGES})().recordings[0][0] > {begin}')
    assert page.evaluate(RANGES)['recordings'][0][0] == pytest.approx(begin + (end - begin) / 4)
    for restore in (page.mouse.dblclick, lambda *_: page.keyboard.press('Home')):
        box = over(page, 'recordings', 1)
        restore(box['x'] + 40, box['y'] + 40)
        page.wait_for_function(f'({RANGES})().recordings[0][1] === {last}')
        assert page.evaluate(RANGES) == before
        page.locator('[data-plot=recordings] button[title="zoom in"]').click()
        page.locator('[data-plot=recordings]').focus()


def shown(output):
    return float(output.inner_text().replace('−', '-'))


def test_values_follow_the_mouse(opened):
    page = opened()
    box = over(page, 'simulation', 0)
    page.mouse.move(box['x'] + box['width'] / 4, box['y'] + 30)
    page.wait_for_function('() => document.querySelector("[data-plot=recordings] output").textContent')
    measured = page.locator('[data-plot=simulation] .head output').first
    begin, end = page.evaluate(RANGES)['simulation'][0]
    t, q = swing().t - swing().t[0], swing().q
    expected = np.interp(begin + (end - begin) / 4, t, q[:, 0])
    assert shown(measured) == pytest.approx(expected, abs=0.05)
    other = page.locator('[data-plot=recordings] .head').nth(1).locator('output')
    assert shown(other) == pytest.approx(expected, abs=0.05)


def test_figures_follow_the_colour_scheme(opened):
    page = opened()
    for inverted in (False, True):
        page.emulate_media(color_scheme='dark' if inverted else 'light')
        paper, ink = (page.evaluate(BRIGHTNESS, ['body', name]) for name in ('backgroundColor', 'color'))
        assert (paper < 40 and ink > 200) if inverted else (paper > 240 and ink < 40)
        for selector in ('figure img', '.plot canvas', '.swatch'):
            style = page.evaluate('(s) => getComputedStyle(document.querySelector(s)).filter', selector)
            assert ('invert' in style) == inverted, selector


def test_a_printed_page_is_light_without_controls_and_has_at_most_four_sheets(opened):
    page = opened(color_scheme='dark')
    pdf = page.pdf(prefer_css_page_size=True)
    assert 1 <= len(re.findall(rb'/Type\s*/Page\b', pdf)) <= 4
    figures = page.locator('[data-name=simulation] img, [data-name=recordings] img').all()
    assert not any(each.is_visible() for each in figures), 'interactive plots replace them'
    page.emulate_media(media='print')
    assert page.evaluate(BRIGHTNESS, ['body', 'backgroundColor']) > 240
    assert not any(each.is_visible() for each in page.locator('button, summary').all())
    assert len(figures) == 2
    assert all(each.is_visible() for each in figures)


@pytest.mark.parametrize('script', [True, False])
def test_a_telephone_shows_every_figure_without_horizontal_scrolling_and_values_with_units_on_one_line(opened, script):
    page = opened(viewport={'width': 360, 'height': 800}, java_script_enabled=script)
    assert page.evaluate('document.documentElement.scrollWidth') == 360
    lines = """() => [...document.querySelectorAll('.value, .fits b')].map((cell) => {
      const range = document.createRange();
      range.selectNodeContents(cell);
      const bottoms = [...range.getClientRects()].map(({ bottom }) => bottom);
      return Math.max(...bottoms) - Math.min(...bottoms) })"""
    assert max(page.evaluate(lines)) < 6, 'one line is higher than 6 pixels'
    assert page.locator('.value').count() == 7
    if not script:
        figures = page.locator('figure img').all()
        assert len(figures) > 6
        assert all(each.is_visible() for each in figures)
        assert not any(each.is_visible() for each in page.locator('.live').all())


def test_the_first_screen_contains_the_level_the_fits_and_the_parameters(opened, real):
    """On a telephone it is two screens."""
    result = made()
    assert real.stat().st_size <= 2_000_000
    for width, height, screens in ((1440, 900, 1), (360, 800, 2)):
        page = opened(viewport={'width': width, 'height': height})
        assert page.evaluate('document.querySelector(".first").getBoundingClientRect().bottom') <= screens * height
    first = page.locator('.first')
    assert first.locator('.level strong').inner_text() == result.level.name
    fits = [float(text.split()[0]) for text in first.locator('.fits b').all_inner_texts()]
    assert fits == pytest.approx([result.prediction.fit[state][2] for state in ('q1', 'q2', 'dq1', 'dq2')], abs=0.051)
    rows = first.locator('.parameters tbody tr').all()
    assert [row.locator('th').inner_text() for row in rows] == list(result.parameters)
    for row, entry in zip(rows, result.parameters.values(), strict=True):
        low, high = entry.interval
        width = row.evaluate("(r) => parseFloat(r.querySelector('.bar i').style.width)")
        assert width == pytest.approx(min(50 * (high - low) / abs(entry.value), 100), abs=0.01)


def test_the_result_is_saved_and_the_command_copied(opened, real):
    page = opened(accept_downloads=True, permissions=['clipboard-read', 'clipboard-write'])
    with page.expect_download() as download:
        page.get_by_role('link', name='result.yaml').click()
    assert download.value.path().read_bytes() == real.with_name('result.yaml').read_bytes()
    page.get_by_role('button', name='copy the command').click()
    page.get_by_role('button', name='copied').wait_for()
    assert page.evaluate('navigator.clipboard.readText()').startswith('pendubot identify swing@0:4')


@pytest.fixture(scope='module')
def track():
    """Return states of a rig with nine parameters, a change and a disturbance."""
    values = 1 + 0.01 * np.random.default_rng(1).standard_normal((100, 9))
    states = [
        State(float(t), theta, np.full(9, 0.01 + 1 / (1 + t)), 0.0, 0.001, Level.WARN, ('it is cold',), 0.1, True)
        for t, theta in enumerate(values)
    ]
    states[0] = states[0]._replace(std_error=np.full(9, np.inf))
    return states, [Change(40.0, 41.0, 'payload on link 2', {'P2': (0.1, 0.01)}), Disturbance(60.0, 60.5)]


@pytest.fixture(scope='module')
def pages(real, track, tmp_path_factory):
    """Return the pages of a result and of a track."""
    folder = tmp_path_factory.mktemp('pages')
    table, events = Table(['', 'value'], [['P1', '1']]), [str(event) for event in track[1]]
    with OutputFolder(folder / 'track') as tracked:
        return real, write_track(tracked, track, table, events, ['day'], '')


def test_pages_have_no_serious_accessibility_finding_and_ordered_headings(opened, pages):
    for file in pages:
        page = opened(file)
        page.evaluate('document.querySelectorAll("details").forEach((each) => { each.open = true; })')
        accessible(page)
        levels = page.evaluate(
            '[...document.querySelectorAll("main :is(h1, h2, h3, h4)")].map((h) => Number(h.tagName[1]))'
        )
        assert len(levels) == page.locator('h1, h2, h3, h4').count()
        assert levels[0] == levels.count(1) == 1
        assert all(after <= before + 1 for before, after in pairwise(levels))


def test_the_page_of_a_track_shows_parameters_and_events_over_time(opened, pages, track):
    states, _ = track
    assert plot_track(states[:1], []).content.panels, 'also for one state'
    page = opened(pages[1])
    before = page.evaluate(RANGES)['track']
    assert len(before) == 10, 'nine parameters and the unexplained torque'
    drag(page, over(page, 'track'), 0.25, 0.5)
    after = page.evaluate(RANGES)['track']
    assert all(panel == after[0] for panel in after)
    assert after[0][1] - after[0][0] == pytest.approx((before[0][1] - before[0][0]) / 4, rel=0.02)
    plot = json.loads(page.locator('#content').text_content())['track']
    assert [(label, round(begin)) for begin, _, _, label in plot['spans']] == [('change', 40), ('disturbance', 60)]
    band = plot['panels'][0]['lines'][0]
    assert band['upper'][-1] - band['y'][-1] == pytest.approx(2 * NORMAL_95 * states[-1].std_error[0], rel=1e-3)
    assert 'payload on link 2, at 40.0 to 41.0 s' in page.inner_text('body')
