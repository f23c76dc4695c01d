"""The start of ROS in the process of a node."""

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
        ConfigError: If a ROS argument is malformed.
    """
    try:
        rclpy.init(args=arguments, signal_handler_options=signals)
    except RuntimeError as error:
        raise ConfigError(f"ROS arguments: {error}") from None
