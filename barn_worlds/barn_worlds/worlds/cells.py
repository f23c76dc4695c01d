"""The positions of a world's cells in metres, and its occupancy map for planners that are given one.

All positions are in the Gazebo world frame of the original files, which the suite uses as its map frame. The robot
drives in +y: rows lie along x, columns along y. A standard world (30 x 30 cells of 0.15 m) is 4.5 m wide; its cells
are at x = -4.425 + 0.15 row and y = 5.175 + 0.15 column. Its containment (a back wall and two side walls of the same
cylinders) encloses the 5.1 m in front of column 0, where robots start. Worlds of other sizes keep the right-hand side
wall at x = 0 and the same distance in front.
"""

import math
from functools import cache

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_worlds.base.arrays import BoolGrid, Cells, Points
from barn_worlds.base.errors import WorldError
from barn_worlds.base.types import OccupancyMap
from barn_worlds.worlds.cspace import configuration_space

LEAD_IN_M = 5.1  # from the outside of the back wall to the first column
MARGIN_M = 0.3  # of the map beyond the last column
CYLINDER_HEIGHT_M = 1.0
STANDARD_CELL_M = 0.15  # of the original data set
OCCUPIED = 100
LARGEST_MAP = 16_000_000  # cells


def lead_in_cells(resolution_m: float) -> int:
    """Return the number of cells, back wall included, in front of column 0: 34 at 0.15 m."""
    return max(1, math.ceil(LEAD_IN_M / resolution_m - 1e-9))


def margin_cells(resolution_m: float) -> int:
    """Return the number of cells of the map beyond the last column: 2 at 0.15 m."""
    return math.ceil(MARGIN_M / resolution_m - 1e-9)


def cell_centers(cells: Cells, rows: int, resolution_m: float) -> Points:
    """Return the true centres (n, 2) in metres of cells (n, 2) of a world with that many rows."""
    centres: Points = resolution_m * (
        cells + 0.5 + np.array([-rows, lead_in_cells(resolution_m)])
    )
    return centres


def containing_cells(points: Points, rows: int, resolution_m: float) -> Cells:
    """Return the cells (n, 2) in which points (n, 2) in metres lie; they may be outside the grid."""
    cells: Cells = np.floor(points / resolution_m).astype(np.int64) + np.array(
        [rows, -lead_in_cells(resolution_m)]
    )
    return cells


@cache
def containment_cells(rows: int, resolution_m: float) -> Cells:
    """Return the cells (m, 2), with negative columns, of the back wall and the two side walls."""
    front = lead_in_cells(resolution_m)
    back = [(row, -front) for row in range(rows)]
    sides = [
        (row, column) for column in range(1 - front, 0) for row in sorted({0, rows - 1})
    ]
    cells = np.array(back + sides, np.int64).reshape(-1, 2)
    cells.flags.writeable = False
    return cells


def hollow_cells(grid: BoolGrid) -> BoolGrid:
    """Return the filled cells (rows, cols) whose 8 neighbours are all filled; never one on the border.

    The .world files leave them out, since nothing can touch them.
    """
    free = np.pad(~grid, 1, constant_values=True)  # as all is beyond the border
    inner: BoolGrid = ~configuration_space(free, 3)[1:-1, 1:-1]
    return inner


def world_map(
    grid: BoolGrid,
    cell_m: float,
    resolution_m: float | None = None,
    *,
    historical: bool = False,
    corner_m: tuple[float, float] | None = None,
) -> OccupancyMap:
    """Return the occupancy map of a grid with its containment; nothing is unknown.

    cell_m: size of the grid's cells. resolution_m: of the map. With None it is the grid's, and each filled cell is one
    occupied cell (30 x 66 for the standard world). At any other resolution every cell that a cylinder reaches into is
    occupied. Cells that the .world files leave out are occupied as well. historical: shift the grid one cell towards
    the start, as in the maps of the original data set (0.15 m off the obstacles). corner_m: of an arena; its map is
    that of its cells, never historical. Raises WorldError for a resolution out of range.
    """
    rows, cols = grid.shape
    cells = np.argwhere(grid)
    front, high, origin = 0, cols, corner_m
    if origin is None:
        front, origin = lead_in_cells(cell_m), (-rows * cell_m, 0.0)
        cells = np.concatenate(
            [
                cells - np.array([0, 1 if historical else 0]),
                containment_cells(rows, cell_m),
            ]
        )
        high = front + cols + margin_cells(cell_m)
    if resolution_m is None or resolution_m == cell_m:
        data = np.zeros((high, rows), np.int8)
        data[cells[:, 1] + front, cells[:, 0]] = OCCUPIED
        return OccupancyMap(data, cell_m, *origin)
    if not (math.isfinite(resolution_m) and resolution_m >= 0.005):
        raise WorldError(
            f"resolution of a map must be at least 0.005 m, got {resolution_m}"
        )
    size = tuple(
        math.ceil(side * cell_m / resolution_m - 1e-6) for side in (high, rows)
    )
    if size[0] * size[1] > LARGEST_MAP:
        sides = f"{size[0]} x {size[1]}"
        raise WorldError(
            f"a map of {sides} cells is too large, at most {LARGEST_MAP} cells; use a coarser one"
        )
    data = np.zeros(size, np.int8)
    centres = cell_centers(cells, rows, cell_m) - np.array(origin)
    if corner_m is not None:
        centres = (cells + 0.5) * cell_m
    _occupy_discs(data, centres, cell_m / 2.0, resolution_m)
    return OccupancyMap(data, resolution_m, *origin)


def occupy_box(
    grid: OccupancyMap,
    centre: tuple[float, float],
    size: tuple[float, float],
    yaw: float,
) -> None:
    """Occupy the cells of a map whose inside a box reaches: its centre and sides in m, its heading in rad."""
    height, width = grid.data.shape
    half, cos, sin = (
        grid.resolution / 2.0 * (1.0 - 1e-9),
        abs(math.cos(yaw)),
        abs(math.sin(yaw)),
    )
    dx = grid.origin_x + grid.resolution * (np.arange(width) + 0.5)[None, :] - centre[0]
    dy = (
        grid.origin_y + grid.resolution * (np.arange(height) + 0.5)[:, None] - centre[1]
    )
    long, wide = size[0] / 2.0, size[1] / 2.0
    # two rectangles meet unless a side of one of them lies between them
    inside = (np.abs(dx) < half + long * cos + wide * sin) & (
        np.abs(dy) < half + long * sin + wide * cos
    )
    inside &= np.abs(dx * math.cos(yaw) + dy * math.sin(yaw)) < long + half * (
        cos + sin
    )
    inside &= np.abs(dy * math.cos(yaw) - dx * math.sin(yaw)) < wide + half * (
        cos + sin
    )
    grid.data[inside] = OCCUPIED


@njit(cache=True)
def _occupy_discs(
    data: npt.NDArray[np.int8], centres: Points, radius: float, resolution: float
) -> None:
    """Occupy the cells of data (row along y, column along x) whose inside a disc reaches."""
    height, width = data.shape
    reach = radius * (1.0 - 1e-9)
    for k in range(len(centres)):
        x, y = centres[k]
        for row in range(
            max(0, int((y - radius) / resolution)),
            min(height, int((y + radius) / resolution) + 1),
        ):
            dy = max(row * resolution - y, 0.0, y - (row + 1) * resolution)
            for column in range(
                max(0, int((x - radius) / resolution)),
                min(width, int((x + radius) / resolution) + 1),
            ):
                dx = max(column * resolution - x, 0.0, x - (column + 1) * resolution)
                if dx * dx + dy * dy < reach * reach:
                    data[row, column] = OCCUPIED
