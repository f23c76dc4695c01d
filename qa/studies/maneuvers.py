"""Draw the data set `maneuvers`: single tasks for a local planner, each in three widths.

    python qa/studies/maneuvers.py barn_worlds/barn_worlds/data/maneuvers.npz

Lengths are in meters for a Jackal; other robots meet the same worlds in their own size.
"""

import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import BoolGrid
from barn_worlds.datasets.dataset import MANEUVERS
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.worlds.course import build_world, parse_course
from barn_worlds.worlds.world import Provenance, World

CELL_M = 0.05
WIDTHS_M = {"wide": 1.2, "medium": 0.9, "narrow": 0.7}
# The square that the robot takes stands across a door at an angle.
DOOR_MARGIN_M = 0.2
MARGIN_M = 0.3

Point = tuple[float, float]
# Grid of a world, and the numbers of its course.
Task = tuple[BoolGrid, tuple[float, ...]]


class Canvas:
    """A solid block into which free places are cut."""

    def __init__(self, width_m: float, height_m: float) -> None:
        """Fill the block; its lower left corner is the origin."""
        self.grid = np.ones((round(width_m / CELL_M), round(height_m / CELL_M)), bool)
        rows, columns = np.indices(self.grid.shape)
        self.x = (rows + 0.5) * CELL_M
        self.y = (columns + 0.5) * CELL_M

    def cut(self, low: Point, high: Point, *, filled: bool = False) -> None:
        """Free a rectangle between two corners, or fill it."""
        inside = (self.x > low[0]) & (self.x < high[0])
        inside &= (self.y > low[1]) & (self.y < high[1])
        self.grid[inside] = filled

    def corridor(self, width_m: float, points: Sequence[Point]) -> None:
        """Free a corridor along axis-parallel legs."""
        half = width_m / 2.0
        for (ax, ay), (bx, by) in pairwise(points):
            low = (min(ax, bx) - half, min(ay, by) - half)
            self.cut(low, (max(ax, bx) + half, max(ay, by) + half))


def corner(width_m: float) -> Task:
    """Go round one corner of 90 degrees."""
    canvas = Canvas(6.6, 6.6)
    canvas.corridor(width_m, [(1.0, 1.0), (1.0, 5.6), (5.6, 5.6)])
    return canvas.grid, (1.0, 1.0, np.pi / 2, 5.6, 5.6)


def s_turn(width_m: float) -> Task:
    """Turn right and left again."""
    canvas = Canvas(5.6, 7.6)
    canvas.corridor(width_m, [(1.0, 1.0), (1.0, 3.8), (4.6, 3.8), (4.6, 6.6)])
    return canvas.grid, (1.0, 1.0, np.pi / 2, 4.6, 6.6)


def u_turn(width_m: float) -> Task:
    """Drive round the end of a wall, back the way beside it."""
    canvas = Canvas(3.0 + width_m, 6.6)
    far = 2.0 + width_m
    canvas.corridor(width_m, [(1.0, 1.0), (1.0, 5.6), (far, 5.6), (far, 1.0)])
    return canvas.grid, (1.0, 1.0, np.pi / 2, far, 1.0)


def weaving(width_m: float) -> Task:
    """Pass barriers from the left and the right in turn."""
    hall_m = 2.4
    canvas = Canvas(hall_m + 2 * MARGIN_M, 10.0)
    canvas.cut((MARGIN_M, MARGIN_M), (MARGIN_M + hall_m, 9.7))
    for number, y in enumerate(np.arange(2.4, 8.0, 1.7)):
        low = MARGIN_M + (width_m if number % 2 else 0.0)
        canvas.cut((low, y), (low + hall_m - width_m, y + 0.2), filled=True)
    return canvas.grid, (1.5, 1.0, np.pi / 2, 1.5, 9.0)


def angled_doorway(width_m: float) -> Task:
    """Go through a door in a wall that stands at 40 degrees to the way."""
    door_m = width_m + DOOR_MARGIN_M
    canvas = Canvas(5.0, 8.0)
    canvas.cut((MARGIN_M, MARGIN_M), (4.7, 7.7))
    angle = np.radians(40.0)
    across = (canvas.y - 4.0) * np.cos(angle) - (canvas.x - 2.5) * np.sin(angle)
    along = (canvas.x - 2.5) * np.cos(angle) + (canvas.y - 4.0) * np.sin(angle)
    is_wall = (np.abs(across) < 0.1) & (np.abs(along - 0.6) > door_m / 2.0)
    canvas.grid[is_wall] = True
    return canvas.grid, (2.5, 1.0, np.pi / 2, 2.5, 7.0)


def niche(width_m: float) -> Task:
    """Leave a niche, and turn into the narrow corridor that it is in."""
    canvas = Canvas(3.2, 8.0)
    canvas.corridor(width_m, [(2.2, 1.0), (2.2, 7.0)])
    canvas.corridor(width_m, [(1.0, 2.4), (2.2, 2.4)])
    return canvas.grid, (1.0, 2.4, 0.0, 2.2, 7.0)


def dead_end(width_m: float) -> Task:
    """Find out of a bay that opens toward the start and ends before the goal."""
    canvas = Canvas(3.6 + 2 * width_m, 8.0)
    middle = 1.8 + width_m
    canvas.cut((MARGIN_M, MARGIN_M), (2 * middle - MARGIN_M, 7.7))
    bay = middle - MARGIN_M - width_m
    canvas.cut((middle - bay, 3.0), (middle + bay, 5.4), filled=True)
    canvas.cut((middle - bay + 0.2, 2.9), (middle + bay - 0.2, 5.2))
    return canvas.grid, (middle, 1.0, np.pi / 2, middle, 7.0)


TASKS: dict[str, Callable[[float], Task]] = {
    "S-turn": s_turn,
    "U-turn": u_turn,
    "corner of 90 degrees": corner,
    "weaving": weaving,
    "doorway at an angle": angled_doorway,
    "narrow corridor with a niche": niche,
    "dead end": dead_end,
}


def draw_maneuvers() -> dict[int, World]:
    """Return all worlds by number: of each task, the widest first."""
    worlds: list[World] = []
    for name, draw in TASKS.items():
        for width, width_m in WIDTHS_M.items():
            grid, numbers = draw(width_m)
            world = build_world(
                f"{name}, {width}",
                grid,
                CELL_M,
                (0.0, 0.0),
                STANDARD_ROBOT,
                Provenance("generated", parameters={"width_m": width_m}),
                parse_course([float(number) for number in numbers], name),
            )
            worlds.append(world)
    return dict(enumerate(worlds))


if __name__ == "__main__":
    write_dataset_file(Path(sys.argv[1]), MANEUVERS, draw_maneuvers())
