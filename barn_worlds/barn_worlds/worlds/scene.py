"""The scene of a trial: what stands in it and where it leads, for messages, pages, pictures and films alike."""

from typing import NamedTuple

import numpy as np

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.types import Pose2D
from barn_worlds.geometry.bodies import Bodies, wall_bodies
from barn_worlds.worlds.world import World

_NEAR_M = 20.0  # of a wide world, how much a picture shows around what is driven


class TrialScene(NamedTuple):
    """What stands in a trial and where it leads, in the map frame, metres.

    obstacles_m, walls_m: centres (k, 2) of the upright cylinders of the world's grid and of its containment, all of one
    radius and height. path_m: (n, 2) through the world, may be empty. start, goal: None where they are not known.
    goal_distance_m: from the goal, what counts as arrival. boxes: straight walls, as arenas have them.
    """

    obstacles_m: Points
    walls_m: Points
    radius_m: float
    height_m: float
    path_m: Points
    start: Pose2D | None = None
    goal: Pose2D | None = None
    goal_distance_m: float = 0.0
    boxes: Bodies = wall_bodies(())

    @property
    def cylinders_m(self) -> Points:
        """Centres (k, 2) of all cylinders, in the order of `World.cylinders_m`."""
        return np.concatenate([self.obstacles_m, self.walls_m])

    def with_cylinders_at(self, cylinders_m: Points) -> "TrialScene":
        """Return the scene with its cylinders at centres (k, 2) in the order of `World.cylinders_m`."""
        count = len(self.obstacles_m)
        return self._replace(
            obstacles_m=cylinders_m[:count], walls_m=cylinders_m[count:]
        )

    def ends_m(self) -> Floats:
        """Return start and goal (k, 2), as far as they are known."""
        known = [
            (pose.x, pose.y) for pose in (self.start, self.goal) if pose is not None
        ]
        return np.array(known, np.float64).reshape(-1, 2)

    def view_m(
        self, low: Floats, high: Floats, *driven_m: Points
    ) -> tuple[Floats, Floats]:
        """Return the corners of a picture from low to high, of a wide world no more than what is near a way."""
        way = np.concatenate([self.path_m, self.ends_m(), *driven_m])
        if not len(way):
            return low, high
        return np.maximum(low, way.min(axis=0) - _NEAR_M), np.minimum(
            high, way.max(axis=0) + _NEAR_M
        )


def scene_of(
    world: World,
    start: Pose2D | None = None,
    goal: Pose2D | None = None,
    reached_m: float = 0.0,
) -> TrialScene:
    """Return the scene of a world and a course through it; reached_m: from the goal, what counts as arrival."""
    size, boxes = (
        (world.cylinder_radius_m, world.cylinder_height_m),
        wall_bodies(world.walls),
    )
    return TrialScene(
        world.obstacles_m,
        world.containment_m,
        *size,
        world.path_m(),
        start,
        goal,
        reached_m,
        boxes,
    )
