"""The identifier: parameters from bags, latched on /pendubot/params.

ros2 launch pendubot_identification identification.launch.py bags:="['swing']" output:=result.yaml
"""

from typing import List  # noqa: UP035  (launch_ros of Jazzy knows the parameter types by this name)

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'pendubot_identification'
ARGUMENTS = {
    'bags': ("['']", 'bags that estimate, each BAG or BAG@START:END, as a list: "[\'swing@0:9\']"'),
    'validate': ("['']", 'bags that only judge, likewise'),
    'criterion': ('', 'some of energy, weak, trajectory, with commas between them; empty: all'),
    'model': ('auto', 'viscous, coulomb, rotor, geared, or auto'),
    'output': ('', 'result file to write; empty: none'),
    'force': ('false', 'true: overwrite an existing result file'),
}


def generate_launch_description():
    """Identify, publish, and stay, so that whoever joins later receives the parameters, too."""
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    texts = List[str]  # noqa: UP006
    types = {'bags': texts, 'validate': texts, 'criterion': str, 'model': str, 'output': str, 'force': bool}
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            Node(
                package=PACKAGE,
                executable='identifier',
                name='identifier',
                output='screen',
                parameters=[
                    PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', 'identifier.yaml']),
                    {name: ParameterValue(value[name], value_type=kind) for name, kind in types.items()},
                ],
            ),
        ]
    )
