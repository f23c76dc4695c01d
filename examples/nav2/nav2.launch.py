"""Bring up Nav2 for the simulated Jackal: `ros2 launch examples/nav2/nav2.launch.py controller:=mppi map:=false`.

Starts the servers, their lifecycle manager and `nav2_trial`, by which the evaluator gives each trial a fresh Nav2.
The simulator publishes /scan, /odom, /clock and all transforms; the evaluator publishes /goal_pose and, where the
protocol has one, /map. If one of the processes ends, all do, so that whoever supervises the launch hears of it.
"""

import sys
from pathlib import Path

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

HERE = Path(__file__).resolve().parent
CONTROLLERS = ("dwb", "graceful", "mppi", "rpp")
MANAGER = "lifecycle_manager_navigation"
# package, executable, which is its name too, and remappings; commands go from controller and behaviours to the velocity
# smoother, from there to the collision monitor and on to cmd_vel
SERVERS = (
    ("nav2_controller", "controller_server", {"cmd_vel": "cmd_vel_nav"}),
    ("nav2_planner", "planner_server", {}),
    ("nav2_behaviors", "behavior_server", {"cmd_vel": "cmd_vel_nav"}),
    ("nav2_velocity_smoother", "velocity_smoother", {"cmd_vel": "cmd_vel_nav"}),
    ("nav2_collision_monitor", "collision_monitor", {}),
    ("nav2_bt_navigator", "bt_navigator", {}),
)


def generate_launch_description():
    """Return the servers with their arguments."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "controller",
                default_value="mppi",
                choices=CONTROLLERS,
                description="local planner",
            ),
            DeclareLaunchArgument(
                "map",
                default_value="false",
                choices=["true", "false"],
                description="plan on a map",
            ),
            DeclareLaunchArgument(
                "stamped",
                default_value="false",
                choices=["true", "false"],
                description="send TwistStamped, not Twist",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="true",
                description="take the time from /clock",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value="",
                description="more parameters, which count most",
            ),
            DeclareLaunchArgument(
                "log_level",
                default_value="info",
                description="debug, info, warn, error or fatal",
            ),
            OpaqueFunction(function=make_nodes),
        ]
    )


def make_nodes(context):
    """Return all processes, each ending the launch when it ends."""

    def argument(name):
        return LaunchConfiguration(name).perform(context)

    common = {
        "use_sim_time": argument("use_sim_time") == "true",
        "enable_stamped_cmd_vel": argument("stamped") == "true",
    }
    files = [
        *parameter_files(argument("controller"), argument("map") == "true"),
        argument("params_file"),
    ]
    parameters = [*filter(None, files), common]
    log = ["--ros-args", "--log-level", argument("log_level")]
    nodes = [
        Node(
            package=package,
            executable=executable,
            output="screen",
            parameters=parameters,
            remappings=list(remappings.items()),
            arguments=log,
        )
        for package, executable, remappings in SERVERS
    ]
    names = [executable for _, executable, _ in SERVERS]
    manager = {
        "use_sim_time": common["use_sim_time"],
        "autostart": True,
        "node_names": names,
    }
    nodes.append(
        Node(
            package="nav2_lifecycle_manager",
            executable="lifecycle_manager",
            name=MANAGER,
            output="screen",
            parameters=[manager],
            arguments=log,
        )
    )
    time = ["-p", f"use_sim_time:={argument('use_sim_time')}"]
    nodes.append(
        ExecuteProcess(
            cmd=[sys.executable, str(HERE / "trial_node.py"), *log, *time],
            output="screen",
        )
    )
    end = EmitEvent(event=Shutdown(reason="a process of Nav2 has ended"))
    return [
        *nodes,
        *(
            RegisterEventHandler(OnProcessExit(target_action=node, on_exit=[end]))
            for node in nodes
        ),
    ]


def parameter_files(controller, with_map):
    """Return the files with the parameters, later ones count more."""
    names = ("common", "map" if with_map else "mapless", controller)
    return [str(HERE / "params" / f"{name}.yaml") for name in names]
