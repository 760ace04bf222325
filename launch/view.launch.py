# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The animated view of the rig: robot_state_publisher, and optionally RViz and PlotJuggler.

The end of one of these programs ends no other program, so recordings and motion do not depend on the view.

ros2 launch pendubot_identification view.launch.py rviz:=true l1:=0.2 l2:=0.3
ros2 launch pendubot_identification view.launch.py rviz:=true parameters:=result.yaml
"""

import re
from pathlib import Path

from pendubot_identification.formats.export import export
from pendubot_identification.formats.robots import drawn
from pendubot_identification.launching import Program, described
from pendubot_identification.resources import resource
from pendubot_identification.results.result import read_result

ARGUMENTS = {
    'l1': (0.2, 'drawn length of link 1, from shoulder to elbow [m]'),
    'l2': (0.2, 'drawn length of link 2, from elbow to tip [m]'),
    'parameters': ('', 'a result file: show the rig of pendubot export --format urdf instead of l1 and l2'),
    'rviz': (False, 'true: start RViz (package rviz2)'),
    'plotjuggler': (False, 'true: start PlotJuggler (package plotjuggler_ros); choose Start, then OK'),
}
#: The same arguments for launch files that also start other programs.
OPTIONAL = {
    'view': (True, 'whether robot_state_publisher publishes the description of the rig for RViz, see view.launch.py'),
    **ARGUMENTS,
}


def start(args):
    """Return the programs that publish /robot_description and /tf, and the viewers."""

    def shown(name, option, **fields):
        package = f'ros-$ROS_DISTRO-{name.replace("_", "-")}'
        return Program(name, package=name, remedy=f'sudo apt install {package}, or set {option}:=false', **fields)

    if not args.get('view', True):
        return []
    urdf = drawn(args['l1'], args['l2'])
    if args['parameters']:
        urdf, _ = export(read_result(Path(args['parameters'])), 'urdf')
    urdf = urdf.replace('</robot>', f'{args.get("hardware", "")}</robot>')
    publishers = [shown('robot_state_publisher', 'view', parameters=({'robot_description': urdf},))]
    if args.get('ghost'):
        # The ghost has the same base but its own links; RViz shows it as a second robot.
        urdf = re.sub('"(link_.|tip)"', r'"ghost_\1"', urdf)
        topics = tuple((topic, f'ghost/{topic}') for topic in ('joint_states', 'robot_description'))
        fields = {'parameters': ({'robot_description': urdf},), 'node': 'ghost_state_publisher', 'remappings': topics}
        publishers.append(shown('robot_state_publisher', 'view', **fields))
    rviz = '-d', str(resource('config/pendubot.rviz'))
    plotjuggler = '--layout', str(resource('config/plotjuggler.xml'))
    return [
        *publishers,
        *([shown('rviz2', 'rviz', arguments=rviz)] if args['rviz'] else []),
        *([shown('plotjuggler', 'plotjuggler', arguments=plotjuggler)] if args['plotjuggler'] else []),
    ]


def generate_launch_description():
    """Start the view of the rig."""
    return described(ARGUMENTS, start)
