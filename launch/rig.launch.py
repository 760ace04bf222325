"""Bridge, recorder and exciter for a rig, or with virtual:=true for a virtual board in its place.

ros2 launch pendubot_identification rig.launch.py bridge:=bridge.yaml
ros2 launch pendubot_identification rig.launch.py bridge:=bridge.yaml excitation:=exciter.yaml rviz:=true
"""

import os

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    IncludeLaunchDescription,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from pendubot_identification.errors import ParameterError

PACKAGE = 'pendubot_identification'
ARGUMENTS = {
    'virtual': ('false', 'true: start a virtual board and talk to it instead of a rig'),
    'bridge': ('', "the bridge's parameter file, your copy of config/bridge.yaml; empty: the one of the package"),
    'port': ('', "the board's serial port; empty: the parameter file's, or with virtual:=true a link in /tmp"),
    'baud': ('', "baud rate of the port; empty: the parameter file's"),
    'output': ('', 'folder of the bag; empty: named after the time'),
    'arm': ('false', 'true: the exciter arms the motor by itself. Stand clear of the rig.'),
    'excitation': ('', "the exciter's parameter file, as pendubot excite writes it; empty: the arguments that follow"),
    'duration': ('18.0', 'length of the excitation [s]'),
    'amplitude': ('1.0', 'torques are drawn within plus and minus this [N m]'),
    'seed': ('1', 'same seed, same torques'),
    'view': ('true', 'whether robot_state_publisher describes the rig, for RViz: see view.launch.py'),
}


def parameter_file(program, given, argument):
    """Return the parameter file that is given or, where none is, the program's in the package.

    Raises:
        ParameterError: there is no such file. The launch library would warn, and start the program on its defaults.
    """
    path = os.path.expanduser(given)
    if given and not os.path.isfile(path):
        raise ParameterError(
            f'nothing was started: {argument} is {given}, and there is no such file; name a parameter file of {program}'
        )
    return path or PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', f'{program}.yaml'])


def programs(context):
    """Start bridge, recorder and exciter once the arguments are known; end everything once the excitation is over."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    given = {name: text.perform(context) for name, text in value.items()}

    def node(program, parameters, argument=''):
        file = parameter_file(program, given.get(argument, ''), argument)
        typed = {name: ParameterValue(text, value_type=kind) for name, (text, kind) in parameters.items()}
        return Node(
            package=PACKAGE,
            executable=program,
            name=program,
            output='screen',
            parameters=[file, typed],
        )

    virtual = IfCondition(value['virtual'])
    port = given['port']
    if not port and virtual.evaluate(context):
        # Not the port in the bridge's file: there a rig may be.
        port = '/tmp/pendubot'
    link = ({'port': (port, str)} if port else {}) | ({'baud': (value['baud'], int)} if given['baud'] else {})
    arm = {'arm': (value['arm'], bool)}
    train = {
        'duration': (value['duration'], float),
        'amplitude_min': (PythonExpression(['-abs(', value['amplitude'], ')']), float),
        'amplitude_max': (PythonExpression(['abs(', value['amplitude'], ')']), float),
        'seed': (value['seed'], int),
    }
    exciter = node('exciter', arm if given['excitation'] else arm | train, 'excitation')
    return [
        Node(
            package=PACKAGE,
            executable='virtual_board',
            output='screen',
            arguments=['--link', port],
            condition=virtual,
        ),
        node('bridge', link, 'bridge'),
        node('recorder', {'output': (value['output'], str)}),
        exciter,
        RegisterEventHandler(OnProcessExit(target_action=exciter, on_exit=[EmitEvent(event=Shutdown())])),
    ]


def generate_launch_description():
    """Start everything; a file that is given and is not there is refused before that."""
    view = PathJoinSubstitution([FindPackageShare(PACKAGE), 'launch', 'view.launch.py'])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=programs),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(view), condition=IfCondition(LaunchConfiguration('view'))
            ),
        ]
    )
