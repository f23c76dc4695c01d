"""The positions of a world's cells in metres.

All positions are in the Gazebo world frame of the original files, which the suite uses as its map frame. The robot
drives in +y: rows lie along x, columns along y. A standard world (30 x 30 cells of 0.15 m) is 4.5 m wide; its cells
are at x = -4.425 + 0.15 row and y = 5.175 + 0.15 column. Its containment (a back wall and two side walls of the same
cylinders) encloses the 5.1 m in front of column 0, where robots start. Worlds of other sizes keep the right-hand side
wall at x = 0 and the same distance in front.
"""

import math

import numpy as np

from barn_worlds.arrays import BoolGrid, Cells, Points
from barn_worlds.cspace import configuration_space

LEAD_IN_M = 5.1  # from the outside of the back wall to the first column
MARGIN_M = 0.3  # of the map beyond the last column
CYLINDER_HEIGHT_M = 1.0
STANDARD_CELL_M = 0.15  # of the original data set


def lead_in_cells(resolution_m: float) -> int:
    """Return the number of cells, back wall included, in front of column 0: 34 at 0.15 m."""
    return max(1, math.ceil(LEAD_IN_M / resolution_m - 1e-9))


def margin_cells(resolution_m: float) -> int:
    """Return the number of cells of the map beyond the last column: 2 at 0.15 m."""
    return math.ceil(MARGIN_M / resolution_m - 1e-9)


def cell_centres(cells: Cells, rows: int, resolution_m: float) -> Points:
    """Return the true centres (n, 2) in metres of cells (n, 2) of a world with that many rows."""
    row, column = cells[:, 0], cells[:, 1]
    front = lead_in_cells(resolution_m)
    centres: Points = np.stack([resolution_m * (row + 0.5 - rows), resolution_m * (column + 0.5 + front)], axis=1)
    return centres


def historical_cell_centres(cells: Cells, rows: int, resolution_m: float) -> Points:
    """Return cells (n, 2) in metres as the original tools convert their path files, (n, 2).

    That is one cell too low in x and two thirds of a cell too low in y (0.15 and 0.10 m for the standard world). Use it
    only to reproduce numbers that contain this offset, such as the goals of the paper's trials.
    """
    off = np.array([resolution_m, resolution_m * 2.0 / 3.0])
    shifted: Points = cell_centres(cells, rows, resolution_m) - off
    return shifted


def containing_cells(points: Points, rows: int, resolution_m: float) -> Cells:
    """Return the cells (n, 2) in which points (n, 2) in metres lie; they may be outside the grid."""
    front = lead_in_cells(resolution_m)
    cells: Cells = np.floor(points / resolution_m).astype(np.int64) + np.array([rows, -front])
    return cells


def containment_cells(rows: int, resolution_m: float) -> Cells:
    """Return the cells (m, 2), with negative columns, of the back wall and the two side walls."""
    front = lead_in_cells(resolution_m)
    back = [(row, -front) for row in range(rows)]
    sides = [(row, column) for column in range(1 - front, 0) for row in sorted({0, rows - 1})]
    return np.array(back + sides, np.int64).reshape(-1, 2)


def hollow(grid: BoolGrid) -> BoolGrid:
    """Return the filled cells (rows, cols) whose 8 neighbours are all filled; never one on the border.

    The .world files leave them out, since nothing can touch them.
    """
    near_free = configuration_space(~np.pad(grid, 1), 3)  # beyond the border all is free
    inner: BoolGrid = ~near_free[1:-1, 1:-1]
    return inner
