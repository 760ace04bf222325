# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes for tests, and a simulated bag."""

import pytest

from pendubot_identification.cli.main import main
from test.rig import ENDLESS, Rig

#: Options of a fast identification.
FAST = {'criterion': 'weak', 'model': 'viscous', 'optimizer': 'lsq', 'hold': 'zero'}
#: Endless pulses without a pause.
PULSES = {'duration': 0.0, 'width': 1.0, 'amplitude_min': 0.1, 'amplitude_max': 0.2}


@pytest.fixture
def node(ros):
    node = ros.create_node('test_node')
    yield node
    node.destroy_node()


@pytest.fixture
def stranger(ros):
    """A node that publishes on topics that belong to another program."""
    node = ros.create_node('stranger', namespace='elsewhere')
    yield node
    node.destroy_node()


@pytest.fixture(scope='module')
def running_rig(ros, tmp_path_factory):
    """A rig that no timeout and no travel disarms during a test."""
    with Rig(tmp_path_factory.mktemp('rig'), 100) as rig:
        rig.start_board(*ENDLESS)
        rig.start_bridge('watchdog_ms:=5000', 'link_timeout:=5.0', 'command_timeout:=1.0')
        yield rig


@pytest.fixture
def shared_rig(running_rig):
    """The rig of a module, disarmed; its trace begins here."""
    running_rig.renew()
    return running_rig


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp('bags') / 'swing'
    assert main(['simulate', '--output', str(path)]) == 0
    return path
