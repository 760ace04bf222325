# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Controllers of ros2_control on a rig, or with virtual:=true on a virtual board, and a recorder.

ros2 launch pendubot_identification control.launch.py virtual:=true
ros2 launch pendubot_identification control.launch.py bridge:=bridge.yaml controllers:=mine.yaml controller:=balancer

The rig moves only after you call /bridge/arm.
"""

import os

from pendubot_identification.errors import ParameterError
from pendubot_identification.launching import Program, described, is_installed, launch_file
from pendubot_identification.resources import resource

RIG = launch_file('rig.launch.py')
ARGUMENTS = {
    **{name: RIG['ARGUMENTS'][name] for name in ('virtual', 'bridge', 'port', 'baud', 'output')},
    'controllers': ('', 'parameter file of the controllers; empty: config/controllers.yaml of the package'),
    'controller': (['effort_controller'], 'name of the controller to start, or a list of names'),
    **RIG['VIEW']['OPTIONAL'],
}
#: The packages of ros2_control.
PACKAGES = 'controller_manager', 'joint_state_broadcaster', 'joint_state_topic_hardware_interface'
REMEDY = 'sudo apt install ros-$ROS_DISTRO-ros2-control ros-$ROS_DISTRO-ros2-controllers '
REMEDY += 'ros-$ROS_DISTRO-joint-state-topic-hardware-interface'


def start(args):
    """Return the programs of the rig without the exciter, and the programs of ros2_control."""
    file = args['controllers'] or str(resource('config/controllers.yaml'))
    if not os.path.isfile(file):
        raise ParameterError(
            f'controllers is {args["controllers"]}, and there is no such file; name a parameter file of controllers'
        )
    for package in PACKAGES:
        if not is_installed(package):
            raise ParameterError(f'{package} is not installed; {REMEDY}')
    if not args['view']:
        raise ParameterError('view is false, and controller_manager needs the description of the rig; leave view out')
    element = resource('config/ros2_control.urdf.xacro').read_text()
    element = element[element.index('<ros2_control') : element.index('</robot>')]
    defaults = {name: default for name, (default, _) in RIG['ARGUMENTS'].items()}
    more = {'hardware': element, 'recorder': {'topics': ['joint_states', 'pendubot/joint_commands']}}
    manager = {'package': 'controller_manager', 'remedy': REMEDY}
    return [
        *(program for program in RIG['start'](defaults | args | more) if program.name != 'exciter'),
        Program('ros2_control_node', (file,), **manager),
        Program('spawner', arguments=('joint_state_broadcaster', *args['controller'], '--param-file', file), **manager),
    ]


def generate_launch_description():
    """Start all programs, and end them when a program of this package ends."""
    return described(ARGUMENTS, start)
