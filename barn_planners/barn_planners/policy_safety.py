"""A safety shield around policies: no driving into what the scan shows.

A command is safe if, driven until the robot could have stopped, it brings no obstacle nearer to the outline than a
margin, or at least no nearer than it is already. An unsafe command is replaced by the most similar safe one among some
slower and turned commands, or by a stop. The shield does not know about obstacles behind the robot, which the lidar
does not see.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_planners.gap import returns
from barn_worlds.config import Checked, quantity
from barn_worlds.types import STOP, Scan, Velocity2D

Array = npt.NDArray[np.float64]

_SPACING_M = 0.04  # between checked poses, along the path of the outline's fastest corner
# Factors of the speed and offsets of the yaw rate in rad/s, least change first; a full stop counts like 2 rad/s.
_CHANGES = sorted(
    ((share, turn) for share in (1.0, 0.75, 0.5, 0.25, 0.0) for turn in (0.0, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2)),
    key=lambda change: 2.0 * (1.0 - change[0]) + abs(change[1]),
)


@dataclass(frozen=True)
class SafetyConfig(Checked):
    """A shield against collisions, for a Jackal."""

    enabled: bool = quantity(True, "avoid collisions; false: the policy alone drives")
    margin_m: float = quantity(0.03, "margin around the robot", "m", minimum=0.0, maximum=1.0)
    reaction_s: float = quantity(0.15, "time until a new command takes effect", "s", minimum=0.0, maximum=2.0)
    braking_mps2: float = quantity(4.0, "assumed deceleration", "m/s2", minimum=0.1, maximum=20.0)
    half_length_m: float = quantity(0.254, "half the robot's length", "m", minimum=0.01, maximum=5.0)
    half_width_m: float = quantity(0.215, "half the robot's width", "m", minimum=0.01, maximum=5.0)
    lidar_x_m: float = quantity(0.055, "lidar forward of base_link", "m", minimum=-10.0, maximum=10.0)


def safe_command(wanted: Velocity2D, moving: Velocity2D, scan: Scan, config: SafetyConfig) -> Velocity2D:
    """Return the wanted command if it is safe, else its safe replacement.

    moving: velocity of the robot now.
    """
    speed = max(abs(wanted.linear), abs(moving.linear))
    time_s = config.reaction_s + 0.5 * speed / config.braking_mps2
    reach_m = math.hypot(config.half_length_m, config.half_width_m)
    points = returns(scan, config.lidar_x_m, speed * time_s + reach_m + config.margin_m + abs(config.lidar_x_m))
    if not len(points):
        return wanted
    half_sizes = (config.half_length_m, config.half_width_m)
    now_m = least_gap(points, 0.0, 0.0, 1, 0.0, *half_sizes)
    for share, turn in _CHANGES:
        linear, angular = share * wanted.linear, wanted.angular + turn
        steps = 1 + math.ceil((abs(linear) + reach_m * abs(angular)) * time_s / _SPACING_M)
        gap_m = least_gap(points, linear, angular, steps, time_s / steps, *half_sizes)
        if gap_m >= config.margin_m or gap_m >= now_m:
            return Velocity2D(linear, angular)
    return STOP


@njit(cache=True)
def least_gap(
    points: Array, linear: float, angular: float, steps: int, step_s: float, half_length: float, half_width: float
) -> float:
    """Return the least distance in m of points (n, 2) from the robot's outline, driving from the origin.

    Checked are the poses at `step_s`, 2 `step_s`, ... `steps` times `step_s`; 0 for points inside the outline.
    """
    least = math.inf
    for k in range(1, steps + 1):
        time_s = k * step_s
        yaw = angular * time_s
        if abs(yaw) < 1e-9:
            x, y = linear * time_s, 0.0
        else:
            x, y = linear / angular * math.sin(yaw), linear / angular * (1.0 - math.cos(yaw))
        c, s = math.cos(yaw), math.sin(yaw)
        for i in range(len(points)):
            dx, dy = points[i, 0] - x, points[i, 1] - y
            ahead = max(abs(c * dx + s * dy) - half_length, 0.0)
            aside = max(abs(c * dy - s * dx) - half_width, 0.0)
            least = min(least, math.hypot(ahead, aside))
    return least
