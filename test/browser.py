# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Pages in a real browser, for the tests of the report and the studio."""

import shutil
from contextlib import contextmanager

import pytest

try:
    from axe_playwright_python.sync_playwright import DEFAULT_OPTIONS, Axe
    from playwright.sync_api import sync_playwright
except ImportError:
    sync_playwright = None

CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser') or shutil.which('google-chrome')
NEEDS_BROWSER = [
    pytest.mark.skipif(CHROMIUM is None, reason='no Chromium: apt-get install chromium'),
    pytest.mark.skipif(sync_playwright is None, reason='no playwright or axe: pip install axe-playwright-python'),
]
BRIGHTNESS = """([selector, property]) => {
  const colour = getComputedStyle(document.querySelector(selector))[property];
  return colour.match(/\\d+/g).slice(0, 3).reduce((sum, part) => sum + Number(part), 0) / 3 }"""


@contextmanager
def watched(browser):
    """Yield a function that opens an address; fail on console messages and on requests to other hosts."""
    contexts, events = [], []

    def opened(address, own, timeout=120_000, **options):
        contexts.append(browser.new_context(**options))
        page = contexts[-1].new_page()
        page.set_default_timeout(timeout)
        page.on('console', lambda message: events.append(message.text))
        page.on('pageerror', lambda error: events.append(str(error)))
        page.on('request', lambda r: None if r.url.startswith(own) else events.append(r.url))
        page.goto(address)
        return page

    yield opened
    for context in contexts:
        context.close()
    assert events == []


def accessible(page):
    """Assert that axe-core has no serious findings; the dark scheme differs in colours alone."""
    for scheme, rules, passes in (('light', DEFAULT_OPTIONS, 11), ('dark', {'runOnly': ['color-contrast']}, 1)):
        page.emulate_media(color_scheme=scheme)
        response = Axe().run(page, options=rules).response
        assert len(response['passes']) >= passes
        assert [
            (scheme, each['id'], node['target'], node['failureSummary'])
            for each in response['violations']
            if each['impact'] in ('serious', 'critical')
            for node in each['nodes']
        ] == []
