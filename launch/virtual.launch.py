# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The virtual rig: what rig.launch.py starts, with a simulated pendubot behind a pseudo-terminal. Nothing moves.

ros2 launch pendubot_identification virtual.launch.py rviz:=true
"""

from launch.substitutions import LaunchConfiguration

from pendubot_identification.launching import described, include

ARGUMENTS = {
    'port': ('/tmp/pendubot', 'the link to its pseudo-terminal that the virtual board makes'),
    'arm': (True, 'false: the exciter waits until you call /bridge/arm'),
}


def generate_launch_description():
    """Start the rig's programs on a virtual board; their other arguments are those of rig.launch.py."""
    own = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    rig = include('rig.launch.py', launch_arguments={'virtual': 'true', **own}.items())
    return described(ARGUMENTS, lambda given: [], rig)
