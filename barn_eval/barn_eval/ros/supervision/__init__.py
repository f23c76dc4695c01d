"""Trials over ROS as processes under supervision; nothing in here knows rclpy."""

from barn_eval.ros.supervision.process import ProcessError
from barn_eval.ros.supervision.supervisor import run_ros_trials

__all__ = ["ProcessError", "run_ros_trials"]
