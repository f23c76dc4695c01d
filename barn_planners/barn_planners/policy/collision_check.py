"""The check that keeps a policy's commands from driving into obstacles.

A command is safe if the robot, driven by it until it could have stopped, comes no
nearer to an obstacle than a margin, or than it is already. An unsafe command is
replaced by the safe one that differs least, or by a stop. Obstacles
behind the robot are not seen.
"""

import itertools
import math
from dataclasses import dataclass

from barn_planners.interface import FloatArray
from barn_planners.navigation.observation_check import LidarMountConfig
from barn_planners.navigation.scan_planner import scan_points
from barn_worlds.base.arrays import kernel
from barn_worlds.base.config import quantity
from barn_worlds.base.types import STOP, Scan, Velocity2D

# Distance between checked poses, along the path of the outline's fastest corner.
_SPACING_M = 0.04
# Replacements: factors of the speed, and offsets of the yaw rate in rad/s.
_SPEED_FACTORS = (1.0, 0.75, 0.5, 0.25, 0.0)
_RATE_OFFSETS = (0.0, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2)
# The least change comes first; a full stop counts like 2 rad/s.
_CHANGES = sorted(
    itertools.product(_SPEED_FACTORS, _RATE_OFFSETS),
    key=lambda change: 2.0 * (1.0 - change[0]) + abs(change[1]),
)


@dataclass(frozen=True)
class CollisionCheckConfig(LidarMountConfig):
    """The collision check; the defaults are for a Jackal."""

    enabled: bool = quantity(True, "avoid collisions; false: the policy alone drives")
    margin_m: float = quantity(0.03, "margin around the robot", "m", 0.0, 1.0)
    reaction_s: float = quantity(
        0.15, "time until a new command takes effect", "s", 0.0, 2.0
    )
    braking_mps2: float = quantity(
        4.0, "deceleration assumed for braking", "m/s2", 0.1, 20.0
    )
    half_length_m: float = quantity(0.254, "half the robot's length", "m", 0.01, 5.0)
    half_width_m: float = quantity(0.215, "half the robot's width", "m", 0.01, 5.0)


def avoid_collision(
    command: Velocity2D, velocity: Velocity2D, scan: Scan, config: CollisionCheckConfig
) -> Velocity2D:
    """Return the command if it is safe, else the safe one that differs least, or STOP.

    Args:
        command: Finite command to check.
        velocity: Velocity of the robot now, from odometry.
        scan: Current scan.
        config: Size of the robot, margin and assumed braking.
    """
    # The higher of both speeds: a slow command does not slow the robot at once.
    speed = max(abs(command.linear), abs(velocity.linear))
    # While it brakes evenly the robot covers half of speed times time, so half the time
    # counts.
    horizon_s = config.reaction_s + 0.5 * speed / config.braking_mps2
    corner_m = math.hypot(config.half_length_m, config.half_width_m)
    lidar = config.lidar
    reach_m = (
        speed * horizon_s + corner_m + config.margin_m + math.hypot(*lidar.position)
    )
    points = scan_points(scan, lidar, reach_m)
    if not len(points):
        return command

    half_sizes = (config.half_length_m, config.half_width_m)
    clearance_now_m = least_clearance(points, 0.0, 0.0, 1, 0.0, *half_sizes)
    for speed_factor, rate_offset in _CHANGES:
        linear = speed_factor * command.linear
        angular = command.angular + rate_offset
        corner_path_m = (abs(linear) + corner_m * abs(angular)) * horizon_s
        steps = 1 + math.ceil(corner_path_m / _SPACING_M)
        clearance_m = least_clearance(
            points, linear, angular, steps, horizon_s / steps, *half_sizes
        )
        # A robot within the margin already may drive on, as long as it comes no nearer.
        if clearance_m >= config.margin_m or clearance_m >= clearance_now_m:
            return Velocity2D(linear, angular)
    return STOP


@kernel
def least_clearance(
    points: FloatArray,
    linear: float,
    angular: float,
    steps: int,
    step_s: float,
    half_length: float,
    half_width: float,
) -> float:
    """Return the least distance in m of points from an outline on a drive; 0 inside it.

    Args:
        points: Obstacle points (n, 2) in m in base_link before the drive.
        linear: Constant speed in m/s.
        angular: Constant yaw rate in rad/s.
        steps: Number of poses to check.
        step_s: Time between them in s.
        half_length: Half the length of the outline in m.
        half_width: Half its width in m.

    Returns:
        Distance in m; 0 if a point lies inside the outline, inf without points. The
        pose before the drive is not checked.
    """
    least = math.inf
    for k in range(1, steps + 1):
        time_s = k * step_s
        yaw = angular * time_s
        # The radius of the arc is infinite for a straight drive.
        if abs(yaw) < 1e-9:
            x = linear * time_s
            y = 0.0
        else:
            x = linear / angular * math.sin(yaw)
            y = linear / angular * (1.0 - math.cos(yaw))

        c = math.cos(yaw)
        s = math.sin(yaw)
        for i in range(len(points)):
            dx = points[i, 0] - x
            dy = points[i, 1] - y
            ahead = max(abs(c * dx + s * dy) - half_length, 0.0)
            aside = max(abs(c * dy - s * dx) - half_width, 0.0)
            least = min(least, math.hypot(ahead, aside))
    return least
