"""The rig as a picture that moves: robot_state_publisher, and RViz and PlotJuggler where wanted.

ros2 launch pendubot_identification view.launch.py rviz:=true l1:=0.2 l2:=0.3
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from pendubot_identification.results.robot_description import robot_description

PACKAGE = 'pendubot_identification'
ARGUMENTS = {
    'l1': ('0.2', 'length of link 1, from shoulder to elbow, as it is drawn [m]'),
    'l2': ('0.2', 'length of link 2, from elbow to tip, as it is drawn [m]'),
    'rviz': ('false', 'true: start RViz (package rviz2)'),
    'plotjuggler': ('false', 'true: start PlotJuggler (package plotjuggler_ros); choose Start, then OK'),
}


def describe(context):
    """Fill the lengths into the description once they are known."""
    l1, l2 = (float(LaunchConfiguration(name).perform(context)) for name in ('l1', 'l2'))
    description = {'robot_description': robot_description(l1, l2)}
    return [Node(package='robot_state_publisher', executable='robot_state_publisher', parameters=[description])]


def generate_launch_description():
    """Publish /robot_description and /tf; show them where wanted."""

    def config(name):
        return PathJoinSubstitution([FindPackageShare(PACKAGE), 'config', name])

    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=describe),
            Node(
                package='rviz2',
                executable='rviz2',
                arguments=['-d', config('pendubot.rviz')],
                condition=IfCondition(LaunchConfiguration('rviz')),
            ),
            Node(
                package='plotjuggler',
                executable='plotjuggler',
                arguments=['--layout', config('plotjuggler.xml')],
                condition=IfCondition(LaunchConfiguration('plotjuggler')),
            ),
        ]
    )
