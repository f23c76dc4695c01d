"""Poses, velocities, sensor readings and maps, as the packages exchange them.

Units are meters, radians and seconds. Frames are as in REP-105 (map, odom, base_link),
axes as in REP-103 (x forward, y left). Times are integers in nanoseconds: their
differences are exact, and messages carry them unchanged.
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from barn_worlds.base.arrays import Floats, Points, SignedBytes, Singles

_Angle = TypeVar("_Angle", float, Floats)

NANOSECONDS_PER_SECOND = 1_000_000_000


def seconds(duration_ns: int) -> float:
    """Return a duration in nanoseconds as seconds."""
    return duration_ns / NANOSECONDS_PER_SECOND


def nanoseconds(duration_s: float) -> int:
    """Return a duration in seconds as the nearest whole nanosecond."""
    return round(duration_s * NANOSECONDS_PER_SECOND)


def wrap_angle(angle: _Angle) -> _Angle:
    """Return an angle, or an array of angles, in radians wrapped to [-pi, pi)."""
    # The modulo of Python is never negative here, unlike that of C.
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def quaternion_from_yaw(yaw: float) -> tuple[float, float]:
    """Return (z, w) of the quaternion of a rotation about z; x and y are zero."""
    # A quaternion has half the angle of its rotation.
    return math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Return a quaternion's yaw, its rotation about z, in radians in [-pi, pi].

    Args:
        x: First component of the vector part; 0 for a rotation about z.
        y: Second component of the vector part; 0 for a rotation about z.
        z: Third component of the vector part.
        w: Scalar part.
    """
    # The short form is exact for rotations about z, which is what planar robots send.
    if x == 0.0 and y == 0.0:
        return wrap_angle(2.0 * math.atan2(z, w))
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


@dataclass(frozen=True, slots=True)
class Pose2D:
    """A pose in the plane, in meters and radians.

    It is also the transform from the frame that it describes to its reference frame.
    """

    x: float
    y: float
    yaw: float

    @property
    def position(self) -> tuple[float, float]:
        """Position x and y in meters."""
        return self.x, self.y

    @property
    def numbers(self) -> tuple[float, float, float]:
        """Position x and y in meters, and yaw in radians."""
        return self.x, self.y, self.yaw

    def __matmul__(self, inner: "Pose2D") -> "Pose2D":
        """Return `inner`, a pose in the frame of this one, in its reference frame."""
        cos = math.cos(self.yaw)
        sin = math.sin(self.yaw)
        return Pose2D(
            self.x + cos * inner.x - sin * inner.y,
            self.y + sin * inner.x + cos * inner.y,
            wrap_angle(self.yaw + inner.yaw),
        )

    def inverse(self) -> "Pose2D":
        """Return the inverse transform: the reference frame as a pose in this frame."""
        cos = math.cos(self.yaw)
        sin = math.sin(self.yaw)
        return Pose2D(
            -cos * self.x - sin * self.y,
            sin * self.x - cos * self.y,
            wrap_angle(-self.yaw),
        )

    def transform(self, points: Points) -> Points:
        """Return points (n, 2) converted from this pose's frame to its reference."""
        cos = math.cos(self.yaw)
        sin = math.sin(self.yaw)
        # Points are rows, so the rotation matrix stands transposed on the right.
        rotation = np.array([[cos, sin], [-sin, cos]])
        transformed: Points = points @ rotation + np.array(self.position)
        return transformed

    def distance(self, other: "Pose2D") -> float:
        """Return the distance between the two positions in meters."""
        return math.hypot(self.x - other.x, self.y - other.y)

    def through_quaternion(self) -> "Pose2D":
        """Return the pose with its yaw turned into a quaternion and back.

        A quaternion does not keep the last bit of the yaw.
        """
        z, w = quaternion_from_yaw(self.yaw)
        return Pose2D(*self.position, yaw_from_quaternion(0.0, 0.0, z, w))


@dataclass(frozen=True, slots=True)
class Velocity2D:
    """The twist of a robot that cannot move sideways."""

    linear: float = 0.0
    """Forward speed in m/s."""

    angular: float = 0.0
    """Yaw rate in rad/s."""

    @property
    def numbers(self) -> tuple[float, float]:
        """Forward speed in m/s and yaw rate in rad/s."""
        return self.linear, self.angular

    def is_finite(self) -> bool:
        """Tell whether both numbers are finite."""
        return math.isfinite(self.linear) and math.isfinite(self.angular)


STOP = Velocity2D()
ORIGIN = Pose2D(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Odometry:
    """A pose and velocity of base_link at one time."""

    stamp_ns: int

    pose: Pose2D
    """Pose in the odom frame, where the source names no other."""

    velocity: Velocity2D
    """Velocity in base_link."""


_SHORTEST_RETURN_M = 1e-6


@dataclass(frozen=True, slots=True)
class Scan:
    """A planar laser scan."""

    stamp_ns: int

    ranges: Singles
    """Meters by beam: +inf nothing in range, -inf too close, NaN invalid (REP-117)."""

    angle_min: float
    """Direction of the first beam in the sensor frame."""

    angle_increment: float
    range_min: float
    range_max: float

    def angles(self) -> Floats:
        """Return the direction of each beam in the sensor frame, (n,) radians."""
        beams = np.arange(len(self.ranges), dtype=np.float64)
        return self.angle_min + self.angle_increment * beams

    @property
    def shortest_return_m(self) -> float:
        """Shortest range in m that counts as a return; planners ignore shorter ones.

        Many lidars report 0 if nothing is in range, whatever their range_min is.
        """
        if self.range_min > 0.0:
            return self.range_min
        return _SHORTEST_RETURN_M


@dataclass(frozen=True, slots=True)
class OccupancyMap:
    """An occupancy grid in the layout of nav_msgs/OccupancyGrid."""

    data: SignedBytes
    """Cells by row (along y) and column (along x): 0 free, 100 occupied, -1 unknown."""

    resolution: float
    """Side of a cell in meters."""

    origin_x: float
    """Position of the outer corner of data[0, 0] in the map frame."""

    origin_y: float

    @property
    def origin(self) -> tuple[float, float]:
        """Position (x, y) of the outer corner of data[0, 0] in the map frame, in m."""
        return self.origin_x, self.origin_y
