"""The nodes as programs, on a computer without ROS."""

import subprocess
import sys

import pytest

CHILD = """
import sys
# Named so, a module is not found.
sys.modules.update(dict.fromkeys(sys.argv.pop(1).split()))
from pendubot_identification import programs
sys.exit(getattr(programs, sys.argv.pop(1))())
"""


@pytest.mark.parametrize('program', ['bridge', 'recorder', 'player', 'identifier', 'exciter', 'balancer'])
@pytest.mark.parametrize('missing', ['rclpy', 'rclpy diagnostic_msgs std_msgs rcl_interfaces sensor_msgs std_srvs'])
def test_a_node_without_ros_says_so_in_a_sentence(program, missing):
    ended = subprocess.run([sys.executable, '-c', CHILD, missing, program], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 1
    (sentence,) = ended.stderr.splitlines()
    assert sentence.startswith(f'{program}: ')
    assert 'needs ROS 2' in sentence
    assert "pip install '.[ros]'" in sentence


def test_what_is_wrong_with_the_package_itself_is_not_blamed_on_ros():
    missing = 'pendubot_identification.nodes.runtime'
    ended = subprocess.run([sys.executable, '-c', CHILD, missing, 'bridge'], capture_output=True, text=True, timeout=60)
    assert 'Traceback' in ended.stderr
    assert missing in ended.stderr


def test_the_virtual_board_needs_no_ros():
    arguments = [sys.executable, '-c', CHILD, 'rclpy', 'virtual_board', '--help']
    ended = subprocess.run(arguments, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0
    assert 'virtual_board' in ended.stdout
