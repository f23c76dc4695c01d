"""The arena of DynaBARN: 20 x 20 m, three walls, open at x = +10 m, where the robot comes in and drives in -x."""

from collections.abc import Sequence

import numpy as np

from barn_worlds.moving.motion import MovingObstacle, Wall
from barn_worlds.worlds.world import Provenance, World

SIDE_M = 20.0
WALLS = (
    Wall(-10.0, 0.0, 0.5, SIDE_M),
    Wall(0.0, 10.0, SIDE_M, 0.5),
    Wall(0.0, -10.0, SIDE_M, 0.5),
)
START_M, GOAL_M = (11.0, 0.0), (-9.0, 0.0)

_CELL_M = 0.5
_CORNER_M = (-10.25, -10.25)  # outside of the walls
_SHAPE = (45, 41)  # up to x = 12.25 m, behind the start


def arena_world(name: str, moving: Sequence[MovingObstacle], provenance: Provenance | None = None) -> World:
    """Return a world of the arena with these obstacles; its path is the straight line from start to goal, 20 m."""
    first, last = (round((point[0] - _CORNER_M[0]) / _CELL_M - 0.5) for point in (START_M, GOAL_M))
    rows = np.arange(first, last - 1, -1)
    path = np.stack([rows, np.full(len(rows), _SHAPE[1] // 2)], axis=1)
    grid, given = np.zeros(_SHAPE, np.bool_), provenance or Provenance()
    return World(name, grid, path, _CELL_M, 1, given, WALLS, tuple(moving), _CORNER_M)
