"""The types that the packages exchange: poses, velocities, sensor readings and maps.

Metres, radians, seconds; frames as in REP-105 (map, odom, base_link), axes as in REP-103 (x forward, y left).
Time is in integer nanoseconds: differences are exact and messages carry it unchanged.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

NANOSECONDS_PER_SECOND = 1_000_000_000


def seconds(duration_ns: int) -> float:
    """Return a duration in nanoseconds as seconds."""
    return duration_ns / NANOSECONDS_PER_SECOND


def nanoseconds(duration_s: float) -> int:
    """Return a duration in seconds as the nearest whole nanosecond."""
    return round(duration_s * NANOSECONDS_PER_SECOND)


def wrap_angle(angle: float) -> float:
    """Return the angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def quaternion_from_yaw(yaw: float) -> tuple[float, float]:
    """Return (z, w) of the quaternion of a rotation about z; x and y are zero."""
    return math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Return the rotation about z of a quaternion, in [-pi, pi]."""
    if x == 0.0 and y == 0.0:
        return wrap_angle(2.0 * math.atan2(z, w))
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@dataclass(frozen=True, slots=True)
class Pose2D:
    """A pose in the plane, or the transform from the frame it describes to the frame it is given in."""

    x: float
    y: float
    yaw: float

    def __matmul__(self, inner: "Pose2D") -> "Pose2D":
        """Return the pose `inner`, which is relative to this pose, in the frame that this pose is given in."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2D(
            self.x + c * inner.x - s * inner.y,
            self.y + s * inner.x + c * inner.y,
            wrap_angle(self.yaw + inner.yaw),
        )

    def inverse(self) -> "Pose2D":
        """Return the inverse transform."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2D(
            -c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.yaw)
        )

    def transform(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Transform points (n, 2) from the frame of this pose to the frame it is given in."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        moved: npt.NDArray[np.float64] = points @ np.array(
            [[c, s], [-s, c]]
        ) + np.array([self.x, self.y])
        return moved

    def distance(self, other: "Pose2D") -> float:
        """Return the distance between the two positions in metres."""
        return math.hypot(self.x - other.x, self.y - other.y)

    def through_quaternion(self) -> "Pose2D":
        """Return the pose as it comes out of a message: a quaternion does not keep the last bit of the yaw."""
        z, w = quaternion_from_yaw(self.yaw)
        return Pose2D(self.x, self.y, yaw_from_quaternion(0.0, 0.0, z, w))


@dataclass(frozen=True, slots=True)
class Velocity2D:
    """Forward speed in m/s and yaw rate in rad/s of a robot that cannot move sideways."""

    linear: float = 0.0
    angular: float = 0.0

    def is_finite(self) -> bool:
        """Tell whether both parts are numbers."""
        return math.isfinite(self.linear) and math.isfinite(self.angular)


STOP = Velocity2D()


@dataclass(frozen=True, slots=True)
class Odometry:
    """A stamped pose (child base_link, in the odom frame unless said otherwise) and the velocity in base_link."""

    stamp_ns: int
    pose: Pose2D
    velocity: Velocity2D


@dataclass(frozen=True, slots=True)
class Scan:
    """A planar laser scan; ranges are float32, +inf nothing seen, -inf too close, NaN invalid (REP-117)."""

    stamp_ns: int
    ranges: npt.NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float

    def angles(self) -> npt.NDArray[np.float64]:
        """Return the direction of each beam in the sensor frame, (n,) radians."""
        return self.angle_min + self.angle_increment * np.arange(
            len(self.ranges), dtype=np.float64
        )


@dataclass(frozen=True, slots=True)
class OccupancyMap:
    """An occupancy grid as nav_msgs/OccupancyGrid has it: data[row, column], row along y, column along x.

    0 free, 100 occupied, -1 unknown. `origin_x`, `origin_y` are the outer corner of data[0, 0] in the map frame.
    """

    data: npt.NDArray[np.int8]
    resolution: float
    origin_x: float
    origin_y: float
