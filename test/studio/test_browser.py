# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The studio in a real browser: from a dropped file to a result, stopping, a telephone."""

import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml

from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import HANGING
from test.browser import NEEDS_BROWSER, accessible, watched
from test.conftest import SAMPLE
from test.identified import swing, written
from test.recordings.bags import csv
from test.studio.client import Studio

try:
    from playwright.sync_api import expect
except ImportError:
    expect = None

pytestmark = NEEDS_BROWSER
#: Drops a file on the page.
DROP = """({name, text}) => {
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([text], name));
  document.querySelector('.drop').dispatchEvent(new DragEvent('drop', {dataTransfer, bubbles: true, cancelable: true}));
}"""
#: A task may wait for others on a busy machine [ms].
LONG = 600_000
TELEPHONE = {'width': 360, 'height': 740}


@pytest.fixture(scope='module')
def studio():
    expect.set_options(timeout=LONG)
    with Studio() as program:
        yield program


@pytest.fixture
def opened(browser, studio):
    """Opens the studio; fails at the end for console messages or requests to other hosts."""
    with watched(browser) as shown:

        def opened(program=studio, **how):
            ours = 'data:', 'blob:', f'http://127.0.0.1:{program.port}/'
            return shown(program.address, ours, LONG, **{'viewport': {'width': 1440, 'height': 900}} | how)

        yield opened


def click(page, name):
    page.get_by_role('button', name=name, exact=True).click()


def choose(page, label, value):
    page.get_by_label(label, exact=True).select_option(value)


def look(page, heading):
    """Assert that a step fits a telephone and is accessible."""
    expect(page.get_by_role('heading', name=heading)).to_be_visible()
    expect(page.locator('.busy')).to_have_count(0)
    for summary in page.locator('details:not([open]) > summary').all():
        summary.click()
    assert page.evaluate('document.documentElement.scrollWidth') == TELEPHONE['width']
    accessible(page)


def test_a_german_csv_in_degrees_from_hanging_is_identified_by_mouse_alone(opened):
    names = 'Messzeit', 'Phi A', 'q2', 'tau1'
    text = csv(swing(), ';', ',', names, lambda q: np.degrees(q - HANGING))
    page = opened()
    page.get_by_text('Drop recordings here').wait_for()
    page.evaluate(DROP, {'name': 'Messung.csv', 'text': text})
    expect(page.get_by_text('Messung.csv')).to_be_visible()
    click(page, 'Continue')
    expect(page.get_by_role('alert')).to_contain_text("Messung.csv has no column 't' for t")
    expect(page.get_by_role('button', name='Continue')).to_be_disabled()
    choose(page, 'column of t', 'Messzeit')
    choose(page, 'column of q1', 'Phi A')
    click(page, 'Apply --decimal comma')
    expect(page.locator('.spark').first).to_be_visible()
    click(page, 'Continue')
    expect(page.locator('.checks')).to_contain_text('add --degrees')
    click(page, 'Correct the columns')
    choose(page, 'unit of q1', 'degrees')
    expect(page.locator('.spark').first).to_be_visible()
    click(page, 'Continue')
    conventions = page.locator('.checks li', has_text='Conventions')
    expect(conventions).to_contain_text('--zero hanging')
    click(page, 'Correct the columns')
    page.get_by_text('at rest it is 0°').click()
    click(page, 'Continue')
    expect(page.locator('.checks [aria-label=good]')).to_have_count(6)
    click(page, 'Continue')
    page.get_by_text('Weak form').click()
    click(page, 'Continue')
    click(page, 'Start')
    frame = page.frame_locator('iframe')
    expect(frame.locator('h1')).to_be_visible()
    frame.get_by_role('button', name='copy the command').click()
    expect(frame.get_by_role('button', name='copied')).to_be_visible()
    with page.expect_download() as download:
        page.get_by_role('link', name='result.yaml').click()
    found = yaml.safe_load(Path(download.value.path()).read_text())['parameters']
    for name in ('P1', 'P2', 'P4', 'P5', 'b1'):
        assert found[name]['value'] == pytest.approx(getattr(PAPER, name), rel=0.01)
    words = shlex.split(page.locator('.command code div').first.inner_text())
    assert {'--criterion=weak', '--decimal', '--degrees'} <= {*words}
    page.set_viewport_size(TELEPHONE)
    page.emulate_media(reduced_motion='reduce')
    look(page, 'The parameters of the rig')


def sample(page):
    click(page, 'Try the sample recording')
    for step in ('How is it written?', 'Is it good enough?', 'How is it fitted?'):
        click(page, 'Continue')
        expect(page.get_by_role('heading', name=step)).to_be_visible()


@pytest.fixture
def slow():
    """A studio without the compiled kernel, where a fit takes minutes."""
    with Studio(env={'PENDUBOT_KERNEL': 'off'}) as program:
        yield program


def test_stopping_a_fit_ends_its_process(slow, opened, tmp_path):
    page = opened(slow)
    sample(page)
    page.get_by_text('Hold, delay, length of link 1, bounds, seed').click()
    page.locator('#start').set_input_files(written(tmp_path / 'before.yaml', PAPER))
    expect(page.get_by_role('button', name='before.yaml')).to_be_visible()
    click(page, 'Continue')
    (worker,) = slow.children()
    click(page, 'Start')
    expect(page.locator('#fitting strong')).to_contain_text('likelihood')
    assert worker in slow.children()
    accessible(page)
    click(page, 'Stop')
    expect(page.get_by_text('Stopped. Nothing was kept.')).to_be_visible()
    while worker in slow.children():
        page.wait_for_timeout(10)
    expect(page.get_by_role('button', name='step 6: Result')).to_be_disabled()
    click(page, 'Start')
    expect(page.locator('#fitting strong')).to_contain_text('likelihood')
    click(page, 'Stop')


def test_every_step_fits_a_telephone_and_is_accessible(opened):
    """The step of the result: with the German file; the step of the fit: with the slow studio."""
    page = opened(viewport=TELEPHONE, reduced_motion='reduce')
    look(page, 'What was recorded?')
    page.evaluate(DROP, {'name': 'text.csv', 'text': 't,a\n0,1\n'})
    expect(page.get_by_text('text.csv')).to_be_visible()
    click(page, 'Try the sample recording')
    look(page, 'What was recorded?')
    click(page, 'Continue')
    expect(page.get_by_role('alert')).to_be_visible()
    look(page, 'How is it written?')
    click(page, 'Back')
    page.get_by_role('button', name='Remove').first.click()
    for heading in ('How is it written?', 'Is it good enough?', 'How is it fitted?', 'Ready'):
        click(page, 'Continue')
        look(page, heading)


def test_units_in_a_header_are_used_and_shown(opened):
    page = opened()
    page.get_by_text('Drop recordings here').wait_for()
    text = csv(swing(), names=('t', 'q1 [deg]', 'q2 [deg]', 'tau1'), convert=np.degrees)
    page.evaluate(DROP, {'name': 'run.csv', 'text': text})
    click(page, 'Continue')
    expect(page.get_by_text('Taken from the file itself:')).to_contain_text('--degrees')
    expect(page.get_by_label('unit of q1', exact=True)).to_have_value('true')


def test_the_folder_of_a_bag_can_be_dropped(opened):
    page = opened()
    box = page.locator('.drop').bounding_box()
    data = {'items': [], 'files': [str(SAMPLE)], 'dragOperationsMask': 1}
    mouse = {'x': box['x'] + 9, 'y': box['y'] + 9, 'data': data}
    devtools = page.context.new_cdp_session(page)
    for step in ('dragEnter', 'dragOver', 'drop'):
        devtools.send('Input.dispatchDragEvent', {'type': step, **mouse})
    expect(page.locator('.files strong')).to_have_text('paper_experiment')
    click(page, 'Continue')
    expect(page.get_by_label('topic', exact=True)).to_have_value('/joint_states')
