"""Footprints of common robots."""

import math
from dataclasses import dataclass

from barn_worlds.config import Checked, quantity
from barn_worlds.errors import ConfigError, suggest


@dataclass(frozen=True)
class Robot(Checked):
    """Outer size of a robot."""

    name: str = quantity("jackal", "name of the robot")
    length_m: float = quantity(0.508, "outer length along x", "m", minimum=0.01, maximum=20.0)
    width_m: float = quantity(0.430, "outer width along y", "m", minimum=0.01, maximum=20.0)

    def footprint_cells(self, resolution_m: float) -> int:
        """Return the side, in cells and odd, of the square that the robot occupies on a grid.

        The longer side of the robot rounded up to whole cells with the robot's centre in the middle of one: the
        Jackal (0.508 x 0.430 m) takes 5 x 5 cells of 0.15 m, as in the original data set.
        """
        beyond_own_cell_m = (max(self.length_m, self.width_m) - resolution_m) / 2.0
        return 2 * max(0, math.ceil(beyond_own_cell_m / resolution_m - 1e-9)) + 1


# Outer dimensions without options, from the makers' data sheets.
ROBOTS: dict[str, Robot] = {
    robot.name: robot
    for robot in (
        Robot(),
        Robot("husky", 0.990, 0.670),
        Robot("turtlebot3_burger", 0.138, 0.178),
        Robot("turtlebot3_waffle", 0.281, 0.306),
        Robot("turtlebot4", 0.341, 0.339),
        Robot("scout_mini", 0.612, 0.580),
        Robot("ridgeback", 0.960, 0.793),
    )
}


def robot_named(name: str) -> Robot:
    """Return the robot of that name; ConfigError names the near one."""
    if name not in ROBOTS:
        raise ConfigError(f"unknown robot {name!r}{suggest(name, ROBOTS)}")
    return ROBOTS[name]
