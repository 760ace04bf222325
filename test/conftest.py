# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Common settings and fixtures: a private ROS domain, temporary logs, and the folder of real recordings."""

import contextlib
import importlib.util
import os
import signal
import tempfile
from pathlib import Path

import hypothesis
import pytest

from test.domain import take_domain

# Before any import of rclpy: isolates tests from other ROS programs on this machine and from parallel test processes.
take_domain()
os.environ['RMW_IMPLEMENTATION'] = 'rmw_fastrtps_cpp'
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SYSTEM_DEFAULT'  # as the profile says
logs = tempfile.TemporaryDirectory(prefix='pendubot-test-log-', ignore_cleanup_errors=True)  # removed at the end
os.environ.setdefault('ROS_LOG_DIR', logs.name)
# The variable's name in Jazzy, and its later name.
for name in ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'):
    os.environ[name] = str(Path(__file__).with_name('discovery.xml'))

# Programs under test must not inherit ignored signals if the tests run with nohup or in the background.
signal.signal(signal.SIGHUP, lambda *_: None)
signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples at every run in CI, new ones in other runs; no deadline, because speed is not tested.
hypothesis.settings.register_profile('ci', derandomize=True, deadline=None)
hypothesis.settings.register_profile('hand', deadline=None)
hypothesis.settings.load_profile(os.environ.get('HYPOTHESIS_PROFILE', 'ci' if os.environ.get('CI') else 'hand'))

#: Tests that import rclpy.
NEED_ROS = ['nodes/test_*', 'test_fault_trials.py']
collect_ignore_glob = [] if importlib.util.find_spec('rclpy') else NEED_ROS

ROOT = Path(__file__).resolve().parent.parent
#: A bag of the paper's rig in simulation.
SAMPLE = ROOT / 'bags' / 'paper_experiment'
RECORDINGS = ROOT.parent / 'shared' / 'recordings'


def pytest_collection_modifyitems(items):
    """Begin with the longest tests and fixtures; skip tests that need the real recordings if they are absent."""
    rooms = 'test', 'tracking'
    items.sort(key=lambda item: item.path.parent.name not in rooms)
    absent = not (RECORDINGS / 'manifest.csv').exists()
    for item in items:
        if item.path.parent.name == 'nodes':
            item.add_marker('ros')
        if absent and item.get_closest_marker('recordings'):
            item.add_marker(pytest.mark.skip(reason=f'no real recordings in {RECORDINGS}'))


@pytest.fixture(scope='session')
def ros():
    """The initialised module rclpy."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    # A signal that a test raises must not shut rclpy down for later tests.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    # Without a node a demo could take this domain between two tests.
    node = rclpy.create_node('tests')
    yield rclpy
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def run(capsys):
    """Runs pendubot; returns its exit status, stdout and stderr."""
    from pendubot_identification.cli.main import main

    def run(*arguments):
        capsys.readouterr()
        try:
            status = main([*map(str, arguments)])
        except SystemExit as stopped:
            status = stopped.code
        return status, *capsys.readouterr()

    return run


@pytest.fixture
def refused(run):
    """Runs pendubot, asserts this status, empty stdout and no traceback; returns the last line of stderr."""

    def refused(*arguments, status=1):
        ended, out, err = run(*arguments)
        assert (ended, out) == (status, '')
        line = err.strip().splitlines()[-1]
        assert line.startswith('pendubot')
        assert 'Traceback' not in err
        return line

    return refused


@pytest.fixture(scope='module')
def browser():
    """Chromium, driven by playwright."""
    from test.browser import CHROMIUM, sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        yield browser
        browser.close()


@pytest.fixture(params=['python', 'c'])
def each_board(request, monkeypatch):
    """Run a test with ``virtual_board`` in Python and in C.

    Only the board in Python has the options --start, --spread, --delay, --parameters and --patient, which tests of the
    balancer need. Both give the same frames for the same bytes (test/firmware/test_ownership.py).
    """
    from test import processes

    if request.param == 'c':
        from test.firmware.building import made, need

        need('cc', 'gcc')
        made('host')
    monkeypatch.setitem(processes.MODULES, 'virtual_board', processes.BOARDS[request.param])


@pytest.fixture
def rig(ros, tmp_path):
    """Makes live rigs and closes them."""
    from test.rig import Rig

    with contextlib.ExitStack() as rigs:

        def make(rate=100, *board_options):
            return rigs.enter_context(Rig(tmp_path, rate, *board_options))

        yield make
