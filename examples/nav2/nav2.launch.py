"""Start Nav2 for the simulated Jackal.

    ros2 launch examples/nav2/nav2.launch.py controller:=mppi map:=false

Starts the servers, their lifecycle manager, and `nav2_trial`, with which the evaluator
gives each trial a fresh Nav2. The simulator publishes /scan, /odom, /clock and all
transforms. The evaluator publishes /goal_pose and, if the protocol has one, /map. If
one process ends, all end, so that the evaluator notices.
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
BOOLEANS = ("true", "false")
MANAGER = "lifecycle_manager_navigation"
# Package, executable (also the node's name) and remappings. Commands go from controller
# and behaviors to the velocity smoother, then to the collision monitor, then to
# cmd_vel.
SERVERS = (
    ("nav2_controller", "controller_server", {"cmd_vel": "cmd_vel_nav"}),
    ("nav2_planner", "planner_server", {}),
    ("nav2_behaviors", "behavior_server", {"cmd_vel": "cmd_vel_nav"}),
    ("nav2_velocity_smoother", "velocity_smoother", {"cmd_vel": "cmd_vel_nav"}),
    ("nav2_collision_monitor", "collision_monitor", {}),
    ("nav2_bt_navigator", "bt_navigator", {}),
)
# Name, default, description and choices of the launch arguments.
ARGUMENTS = (
    ("controller", "mppi", "local planner", CONTROLLERS),
    ("map", "false", "plan on a map", BOOLEANS),
    ("stamped", "false", "send TwistStamped, not Twist", BOOLEANS),
    ("use_sim_time", "true", "take the time from /clock", None),
    ("params_file", "", "more parameters, which count most", None),
    ("log_level", "info", "debug, info, warn, error or fatal", None),
)


def generate_launch_description():
    """Return the launch arguments and what starts the processes."""
    arguments = [
        DeclareLaunchArgument(
            name, default_value=default, description=description, choices=choices
        )
        for name, default, description, choices in ARGUMENTS
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=make_processes)])


def make_processes(context):
    """Return all processes; each ends the launch when it ends."""
    values = {
        name: LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS
    }
    use_sim_time = values["use_sim_time"] == "true"
    parameters = parameter_files(values["controller"], values["map"] == "true")
    if values["params_file"]:
        parameters.append(values["params_file"])
    parameters.append(
        {
            "use_sim_time": use_sim_time,
            "enable_stamped_cmd_vel": values["stamped"] == "true",
        }
    )
    log_arguments = ["--ros-args", "--log-level", values["log_level"]]

    processes = []
    for package, executable, remappings in SERVERS:
        server = Node(
            package=package,
            executable=executable,
            output="screen",
            parameters=parameters,
            remappings=list(remappings.items()),
            arguments=log_arguments,
        )
        processes.append(server)

    manager_parameters = {
        "use_sim_time": use_sim_time,
        "autostart": True,
        "node_names": [executable for _, executable, _ in SERVERS],
    }
    manager = Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name=MANAGER,
        output="screen",
        parameters=[manager_parameters],
        arguments=log_arguments,
    )
    time_arguments = ["-p", f"use_sim_time:={values['use_sim_time']}"]
    script = str(HERE / "trial_node.py")
    trial_node = ExecuteProcess(
        cmd=[sys.executable, script, *log_arguments, *time_arguments], output="screen"
    )
    processes += [manager, trial_node]

    end_launch = EmitEvent(event=Shutdown(reason="a process of Nav2 has ended"))
    handlers = [
        RegisterEventHandler(OnProcessExit(target_action=process, on_exit=[end_launch]))
        for process in processes
    ]
    return processes + handlers


def parameter_files(controller, use_map):
    """Return the parameter files, of which later ones count more.

    Args:
        controller: Name of the local planner.
        use_map: Whether Nav2 plans on a map.
    """
    names = ("common", "map" if use_map else "mapless", controller)
    return [str(HERE / "params" / f"{name}.yaml") for name in names]
