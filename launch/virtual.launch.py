"""The virtual rig: what rig.launch.py starts, with a simulated pendubot behind a pseudo-terminal. Nothing moves.

ros2 launch pendubot_identification virtual.launch.py rviz:=true
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    'port': ('/tmp/pendubot', 'the link to its pseudo-terminal that the virtual board makes'),
    'arm': ('true', 'false: the exciter waits until you call /bridge/arm'),
}


def generate_launch_description():
    """Start the rig's programs on a virtual board; their other arguments are those of rig.launch.py."""
    rig = PathJoinSubstitution([FindPackageShare('pendubot_identification'), 'launch', 'rig.launch.py'])
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(rig),
                launch_arguments={'virtual': 'true', 'port': value['port'], 'arm': value['arm']}.items(),
            ),
        ]
    )
