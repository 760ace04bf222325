# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Arming over a network: programs in two network namespaces, as on two connected machines."""

import os
import subprocess

import pytest

from test.conftest import ROOT
from test.processes import Program, parameters, until

pytestmark = pytest.mark.ros
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
NAMES = 'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'
PROFILE = dict.fromkeys(NAMES, str(ROOT / 'config' / 'this_machine.xml'))
NO_PROFILE = dict.fromkeys(NAMES, '')
#: Arms the bridge; prints the answer, or that no bridge was found within some time [s].
ARM = """
import sys
import rclpy
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node('operator')
client = node.create_client(Trigger, '/bridge/arm')
if not client.wait_for_service(float(sys.argv[1])):
    print('found no bridge', flush=True)
    sys.exit()
future = client.call_async(Trigger.Request())
rclpy.spin_until_future_complete(node, future, timeout_sec=10.0)
print(future.result().message if future.done() else 'no answer', flush=True)
"""


@pytest.fixture
def machines():
    """Two network namespaces; yields the command prefixes for the rig's and for the other one."""
    rig, other = (f'pendubot{os.getpid()}{letter}' for letter in 'ab')
    plan = [
        *(f'netns add {name}' for name in (rig, other)),
        f'link add eth0 netns {rig} type veth peer name eth0 netns {other}',
        f'-n {rig} address add 10.99.0.1/24 dev eth0',
        f'-n {other} address add 10.99.0.2/24 dev eth0',
        *(f'-n {name} link set {device} up' for name in (rig, other) for device in ('lo', 'eth0')),
    ]
    try:
        try:
            for command in plan:
                subprocess.run(['ip', *command.split()], check=True, capture_output=True, text=True)
        except FileNotFoundError:
            pytest.skip('no program ip: install iproute2')
        except subprocess.CalledProcessError as error:
            pytest.skip(f'no right to make network namespaces: {error.stderr.strip()}')
        # Fast DDS ignores interfaces that come up later.
        for name in (rig, other):
            show = ['ip', '-n', name, 'link', 'show', 'eth0', 'up']
            until(lambda show=show: b'state UP' in subprocess.run(show, capture_output=True, check=True).stdout)
        yield [('ip', 'netns', 'exec', name) for name in (rig, other)]
    finally:
        for name in (rig, other):
            subprocess.run(['ip', 'netns', 'delete', name], capture_output=True, check=False)


def test_the_profile_prevents_arming_from_another_machine_and_permits_it_on_this_one(machines, tmp_path):
    """The profile works for any range; without it LOCALHOST does not exclude a machine with a static peer."""
    rig, other = machines
    script = tmp_path / 'arm.py'
    script.write_text(ARM)

    def answer(where, seconds, **env):
        with Program(script, seconds, env={**NO_PROFILE, **env}, before=where) as program:
            program.process.wait(seconds + 30)
            program.wait_for('')
            return program.lines[-1]

    with Program('virtual_board', '--link', tmp_path / 'board') as board:
        board.wait_for('virtual board on')

        def bridge(range_, profile):
            env = {RANGE: range_, **profile}
            options = parameters(port=tmp_path / 'board', confirm_zeros='false', link_timeout=2.0)
            program = Program('bridge', *options, env=env, before=rig)
            program.wait_for('counts per turn')
            return program

        outsider = {'ROS_STATIC_PEERS': '10.99.0.1', RANGE: 'SUBNET'}
        with bridge('LOCALHOST', NO_PROFILE):
            assert answer(other, 30, **outsider) == 'armed', 'the attack must work without the profile'
        with bridge('SUBNET', PROFILE) as kept:
            assert answer(other, 5, **outsider) == 'found no bridge'
            assert 'arming' not in kept.output
            for inside in ('SUBNET', 'LOCALHOST'):
                assert answer(rig, 30, **{RANGE: inside}) == 'armed'
