"""The readings of a robot's sensors at one instant."""

from dataclasses import dataclass

from barn_worlds.base.types import Odometry, Pose2D, Scan


@dataclass(frozen=True, slots=True)
class Joints:
    """State of the wheels, in the order of `barn_sim.body.model.joint_names`."""

    positions: tuple[float, ...]
    """Angles in rad since the start."""

    velocities: tuple[float, ...]
    """Speeds in rad/s."""


@dataclass(frozen=True, slots=True)
class Sensors:
    """All readings of one instant.

    Poses have been converted to a quaternion and back, as in messages.
    """

    stamp_ns: int
    """Time since the start of the trial."""

    odometry: Odometry
    """Fused odometry in the odom frame, which starts at the robot's start pose."""

    scan: Scan
    """The last scan, which is older than `stamp_ns` if the lidar is slower."""

    truth: Odometry
    """True pose in the map frame and true velocity."""

    localization: Pose2D
    """The robot's estimate of its pose in the map frame."""

    collision: bool
    """Whether the robot has touched an obstacle since the last reading."""

    joints: Joints
    """State of the wheels."""
