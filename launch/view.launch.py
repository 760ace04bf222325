# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The rig as a picture that moves: robot_state_publisher, and RViz and PlotJuggler where wanted.

Closing one of them ends nothing else: neither a recording nor the motion of a rig depends on who watches.

ros2 launch pendubot_identification view.launch.py rviz:=true l1:=0.2 l2:=0.3
ros2 launch pendubot_identification view.launch.py rviz:=true parameters:=result.yaml
"""

import re
from pathlib import Path

from pendubot_identification.formats.export import export
from pendubot_identification.formats.robots import drawn
from pendubot_identification.launching import Program, described
from pendubot_identification.resources import resource
from pendubot_identification.results.result_file import read_result

ARGUMENTS = {
    'l1': (0.2, 'length of link 1, from shoulder to elbow, as it is drawn [m]'),
    'l2': (0.2, 'length of link 2, from elbow to tip, as it is drawn [m]'),
    'parameters': ('', 'a result file: show the rig that pendubot export --format urdf makes of it, not l1 and l2'),
    'rviz': (False, 'true: start RViz (package rviz2)'),
    'plotjuggler': (False, 'true: start PlotJuggler (package plotjuggler_ros); choose Start, then OK'),
}
#: The same in a launch file that starts other programs, too.
OPTIONAL = {
    'view': (True, 'whether robot_state_publisher describes the rig, for RViz: see view.launch.py'),
    **ARGUMENTS,
}


def start(given):
    """Return the programs that publish /robot_description and /tf, and those that show them."""

    def shown(name, option, **how):
        package = f'ros-$ROS_DISTRO-{name.replace("_", "-")}'
        return Program(name, package=name, remedy=f'sudo apt install {package}, or give {option}:=false', **how)

    if not given.get('view', True):
        return []
    urdf = drawn(given['l1'], given['l2'])
    if given['parameters']:
        urdf, _ = export(read_result(Path(given['parameters'])), 'urdf')
    urdf = urdf.replace('</robot>', f'{given.get("hardware", "")}</robot>')
    publishers = [shown('robot_state_publisher', 'view', parameters=({'robot_description': urdf},))]
    if given.get('ghost'):
        # On the same base, with links of its own; RViz shows it as a second robot.
        urdf = re.sub('"(link_.|tip)"', r'"ghost_\1"', urdf)
        topics = tuple((topic, f'ghost/{topic}') for topic in ('joint_states', 'robot_description'))
        how = {'parameters': ({'robot_description': urdf},), 'node': 'ghost_state_publisher', 'remappings': topics}
        publishers.append(shown('robot_state_publisher', 'view', **how))
    rviz = '-d', str(resource('config/pendubot.rviz'))
    plotjuggler = '--layout', str(resource('config/plotjuggler.xml'))
    return [
        *publishers,
        *([shown('rviz2', 'rviz', arguments=rviz)] if given['rviz'] else []),
        *([shown('plotjuggler', 'plotjuggler', arguments=plotjuggler)] if given['plotjuggler'] else []),
    ]


def generate_launch_description():
    """Describe the rig, and show it."""
    return described(ARGUMENTS, start)
