"""Bridge, recorder and exciter for a rig, or with virtual:=true for a virtual board in its place.

ros2 launch pendubot_identification rig.launch.py port:=/dev/pendubot
ros2 launch pendubot_identification rig.launch.py excitation:=exciter.yaml rviz:=true
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, IncludeLaunchDescription, RegisterEventHandler
from launch.conditions import IfCondition, UnlessCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'pendubot_identification'
ARGUMENTS = {
    'virtual': ('false', 'true: start a virtual board and talk to it instead of a rig'),
    'port': ('/dev/pendubot', "the board's serial port; with virtual:=true, the link that the virtual board makes"),
    'baud': ('921600', 'baud rate of the port'),
    'output': ('', 'folder of the bag; empty: named after the time'),
    'arm': ('false', 'true: the exciter arms the motor by itself. Stand clear of the rig.'),
    'excitation': ('', "the exciter's parameter file, as pendubot excite writes it; empty: the arguments that follow"),
    'duration': ('18.0', 'length of the excitation [s]'),
    'amplitude': ('1.0', 'torques are drawn within plus and minus this [N m]'),
    'seed': ('1', 'same seed, same torques'),
    'view': ('true', 'whether robot_state_publisher describes the rig, for RViz: see view.launch.py'),
}


def generate_launch_description():
    """Start everything; end everything once the excitation is over."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    share = FindPackageShare(PACKAGE)

    def node(program, *files, condition=None, **parameters):
        config = PathJoinSubstitution([share, 'config', f'{program}.yaml'])
        typed = {name: ParameterValue(text, value_type=kind) for name, (text, kind) in parameters.items()}
        return Node(
            package=PACKAGE,
            executable=program,
            name=program,
            output='screen',
            parameters=[config, *files, typed],
            condition=condition,
        )

    designed = PythonExpression(["'", value['excitation'], "' != ''"])
    exciters = [
        node('exciter', value['excitation'], arm=(value['arm'], bool), condition=IfCondition(designed)),
        node(
            'exciter',
            arm=(value['arm'], bool),
            duration=(value['duration'], float),
            amplitude_min=(PythonExpression(['-abs(', value['amplitude'], ')']), float),
            amplitude_max=(PythonExpression(['abs(', value['amplitude'], ')']), float),
            seed=(value['seed'], int),
            condition=UnlessCondition(designed),
        ),
    ]
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            Node(
                package=PACKAGE,
                executable='virtual_board',
                output='screen',
                arguments=['--link', value['port']],
                condition=IfCondition(value['virtual']),
            ),
            node('bridge', port=(value['port'], str), baud=(value['baud'], int)),
            node('recorder', output=(value['output'], str)),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(PathJoinSubstitution([share, 'launch', 'view.launch.py'])),
                condition=IfCondition(value['view']),
            ),
            *exciters,
            *(
                RegisterEventHandler(OnProcessExit(target_action=exciter, on_exit=[EmitEvent(event=Shutdown())]))
                for exciter in exciters
            ),
        ]
    )
