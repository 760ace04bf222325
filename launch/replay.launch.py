# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A bag played again, and shown: what a rig did, without the rig. It ends with the bag.

ros2 launch pendubot_identification replay.launch.py bag:=swing rviz:=true
"""

from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration

from pendubot_identification.launching import described, include, program

ARGUMENTS = {
    'bag': ('', 'folder of the bag, or its .mcap file; BAG@START:END: these seconds of it'),
    'rate': (1.0, 'times real time'),
    'view': (True, 'whether robot_state_publisher describes the rig, for RViz: see view.launch.py'),
}


def start(given):
    """Return the player."""
    return [program('player', {name: given[name] for name in ('bag', 'rate')})]


def generate_launch_description():
    """Play, and describe the rig."""
    return described(ARGUMENTS, start, include('view.launch.py', condition=IfCondition(LaunchConfiguration('view'))))
