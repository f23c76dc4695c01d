"""The path through a world: planned on the C-space with limited turns (paper, section III-A)."""

import math
from dataclasses import dataclass

import numpy as np

from barn_worlds.arrays import BoolGrid, Cells, Floats, Integers
from barn_worlds.config import Checked, quantity
from barn_worlds.cspace import through_region
from barn_worlds.errors import WorldError
from barn_worlds.search import search


@dataclass(frozen=True)
class PathConfig(Checked):
    """How the path is searched.

    `original` agrees best with the published paths (24 of the 50 shared ones are equal cell by cell, the mean length
    differs by 0.02 cells). It uses no estimate of the remaining distance, and a cell keeps its first predecessor. With
    `complete`, and whenever `original` finds nothing, A* over cells and directions finds a path if there is one. Its
    paths are shorter and nearer to obstacles (by 1.4 and 0.2 cells on average over the shared worlds).
    """

    search: str = quantity("original", "order of the search", choices=("original", "complete"))
    largest_turn_steps: int = quantity(
        1, "largest turn between two steps, in steps of 45 degrees", minimum=1, maximum=4
    )
    inflation_cells: float = quantity(
        2.0, "cells this close to obstacles are searched later", "cells", minimum=0.0, maximum=20.0
    )
    inflation_weight: float = quantity(
        5.0, "penalty at distance 1, inversely proportional to the distance", "cells", minimum=0.0, maximum=1000.0
    )


DEFAULT = PathConfig()


def plan_path(
    cspace: BoolGrid, start: tuple[int, int], goal: tuple[int, int], config: PathConfig = DEFAULT
) -> Cells | None:
    """Return a path (n, 2) of free cells from start to goal, both included, or None if there is none.

    Steps go to the 8 neighbours, but not between two occupied cells that touch at a corner; turns are limited. The
    inflation term, weight / distance to the closest occupied cell, affects a cell's priority but not its cost. The
    same input gives the same path. Raises WorldError for a cell outside the grid.
    """
    rows, cols = cspace.shape
    for row, column in (start, goal):
        if not (0 <= row < rows and 0 <= column < cols):
            raise WorldError(f"cell ({row}, {column}) is outside the grid of {rows} x {cols} cells")
        if cspace[row, column]:
            return None
    free = np.ascontiguousarray(~cspace)
    first, last = start[0] * cols + start[1], goal[0] * cols + goal[1]
    penalty = inflation(cspace, config)
    for complete in (False, True) if config.search == "original" else (True,):
        path: Cells = search(free, penalty, first, last, config.largest_turn_steps, complete)
        if len(path):
            return path
    return None


def plan_through(cspace: BoolGrid, config: PathConfig = DEFAULT) -> Cells | None:
    """Return a path (n, 2) from the first to the last column, or None if there is none.

    Start and goal are the cells in the first and the last column that are closest to the middle of the region that
    leads through (the lower row of two).
    """
    region = through_region(cspace)
    if region is None:
        return None
    ends = [_middle(np.flatnonzero(region[:, column])) for column in (0, -1)]
    return plan_path(cspace, (ends[0], 0), (ends[1], cspace.shape[1] - 1), config)


def inflation(cspace: BoolGrid, config: PathConfig = DEFAULT) -> Floats:
    """Return the penalty on each cell's priority (rows, cols): weight / distance, 0 beyond the inflation distance.

    Distances are Euclidean, in cells, to occupied C-space cells; the border of the grid is no obstacle.
    """
    rows, cols = cspace.shape
    reach = math.floor(config.inflation_cells)
    padded = np.pad(cspace, reach)
    penalty = np.zeros((rows, cols))
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            distance = math.hypot(down, right)
            if 0.0 < distance <= config.inflation_cells:
                near = padded[reach + down : reach + down + rows, reach + right : reach + right + cols]
                np.maximum(penalty, near * (config.inflation_weight / distance), out=penalty)
    return penalty


def _middle(rows: Integers) -> int:
    """Return the row that is closest to the mean of the rows, the first of equals."""
    return int(rows[np.argmin(np.abs(rows - rows.mean()))])
