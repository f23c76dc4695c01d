"""What the sensors of a robot read."""

from dataclasses import dataclass

from barn_worlds.base.types import Odometry, Pose2D, Scan


@dataclass(frozen=True, slots=True)
class Joints:
    """Positions (rad) and velocities (rad/s) of the joints, in the order of `barn_sim.body.model.joint_names`."""

    positions: tuple[float, ...]
    velocities: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Sensors:
    """All readings of one instant; poses have been converted to a quaternion and back, as in messages.

    odometry: in the odom frame, which starts at the robot's start pose; truth: in the map frame; localization: the
    robot's estimate of its pose in the map frame; collision: contact with an obstacle since the last reading.
    """

    stamp_ns: int
    odometry: Odometry
    scan: Scan
    truth: Odometry
    localization: Pose2D
    collision: bool
    joints: Joints
