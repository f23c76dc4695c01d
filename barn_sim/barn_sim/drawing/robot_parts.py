"""What robots look like in three dimensions: primitives in base_link."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from barn_sim.config import LidarConfig
from barn_worlds.base.files import read_package_yaml
from barn_worlds.geometry.polygon import Corner
from barn_worlds.robots.robot import Chassis, Vector3

_YELLOW = "#fac40f"
_DARK = "#33363b"
_BLACK = "#141417"
_METAL = "#9ea3ab"
# Turns the axis of a cylinder from z to y.
_SIDEWAYS = 0.5 * math.pi


class RobotPart(NamedTuple):
    """A primitive of the robot."""

    sizes: tuple[float, ...]
    """Full sizes of a box; radius and length of a cylinder along z; radius of a ball;
    height of an upright prism. All in m."""

    center: Vector3
    """Position in base_link, m."""

    color: str
    """Color as #rrggbb."""

    roll: float = 0.0
    """Rotation about x, applied first, rad."""

    pitch: float = 0.0
    """Rotation about y, rad."""

    corners: tuple[Corner, ...] = ()
    """Outline (k, 2) of a prism about its center, counter-clockwise, m."""


def robot_parts(chassis: Chassis, lidar: LidarConfig) -> list[RobotPart]:
    """Return the primitives that draw a robot: a Jackal's look, else its physics body.

    Args:
        chassis: The robot.
        lidar: Mounting of the lidar in base_link.
    """
    if chassis.description == "jackal.urdf":
        return jackal_parts(chassis, lidar)
    return body_parts(chassis, lidar)


def jackal_parts(chassis: Chassis, lidar: LidarConfig) -> list[RobotPart]:
    """Return the primitives that draw a Jackal, from jackal.yaml, wheels and lidar.

    Args:
        chassis: The Jackal's wheels and track.
        lidar: Mounting of the lidar in base_link.
    """
    look = read_package_yaml("barn_sim", "jackal.yaml")
    parts = [_read_part(chassis.track_m, **part) for part in look["parts"]]

    radius = chassis.wheel_radius_m
    for x, y, z in chassis.wheels_m:
        # Rims and caps sit on the outer face of a wheel, which is away from the body.
        outside = 0.022 * math.copysign(1.0, y)
        rim = (x, y + outside, z)
        cap = (x, y + 1.1 * outside, z)
        parts += [
            RobotPart((radius, 0.042), (x, y, z), _BLACK, roll=_SIDEWAYS),
            RobotPart((0.55 * radius, 0.010), rim, _METAL, roll=_SIDEWAYS),
            RobotPart((0.25 * radius, 0.012), cap, _YELLOW, roll=_SIDEWAYS),
        ]

    # The lidar stands on a foot, whose height depends on where it is mounted.
    body_top = 0.193
    lidar_x = lidar.mount_x_m
    lidar_z = lidar.mount_z_m
    foot = max(0.01, lidar_z - 0.03 - body_top)
    foot_center = (lidar_x, 0.0, 0.5 * (body_top + lidar_z - 0.03))
    return [
        *parts,
        RobotPart((0.09, 0.09, foot), foot_center, _DARK),
        RobotPart((0.042, 0.022), (lidar_x, 0.0, lidar_z - 0.019), _METAL),
        RobotPart((0.041, 0.034), (lidar_x, 0.0, lidar_z + 0.009), _BLACK),
        RobotPart((0.042, 0.008), (lidar_x, 0.0, lidar_z + 0.030), _METAL),
    ]


def _read_part(
    track_m: float,
    sizes: Sequence[float],
    center: Sequence[float],
    color: str,
    pitch: float = 0.0,
    is_fender: bool = False,
) -> RobotPart:
    """Return a part from its fields in YAML, a fender over wheels of a track."""
    x, y, z = center
    if is_fender:
        y += math.copysign(0.5 * track_m, y)
    return RobotPart(tuple(sizes), (x, y, z), color, pitch=pitch)


def body_parts(chassis: Chassis, lidar: LidarConfig) -> list[RobotPart]:
    """Return primitives of the physics body, wheels, casters, marked front and lidar.

    A caster is a ball of half the radius of the wheels: only its place is specified.

    Args:
        chassis: The robot.
        lidar: Mounting of the lidar in base_link.
    """
    low = chassis.ground_clearance_m - chassis.base_height_m
    high = chassis.body_height_m - chassis.base_height_m
    x_min, y_min, x_max, y_max = chassis.extent_m
    length = x_max - x_min
    width = y_max - y_min
    height = high - low
    middle_z = 0.5 * (low + high)
    center = (0.5 * (x_min + x_max), 0.5 * (y_min + y_max), middle_z)

    mark = 0.04 * length
    front_y = 0.0
    if not chassis.is_round:
        # The mark has to touch the outline: where a pointed robot is longest, not at y
        # = 0.
        tip = [y for x, y in chassis.hull_m if x > x_max - mark]
        front_y = 0.5 * (min(tip) + max(tip))

    if chassis.is_round:
        body = RobotPart((chassis.footprint_radius_m, height), center, _DARK)
    elif chassis.is_rectangular:
        body = RobotPart((length, width, height), center, _DARK)
    else:
        corners = tuple((x - center[0], y - center[1]) for x, y in chassis.hull_m)
        body = RobotPart((height,), center, _DARK, corners=corners)

    # A mast where the lidar stands over the body.
    mast_low, mast_high = sorted((high, lidar.mount_z_m))
    mast = (lidar.mount_x_m, lidar.mount_y_m, 0.5 * (mast_low + mast_high))
    parts = [
        body,
        RobotPart(
            (mark, 0.3 * width, 0.2 * height), (x_max, front_y, middle_z), _YELLOW
        ),
        RobotPart((mark, mast_high - mast_low + 2.0 * mark), mast, _BLACK),
    ]

    wheel = (chassis.wheel_radius_m, chassis.wheel_width_m)
    ball = 0.5 * chassis.wheel_radius_m
    ball_z = ball - chassis.base_height_m
    return [
        *parts,
        *(RobotPart(wheel, hub, _BLACK, roll=_SIDEWAYS) for hub in chassis.wheels_m),
        *(RobotPart((ball,), (x, y, ball_z), _METAL) for x, y in chassis.casters_m),
    ]
