"""The demonstration is alone, ends what it started, and says at once what went wrong."""

import os
import re
import subprocess
import sys

import pytest

ELSEWHERE = {
    'ROS_DOMAIN_ID': '77',
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
    'ROS_STATIC_PEERS': '192.0.2.1',
    'ROS_LOCALHOST_ONLY': '0',
    'FASTDDS_DEFAULT_PROFILES_FILE': '/nowhere.xml',
}
OWN = """
import os, subprocess, sys
from pendubot_identification.cli.main import main
from pendubot_identification.cli.programs import own_ros
with own_ros(domains={domains}) as (rclpy, domain):
    assert rclpy.get_default_context().get_domain_id() == domain
    assert os.environ['ROS_DOMAIN_ID'] == str(domain), 'the programs that it starts are there, too'
    assert os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'
    assert not {others} & set(os.environ)
    print(domain)
"""


def own(domains=(), **environment):
    """Let a process of its own choose a domain."""
    others = set(ELSEWHERE) - {'ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE'}
    return subprocess.run(
        [sys.executable, '-c', OWN.format(domains=domains, others=others)],
        env={**os.environ, **ELSEWHERE, **environment},
        capture_output=True,
        text=True,
        timeout=60,
    )


@pytest.fixture
def taken(ros):
    """The domain of somebody else's bridge."""
    node = ros.create_node('bridge')
    yield int(os.environ['ROS_DOMAIN_ID'])
    node.destroy_node()


@pytest.mark.ros
def test_a_domain_where_somebody_is_or_that_was_exported_is_never_used(taken):
    free = taken % 100 + 1
    chosen = own((taken, 77 if free != 77 else 78, free), ROS_DOMAIN_ID=str(77 if free != 77 else 78))
    assert chosen.stdout.split() == [str(free)], chosen.stderr
    refused = own((taken,))
    assert refused.returncode == 1
    assert re.search(rf'other ROS programs are in each of the domains {taken}, .* nothing was armed', refused.stderr)
