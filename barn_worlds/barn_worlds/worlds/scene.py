"""The scene of a trial: its static obstacles, path, start and goal.

Messages, pages, pictures and films all show the same scene.
"""

from typing import NamedTuple

import numpy as np

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.geometry.bodies import Bodies, wall_bodies
from barn_worlds.worlds.cells import CYLINDER_HEIGHT_M, OCCUPIED, hollow_cells
from barn_worlds.worlds.world import World

# How much of a wide world a picture shows around a course.
_SURROUNDINGS_M = 20.0


class TrialScene(NamedTuple):
    """Obstacles, path, start and goal of a trial, in the map frame in meters."""

    # Centers (k, 2) of the upright cylinders of the world's grid and of its
    # containment.
    obstacles_m: Points
    walls_m: Points
    # Of every cylinder.
    radius_m: float
    height_m: float
    # (n, 2) through the world, may be empty.
    path_m: Points
    # None where they are not known.
    start: Pose2D | None = None
    goal: Pose2D | None = None
    # Distance from the goal that counts as arrival.
    goal_distance_m: float = 0.0
    # Straight walls, as arenas have them.
    boxes: Bodies = wall_bodies(())

    @property
    def cylinders_m(self) -> Points:
        """Centers (k, 2) in m of all cylinders, ordered as `World.cylinders_m`."""
        return np.concatenate([self.obstacles_m, self.walls_m])

    def with_cylinders_at(self, cylinders_m: Points) -> "TrialScene":
        """Return a copy of the scene with its cylinders at other centers.

        Args:
            cylinders_m: Centers (k, 2) in the order of `World.cylinders_m`.
        """
        count = len(self.obstacles_m)
        # Obstacles of the grid come first in `World.cylinders_m`.
        return self._replace(
            obstacles_m=cylinders_m[:count], walls_m=cylinders_m[count:]
        )

    def ends_m(self) -> Floats:
        """Return x, y (k, 2) in m of start and goal; unknown ones are left out."""
        poses = [pose for pose in (self.start, self.goal) if pose is not None]
        return np.array([pose.position for pose in poses]).reshape(-1, 2)

    def view_m(
        self, low: Floats, high: Floats, *driven_m: Points
    ) -> tuple[Floats, Floats]:
        """Return lower left and upper right corner (2,) in m of what a picture shows.

        Of a wide world, that is 20 m around path, start, goal and robots.

        Args:
            low: Lower left corner (2,) of the world.
            high: Upper right corner (2,) of the world.
            driven_m: Positions (n, 2) of robots, which the picture contains as well.
        """
        points = np.concatenate([self.path_m, self.ends_m(), *driven_m])
        if not len(points):
            return low, high
        return (
            np.maximum(low, points.min(axis=0) - _SURROUNDINGS_M),
            np.minimum(high, points.max(axis=0) + _SURROUNDINGS_M),
        )


def scene_of_map(grid: OccupancyMap) -> TrialScene:
    """Return the scene of a map: a cylinder in each occupied cell beside a free one."""
    is_occupied = grid.data > OCCUPIED // 2
    rows, columns = np.nonzero(is_occupied & ~hollow_cells(is_occupied))
    corner = np.array(grid.origin)
    return TrialScene(
        obstacles_m=corner + (np.column_stack([columns, rows]) + 0.5) * grid.resolution,
        walls_m=np.empty((0, 2)),
        radius_m=0.5 * grid.resolution,
        height_m=CYLINDER_HEIGHT_M,
        path_m=np.empty((0, 2)),
    )


def scene_of(
    world: World,
    start: Pose2D | None = None,
    goal: Pose2D | None = None,
    goal_distance_m: float = 0.0,
) -> TrialScene:
    """Return the scene of a world's cylinders, walls and path, with a start and a goal.

    The world's own start and goal are not used, and what moves is left out.

    Args:
        world: Its cylinders, walls and path are shown.
        start: Where the robot starts, if known.
        goal: Where it should arrive, if known.
        goal_distance_m: Distance from the goal that counts as arrival.
    """
    return TrialScene(
        obstacles_m=world.obstacles_m,
        walls_m=world.containment_m,
        radius_m=world.cylinder_radius_m,
        height_m=world.cylinder_height_m,
        path_m=world.path_m(),
        start=start,
        goal=goal,
        goal_distance_m=goal_distance_m,
        boxes=wall_bodies(world.walls),
    )
