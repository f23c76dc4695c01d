"""The start of ROS in the process of a node."""

import sys

import rclpy
from rclpy.signals import SignalHandlerOptions

from barn_worlds.base.errors import ConfigError


def start_ros(
    arguments: list[str] | None = None, signals: SignalHandlerOptions | None = None
) -> None:
    """Start ROS in this process; ConfigError if its command-line arguments are wrong.

    Args:
        arguments: Words of the command line; by default those of this process.
        signals: Signals that rclpy handles; by default SIGINT and SIGTERM.

    Raises:
        ConfigError: If a ROS argument is malformed, or if another argument comes first.
    """
    words = sys.argv[1:] if arguments is None else arguments
    if words and words[0] != "--ros-args":
        # ROS would ignore it.
        raise ConfigError(
            f"argument {words[0]!r}: a node has no options; set its parameters by"
            " --ros-args -p NAME:=VALUE"
        )
    try:
        rclpy.init(args=arguments, signal_handler_options=signals)
    except RuntimeError as error:
        raise ConfigError(f"ROS arguments: {error}") from None
