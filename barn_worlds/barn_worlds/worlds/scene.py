"""The scene of a trial: what stands in it and where it leads, for messages, pages, pictures and films alike."""

from typing import NamedTuple

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import Pose2D
from barn_worlds.geometry.bodies import Bodies, wall_bodies
from barn_worlds.worlds.world import World


class SceneCylinders(NamedTuple):
    """Upright cylinders: centres (k, 2) in the map frame, one radius and height, all in metres."""

    centres_m: Floats
    radius_m: float
    height_m: float


class TrialScene(NamedTuple):
    """What stands in a trial and where it leads, in the map frame, metres.

    obstacles: those of the world's grid; walls: its containment. path: (n, 2) through the world, may be empty. start,
    goal: None where they are not known. goal_distance_m: from the goal, what counts as arrival. boxes: straight walls,
    as arenas have them.
    """

    obstacles: SceneCylinders
    walls: SceneCylinders
    path_m: Floats
    start: Pose2D | None = None
    goal: Pose2D | None = None
    goal_distance_m: float = 0.0
    boxes: Bodies = wall_bodies(())

    @property
    def cylinders_m(self) -> Floats:
        """Centres (k, 2) of all cylinders, in the order of `World.cylinders_m`."""
        return np.concatenate([self.obstacles.centres_m, self.walls.centres_m])

    @property
    def radius_m(self) -> float:
        """Radius of the obstacles; in a world the walls have the same."""
        return self.obstacles.radius_m or self.walls.radius_m

    @property
    def height_m(self) -> float:
        """Height of the obstacles; in a world the walls have the same."""
        return self.obstacles.height_m or self.walls.height_m

    def moved(self, cylinders_m: Floats) -> "TrialScene":
        """Return the scene with its cylinders at centres (k, 2) in the order of `World.cylinders_m`."""
        count = len(self.obstacles.centres_m)
        parts = (
            self.obstacles._replace(centres_m=cylinders_m[:count]),
            self.walls._replace(centres_m=cylinders_m[count:]),
        )
        return self._replace(obstacles=parts[0], walls=parts[1])

    def ends_m(self) -> Floats:
        """Return start and goal (k, 2), as far as they are known."""
        known = [(pose.x, pose.y) for pose in (self.start, self.goal) if pose is not None]
        return np.array(known, np.float64).reshape(-1, 2)


def scene_of(
    world: World, start: Pose2D | None = None, goal: Pose2D | None = None, reached_m: float = 0.0
) -> TrialScene:
    """Return the scene of a world and a course through it; reached_m: from the goal, what counts as arrival."""
    obstacles, walls = (
        SceneCylinders(centres_m, world.cylinder_radius_m, world.cylinder_height_m)
        for centres_m in (world.obstacles_m, world.containment_m)
    )
    return TrialScene(obstacles, walls, world.path_m(), start, goal, reached_m, wall_bodies(world.walls))
