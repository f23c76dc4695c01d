"""What robots look like in three dimensions: a Jackal as it is, others as the body that the physics has."""

import math
from typing import NamedTuple

from barn_sim.config import LidarConfig
from barn_worlds.geometry.polygon import Corner
from barn_worlds.robots.robot import Chassis, Triple

_YELLOW, _DARK, _BLACK, _METAL, _LAMP, _TAIL = (
    "#fac40f",
    "#33363b",
    "#141417",
    "#9ea3ab",
    "#f2f2e6",
    "#cc1a1a",
)


class RobotPart(NamedTuple):
    """A primitive of the robot at `centre` in base_link, turned by roll and pitch.

    sizes: full sizes of a box; radius and length of a cylinder, which stands along z before it is turned; radius of a
    ball; height of an upright prism, whose corners (k, 2) are about `centre`, counter-clockwise.
    """

    sizes: tuple[float, ...]
    centre: tuple[float, float, float]
    colour: str
    roll: float = 0.0
    pitch: float = 0.0
    corners: tuple[Corner, ...] = ()


def jackal_parts(chassis: Chassis, lidar: LidarConfig) -> list[RobotPart]:
    """Return what a Jackal looks like: dark body, yellow fenders, wheels with hubs, lamps, lidar and antennas."""
    radius, half_track = chassis.wheel_radius_m, 0.5 * chassis.track_m
    parts = [RobotPart((0.40, 0.30, 0.17), (0.0, 0.0, 0.095), _DARK)]
    parts.append(RobotPart((0.42, 0.28, 0.012), (0.0, 0.0, 0.187), _BLACK))
    parts += [
        RobotPart((0.012, 0.20, 0.004), (x, 0.0, 0.195), _METAL) for x in (-0.06, 0.04)
    ]
    for end in (1.0, -1.0):
        parts.append(RobotPart((0.02, 0.34, 0.085), (end * 0.236, 0.0, 0.085), _YELLOW))
        parts.append(RobotPart((0.012, 0.20, 0.03), (end * 0.249, 0.0, 0.085), _BLACK))
        for side in (1.0, -1.0):
            middle = side * (half_track + 0.003)
            parts.append(
                RobotPart((0.17, 0.066, 0.014), (end * 0.118, middle, 0.150), _YELLOW)
            )
            parts.append(
                RobotPart(
                    (0.082, 0.066, 0.014),
                    (end * 0.228, middle, 0.125),
                    _YELLOW,
                    pitch=end * 0.68,
                )
            )
            lamp = _LAMP if end > 0 else _TAIL
            parts.append(
                RobotPart((0.006, 0.045, 0.018), (end * 0.247, side * 0.13, 0.10), lamp)
            )
    for x, y, z in chassis.wheels_m:
        outside = 0.022 * math.copysign(1.0, y)
        parts.append(RobotPart((radius, 0.042), (x, y, z), _BLACK, roll=0.5 * math.pi))
        parts.append(
            RobotPart(
                (0.55 * radius, 0.010), (x, y + outside, z), _METAL, roll=0.5 * math.pi
            )
        )
        parts.append(
            RobotPart(
                (0.25 * radius, 0.012),
                (x, y + 1.1 * outside, z),
                _YELLOW,
                roll=0.5 * math.pi,
            )
        )
    top, height, ahead = 0.193, lidar.mount_z_m, lidar.mount_x_m
    foot = max(0.01, height - 0.03 - top)
    parts.append(
        RobotPart((0.09, 0.09, foot), (ahead, 0.0, 0.5 * (top + height - 0.03)), _DARK)
    )
    rings = (
        ((0.042, 0.022), -0.019, _METAL),
        ((0.041, 0.034), 0.009, _BLACK),
        ((0.042, 0.008), 0.030, _METAL),
    )
    parts += [
        RobotPart(size, (ahead, 0.0, height + above), colour)
        for size, above, colour in rings
    ]
    return parts + [
        RobotPart((0.006, 0.16), (-0.16, side * 0.09, 0.27), _BLACK)
        for side in (1.0, -1.0)
    ]


def robot_parts(chassis: Chassis, lidar: LidarConfig) -> list[RobotPart]:
    """Return what a robot looks like: a Jackal as it is, others as the body that the physics has.

    That is a box, cylinder or prism, with wheels and casters; front and lidar are marked. A caster is a ball of half
    the radius of the wheels: its place is all that is known of it.
    """
    if chassis.description == "jackal.urdf":
        return jackal_parts(chassis, lidar)
    low, high = (
        edge - chassis.base_height_m
        for edge in (chassis.ground_clearance_m, chassis.body_height_m)
    )
    x_min, y_min, x_max, y_max = chassis.extent_m
    long, wide, tall = x_max - x_min, y_max - y_min, high - low
    middle = (0.5 * (x_min + x_max), 0.5 * (y_min + y_max), 0.5 * (low + high))
    small, z, ball = 0.04 * long, lidar.mount_z_m, 0.5 * chassis.wheel_radius_m
    tip = (
        [y for x, y in chassis.hull_m if x > x_max - small]
        if not chassis.is_round
        else [0.0]
    )
    front = (x_max, 0.5 * (min(tip) + max(tip)), middle[2])
    foot, top = (
        min(high, z),
        max(high, z),
    )  # a mast where the lidar stands over the body
    parts = [
        _body(chassis, (long, wide, tall), middle),
        RobotPart((small, 0.3 * wide, 0.2 * tall), front, _YELLOW),
        RobotPart(
            (small, top - foot + 2.0 * small),
            (lidar.mount_x_m, lidar.mount_y_m, 0.5 * (foot + top)),
            _BLACK,
        ),
    ]
    rim = (chassis.wheel_radius_m, chassis.wheel_width_m)
    parts += [
        RobotPart(rim, hub, _BLACK, roll=0.5 * math.pi) for hub in chassis.wheels_m
    ]
    return parts + [
        RobotPart((ball,), (x, y, ball - chassis.base_height_m), _METAL)
        for x, y in chassis.casters_m
    ]


def _body(chassis: Chassis, sizes: Triple, middle: Triple) -> RobotPart:
    """Return the body of a robot; sizes: of the box around it."""
    if chassis.is_round:
        return RobotPart((chassis.footprint_radius_m, sizes[2]), middle, _DARK)
    if chassis.is_rectangular:
        return RobotPart(sizes, middle, _DARK)
    corners = tuple((x - middle[0], y - middle[1]) for x, y in chassis.hull_m)
    return RobotPart((sizes[2],), middle, _DARK, corners=corners)
