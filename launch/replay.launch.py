"""A bag played again, and shown: what a rig did, without the rig.

ros2 launch pendubot_identification replay.launch.py bag:=swing rviz:=true
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'pendubot_identification'
ARGUMENTS = {
    'bag': ('', 'folder of the bag, or its .mcap file; BAG@START:END: these seconds of it'),
    'rate': ('1.0', 'times real time'),
    'view': ('true', 'whether robot_state_publisher describes the rig, for RViz: see view.launch.py'),
}


def generate_launch_description():
    """Play, and describe the rig."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    types = {'bag': str, 'rate': float}
    view = PathJoinSubstitution([FindPackageShare(PACKAGE), 'launch', 'view.launch.py'])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            Node(
                package=PACKAGE,
                executable='player',
                name='player',
                output='screen',
                parameters=[{name: ParameterValue(value[name], value_type=kind) for name, kind in types.items()}],
            ),
            IncludeLaunchDescription(PythonLaunchDescriptionSource(view), condition=IfCondition(value['view'])),
        ]
    )
