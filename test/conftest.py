# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What every test shares: a private ROS domain, temporary logs, and where the real recordings lie, if they do."""

import importlib.util
import os
import signal
import tempfile
from pathlib import Path

import hypothesis
import pytest

from test.domain import take_domain

# Before anything imports rclpy: tests must neither hear nor disturb other ROS programs on this machine, nor each other
# where several processes run them.
take_domain()
os.environ['RMW_IMPLEMENTATION'] = 'rmw_fastrtps_cpp'
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SYSTEM_DEFAULT'  # as the profile says
os.environ.setdefault('ROS_LOG_DIR', tempfile.mkdtemp(prefix='pendubot-test-log-'))
# By its name of Jazzy, and the one since.
for name in ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'):
    os.environ[name] = str(Path(__file__).with_name('discovery.xml'))

# Where the tests themselves were started by nohup or in the background, the programs that they start are not.
signal.signal(signal.SIGHUP, lambda *_: None)
signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples at every run where nobody watches; new ones at every run by hand. Speed is not a property.
hypothesis.settings.register_profile('ci', derandomize=True, deadline=None)
hypothesis.settings.register_profile('hand', deadline=None)
hypothesis.settings.load_profile(os.environ.get('HYPOTHESIS_PROFILE', 'ci' if os.environ.get('CI') else 'hand'))

#: These import it.
ROS_ALONE = ['nodes/test_*', 'firmware/test_bridge.py', 'test_fault_trials.py']
collect_ignore_glob = [] if importlib.util.find_spec('rclpy') else ROS_ALONE

ROOT = Path(__file__).resolve().parent.parent
RECORDINGS = ROOT.parent / 'shared' / 'recordings'


def pytest_collection_modifyitems(items):
    """A test that needs the real recordings is skipped, and says so, where they are not."""
    if not (RECORDINGS / 'manifest.csv').exists():
        for item in items:
            if item.get_closest_marker('recordings'):
                item.add_marker(pytest.mark.skip(reason=f'no real recordings in {RECORDINGS}'))


@pytest.fixture(scope='session')
def ros():
    """An initialised rclpy, for tests with a node of their own."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    # A signal that a test raises here is not to shut it down for those that follow.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    # Or between two tests a demo would find this domain empty, and take it.
    node = rclpy.create_node('tests')
    yield rclpy
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def run(capsys):
    """Runs pendubot; returns its exit status, what it printed and what it said on stderr."""
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
    """Runs pendubot, which is to end with this status and one line, no traceback, nothing printed; returns the line."""

    def refused(*arguments, status=1):
        ended, out, err = run(*arguments)
        assert (ended, out) == (status, '')
        line = err.strip().splitlines()[-1]
        assert line.startswith('pendubot')
        assert 'Traceback' not in err
        return line

    return refused


@pytest.fixture(params=['python', 'c'])
def each_board(request, monkeypatch):
    """Each board in turn, in Python and in C; what is started as ``virtual_board`` is that one.

    Only Python's begins elsewhere than hanging (--start, --spread), is late (--delay), has another rig's parameters
    (--parameters) or waits for its computer (--patient): no test of the bridge needs that, but those of nodes that
    swing up do. Trials that drive Python's board without a port need no second one: the same bytes at the same times
    give the same frames (test/firmware/test_ownership.py).
    """
    from test import processes

    if request.param == 'c':
        from test.firmware.building import made, need

        need('cc', 'gcc')
        made('host')
    monkeypatch.setitem(processes.MODULES, 'virtual_board', processes.BOARDS[request.param])


@pytest.fixture
def rig(ros, tmp_path):
    """Makes live rigs, and ends them."""
    from test.rig import Rig

    rigs = []

    def make(rate=100, *board_options):
        rigs.append(Rig(tmp_path, rate, *board_options))
        return rigs[-1]

    yield make
    for each in rigs:
        each.close()
