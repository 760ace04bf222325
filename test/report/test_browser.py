# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The page in a real browser: explored, in the dark, on paper, without JavaScript, on a telephone; no complaints."""

import json
import shutil

import numpy as np
import pytest

from pendubot_identification.files import OutputFolder
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.report.folder import write_track
from pendubot_identification.report.page import result_page
from pendubot_identification.report.plots import plot_track
from pendubot_identification.report.table import Table
from pendubot_identification.tracking.events import Change, Disturbance, State
from test.identified import plain
from test.identified import result as typed
from test.report.pictures import every_picture

CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser') or shutil.which('google-chrome')
try:
    from playwright.sync_api import sync_playwright
except ImportError:
    sync_playwright = None

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason='no Chromium: apt-get install chromium'),
    pytest.mark.skipif(sync_playwright is None, reason='no playwright: pip install playwright'),
]

#: What a chart shows of time, and where its box is.
RANGES = """() => Object.fromEntries([...document.querySelectorAll('.plot')].map(
  (box) => [box.dataset.plot, box.charts.map((chart) => [chart.scales.x.min, chart.scales.x.max])]))"""
BRIGHTNESS = """([selector, what]) => {
  const colour = getComputedStyle(document.querySelector(selector))[what];
  return colour.match(/\\d+/g).slice(0, 3).reduce((sum, part) => sum + Number(part), 0) / 3 }"""


@pytest.fixture(scope='module')
def browser():
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        yield browser
        browser.close()


@pytest.fixture(scope='module')
def file(tmp_path_factory):
    result = plain()
    result['advice'] = ['the motion is little informative of b1 (a, b); to improve: speed']
    path = tmp_path_factory.mktemp('page') / 'report.html'
    path.write_text(result_page(typed(result), every_picture(), (typed(plain()), 'reference')), encoding='utf-8')
    return path


@pytest.fixture
def opened(browser, file):
    """Opens a page as it is asked for; at the end nothing may have been said on its console, or asked of anyone."""
    contexts, said = [], []

    def opened(file=file, **how):
        contexts.append(browser.new_context(**{'viewport': {'width': 1280, 'height': 900}} | how))
        page = contexts[-1].new_page()
        page.on('console', lambda message: said.append(message.text))
        page.on('pageerror', lambda error: said.append(str(error)))
        page.on('request', lambda r: None if r.url.startswith(('file:', 'data:')) else said.append(r.url))
        page.goto(file.as_uri())
        return page

    yield opened
    for context in contexts:
        context.close()
    assert said == []


def over(page, plot, panel=0):
    """Where the first panel of a plot is, as the mouse sees it."""
    chart = page.locator(f'[data-plot={plot}] .u-over').nth(panel)
    chart.scroll_into_view_if_needed()
    return chart.bounding_box()


def drag(page, box, begin, end):
    y = box['y'] + box['height'] / 2
    page.mouse.move(box['x'] + begin * box['width'], y)
    page.mouse.down()
    page.mouse.move(box['x'] + end * box['width'], y, steps=4)
    page.mouse.up()


def test_what_is_zoomed_in_one_plot_is_zoomed_in_all_and_comes_back(opened):
    page = opened()
    before = page.evaluate(RANGES)
    assert before['simulation'] == [[0, 3]] * 6, 'states and errors'
    drag(page, over(page, 'simulation'), 0.25, 0.5)
    page.wait_for_function(f'({RANGES})().simulation[0][1] < 2')
    after = page.evaluate(RANGES)
    shown = after['simulation'][0]
    assert shown == pytest.approx([0.75, 1.5], abs=0.02)
    assert all(panel == pytest.approx(shown) for panels in after.values() for panel in panels)
    box = over(page, 'recordings', 1)
    page.keyboard.down('Shift')
    drag(page, box, 0.8, 0.3)
    page.keyboard.up('Shift')
    page.wait_for_function(f'({RANGES})().simulation[0][0] > 1')
    moved = page.evaluate(RANGES)['simulation'][0]
    assert moved[0] == pytest.approx(shown[0] + 0.5 * 0.75, abs=0.03)
    assert moved[1] - moved[0] == pytest.approx(0.75, abs=0.02)
    box = over(page, 'recordings', 1)
    page.mouse.dblclick(box['x'] + 40, box['y'] + 40)
    page.wait_for_function(f'({RANGES})().simulation[0][1] === 3')
    assert page.evaluate(RANGES) == before


def test_buttons_and_keys_do_the_same(opened):
    page = opened()
    before = page.evaluate(RANGES)['recordings'][0]
    page.locator('[data-plot=recordings] button[title="zoom in"]').click()
    page.wait_for_function(f'({RANGES})().recordings[0][0] > {before[0]}')
    low, high = page.evaluate(RANGES)['recordings'][0]
    assert high - low == pytest.approx((before[1] - before[0]) / 1.6)
    page.locator('[data-plot=recordings]').focus()
    page.keyboard.press('ArrowRight')
    page.wait_for_function(f'({RANGES})().recordings[0][0] > {low}')
    page.keyboard.press('Home')
    page.wait_for_function(f'({RANGES})().recordings[0][1] === {before[1]}')


def test_values_are_read_where_the_mouse_is_and_the_rig_stands_so(opened):
    page = opened()
    box = over(page, 'recordings', 1)
    page.mouse.move(box['x'] + box['width'] / 4, box['y'] + 30)
    read = page.locator('[data-plot=recordings] .head').nth(1).locator('output')
    page.wait_for_function('() => document.querySelector("[data-plot=recordings] output").textContent')
    # The recording ends at 5.99 s, and its q1 is the sine of the time.
    assert float(read.inner_text().replace('−', '-')) == pytest.approx(0.997, abs=0.01)
    other = page.locator('[data-plot=simulation] .head').first.locator('output')
    assert float(other.first.inner_text()) == pytest.approx(0.997, abs=0.01)
    assert other.nth(1).inner_text() == '0.000'
    measured, simulated = page.evaluate('JSON.parse(document.querySelector(".rig canvas").dataset.poses)')
    assert measured[0] == pytest.approx(0.997, abs=0.01)
    assert simulated == [0, 0]


def test_the_rig_is_played_and_scrubbed(opened):
    page = opened()
    scrub = page.locator('.rig input')
    scrub.fill('1.5')
    assert page.locator('.rig output').inner_text() == '1.50 s'
    measured, _ = page.evaluate('JSON.parse(document.querySelector(".rig canvas").dataset.poses)')
    assert measured[0] == pytest.approx(0.9975, abs=0.001)
    painted = 'document.querySelector(".rig canvas").getContext("2d").getImageData(0, 0, 544, 544).data.some((v) => v)'
    assert page.evaluate(painted)
    page.locator('.rig button').click()
    page.wait_for_function('Number(document.querySelector(".rig input").value) > 1.6')
    page.locator('.rig button').click()
    assert page.locator('.rig button').inner_text() == '▶ play'


def test_light_and_dark(opened):
    """Figures are turned with the page, so that ink is on paper in both."""
    for scheme, turned in (('light', False), ('dark', True)):
        page = opened(color_scheme=scheme)
        paper, ink = (page.evaluate(BRIGHTNESS, ['body', what]) for what in ('backgroundColor', 'color'))
        assert (paper < 40 and ink > 200) if turned else (paper > 240 and ink < 40)
        for selector in ('figure img', '.plot canvas', '.rig canvas'):
            style = page.evaluate('(s) => getComputedStyle(document.querySelector(s)).filter', selector)
            assert ('invert' in style) == turned, selector


def test_on_paper_nothing_is_folded_nothing_is_to_be_pressed_and_it_is_light(opened):
    page = opened(color_scheme='dark')
    page.emulate_media(media='print')
    assert page.evaluate(BRIGHTNESS, ['body', 'backgroundColor']) > 240
    assert not any(each.is_visible() for each in page.locator('button, .rig, nav').all())
    assert all(each.is_visible() for each in page.locator('figure img, .plot canvas').all())
    page.evaluate('dispatchEvent(new Event("beforeprint"))')
    assert page.locator('.advice li').is_visible()
    assert page.evaluate('document.querySelector(".plot canvas").clientWidth') <= 680, 'the width of the paper'
    page.evaluate('dispatchEvent(new Event("afterprint"))')
    page.emulate_media(media='screen')
    assert not page.locator('.advice li').is_visible()


def test_without_javascript_the_figures_stand_there_and_plots_say_what_they_need(opened):
    page = opened(java_script_enabled=False)
    assert all(each.is_visible() for each in page.locator('figure img').all())
    assert not any(each.is_visible() for each in page.locator('.live').all())
    missing = page.locator('figure noscript p').all()
    assert page.locator('figure img').count() + len(missing) == 10
    assert all(each.is_visible() and 'report --figures' in each.inner_text() for each in missing)


@pytest.mark.parametrize('script', [True, False])
def test_on_a_telephone_nothing_is_wider_than_the_screen(opened, script):
    page = opened(viewport={'width': 400, 'height': 800}, java_script_enabled=script)
    assert page.evaluate('document.documentElement.scrollWidth') == 400


def test_what_became_of_parameters_is_explored_beside_what_happened(opened, tmp_path):
    rng = np.random.default_rng(1)
    values = 1 + 0.01 * rng.standard_normal((100, 9))
    states = [
        State(float(t), theta, np.full(9, 0.01 + 1 / (1 + t)), 0.0, 0.001, Level.OK, (), 0.1, True)
        for t, theta in enumerate(values)
    ]
    states[0] = states[0]._replace(std_error=np.full(9, np.inf))
    events = [Change(40.0, 41.0, 'payload on link 2', {'P2': (0.1, 0.01)}), Disturbance(60.0, 60.5)]
    table, happened = Table(['', 'value'], [['P1', '1 +- 0.1']]), [str(event) for event in events]
    file = write_track(OutputFolder(tmp_path / 'look'), (states, events), table, happened, ['day'], '')
    assert plot_track(states[:1], []).content.data()['panels'], 'of one state, too'
    page = opened(file)
    before = page.evaluate(RANGES)['track']
    assert len(before) == 10, 'nine parameters, and what is left unexplained'
    drag(page, over(page, 'track'), 0.25, 0.5)
    after = page.evaluate(RANGES)['track']
    assert all(panel == after[0] for panel in after)
    assert after[0][1] - after[0][0] == pytest.approx((before[0][1] - before[0][0]) / 4, rel=0.02)
    plot = json.loads(page.locator('#plots').text_content())['track']
    assert [(label, round(begin)) for begin, _, _, label in plot['spans']] == [('change', 40), ('disturbance', 60)]
    band = plot['panels'][0]['lines'][0]
    assert band['upper'][-1] - band['y'][-1] == pytest.approx(2 * NORMAL_95 * states[-1].std_error[0], rel=1e-3)
    assert 'payload on link 2, at 40.0 to 41.0 s' in page.inner_text('body')
