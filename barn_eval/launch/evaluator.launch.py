"""Start the evaluator.

    ros2 launch barn_eval evaluator.launch.py worlds:=0-9 planner:=mine out:=results

It leads a simulator and judges a planner that run already or start soon. When all
trials have ended, everything that was launched with it ends, with its exit code. It
reads /clock itself; use_sim_time only changes the times in its log.
"""

from launch import LaunchDescription

from barn_worlds.ros.launching import NodeLaunch

TOPICS = (
    "cmd_vel",
    "scan",
    "odom",
    "ground_truth/odom",
    "collision",
    "goal_pose",
    "map",
)


def generate_launch_description() -> LaunchDescription:
    """Return a launch description of the evaluator and its arguments."""
    return NodeLaunch(
        "barn_eval", "evaluator", TOPICS, use_sim_time=False, ends_launch=True
    ).description()
