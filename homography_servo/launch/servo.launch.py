"""
Start the nodes of a configuration with ``ros2 launch``; does the same as bringup.

Example: ros2 launch homography_servo servo.launch.py config:=sim.yaml
"""

from homography_servo.launch.config import read_config
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.actions import OpaqueFunction
from launch.actions import SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = (
    ('config', 'sim.yaml', 'a path or an installed name: sim.yaml, real.yaml, teabox.yaml'),
    ('namespace', '', 'namespace of all nodes'),
    ('dashboard', 'false', 'also start the dashboard, a page in the browser'),
    ('use_sim_time', 'false', 'use the clock of a simulation'),
    ('log_level', 'info', 'debug, info, warn, error or fatal'),
)


def nodes_of(context):
    """Make one action per node of the configuration, once the arguments are known."""
    values = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    config, errors = read_config(values['config'])
    if errors:
        raise RuntimeError('\n'.join(str(error) for error in errors))
    if values['dashboard'].lower() == 'true':
        config = config.including(['dashboard'])
    sim_time = values['use_sim_time'].lower() == 'true'
    return [Node(package='homography_servo', executable=name, name=name,
                 namespace=values['namespace'], output='screen', emulate_tty=True,
                 respawn=name != 'video_camera', respawn_delay=1.0, respawn_max_retries=3,
                 parameters=[{'use_sim_time': sim_time,
                              **{k: v for k, v in config.values(name).items() if v != []}}],
                 arguments=['--ros-args', '--log-level', values['log_level']])
            for name in config.nodes]


def generate_launch_description():
    """Declare the arguments and start the nodes."""
    reach = EnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', default_value='LOCALHOST')
    arguments = [DeclareLaunchArgument(name, default_value=value, description=text)
                 for name, value, text in ARGUMENTS]
    return LaunchDescription([
        *arguments, SetEnvironmentVariable('ROS_AUTOMATIC_DISCOVERY_RANGE', reach),
        OpaqueFunction(function=nodes_of)])
