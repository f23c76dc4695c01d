"""Positions of a world's cells in meters, and the map that planners get.

All positions are in the Gazebo world frame of the original files, which the suite uses
as its map frame. The robot drives in +y: rows lie along x, columns along y. A standard
world (30 x 30 cells of 0.15 m) is 4.5 m wide; its cells are at x = -4.425 + 0.15 row
and y = 5.175 + 0.15 column. The containment, a back wall and two side walls of the same
cylinders, encloses the 5.1 m in front of column 0, where robots start. Worlds of other
sizes keep the right side wall at x = 0 and 5.1 m, or 18 columns, in front.
"""

import math
from functools import cache

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Cells, Points, SignedBytes, strict_kernel
from barn_worlds.base.errors import WorldError
from barn_worlds.base.types import OccupancyMap
from barn_worlds.moving.motion import Wall
from barn_worlds.worlds.cspace import configuration_space

# From the outside of the back wall to the first column.
LEAD_IN_M = 5.1
# Or as many columns, if these are longer: a robot of more than twice the Jackal's size,
# whose cells are large, would not fit behind the start otherwise.
_FEWEST_LEAD_IN_CELLS = 18
# Of the map beyond the last column.
MARGIN_M = 0.3
CYLINDER_HEIGHT_M = 1.0
# Of the original data set.
STANDARD_CELL_M = 0.15
OCCUPIED = 100
# In cells.
LARGEST_MAP = 16_000_000
_SMALLEST_MAP_CELL_M = 0.005


def lead_in_cells(resolution_m: float) -> int:
    """Return the number of columns before column 0, at least 18, with the back wall."""
    # The tolerance keeps 5.1 / 0.15, which is slightly above 34, at 34 cells.
    return max(math.ceil(LEAD_IN_M / resolution_m - 1e-9), _FEWEST_LEAD_IN_CELLS)


def margin_cells(resolution_m: float) -> int:
    """Return the number of columns that a map shows beyond the world's last one."""
    return math.ceil(MARGIN_M / resolution_m - 1e-9)


def cell_centers(cells: Cells, rows: int, resolution_m: float) -> Points:
    """Return centers x, y (n, 2) in m, map frame, of cells (row: along x, column: y).

    Args:
        cells: (n, 2) row and column.
        rows: Number of rows of the world, from which x is counted.
        resolution_m: Size of a cell.

    Returns:
        x and y (n, 2) in the map frame.
    """
    corner = np.array([-rows, lead_in_cells(resolution_m)])
    centers: Points = resolution_m * (cells + 0.5 + corner)
    return centers


def containing_cells(points: Points, rows: int, resolution_m: float) -> Cells:
    """Return the cells (row from x, column from y), (n, 2), that contain points in m.

    They may be outside the grid: below 0, or past the last row or column.

    Args:
        points: x and y (n, 2) in the map frame.
        rows: Number of rows of the world, from which x is counted.
        resolution_m: Size of a cell.
    """
    corner = np.array([rows, -lead_in_cells(resolution_m)])
    cells: Cells = np.floor(points / resolution_m).astype(np.int64) + corner
    return cells


@cache
def containment_cells(rows: int, resolution_m: float) -> Cells:
    """Return row, column (m, 2) of the cells of back wall and side walls, read-only.

    Args:
        rows: Number of rows of the world, which the back wall closes.
        resolution_m: Size of a cell, which decides how many columns lie in front.

    Returns:
        Rows and columns; the columns are negative.
    """
    front = lead_in_cells(resolution_m)
    # Column by column, the back wall first. A world of one row has one side wall.
    is_wall = np.zeros((front, rows), np.bool_)
    is_wall[0] = True
    is_wall[:, [0, -1]] = True
    columns, wall_rows = np.argwhere(is_wall).T
    containment = np.column_stack([wall_rows, columns - front])
    # The cache hands out one array to all.
    containment.flags.writeable = False
    return containment


def hollow_cells(grid: BoolGrid) -> BoolGrid:
    """Return a mask (rows, cols), True at filled cells with 8 filled neighbors.

    The .world files leave them out, since nothing can touch them. A cell on the border
    is never hollow.
    """
    free = np.pad(~grid, 1, constant_values=True)
    return ~configuration_space(free, 3)[1:-1, 1:-1]


def world_map(
    grid: BoolGrid,
    cell_m: float,
    resolution_m: float | None = None,
    *,
    historical: bool = False,
    corner_m: tuple[float, float] | None = None,
) -> OccupancyMap:
    """Return the occupancy map of a grid, with its containment unless corner_m is set.

    No cell is unknown. Straight walls and what moves are not in it.

    Cells that the .world files leave out are occupied as well.

    Args:
        grid: (rows, cols), True where filled.
        cell_m: Size of the grid's cells.
        resolution_m: Size of the map's cells. By default that of the grid's: each
            filled cell becomes one occupied cell (30 x 66 for the standard world). At
            any other resolution every cell that a cylinder reaches into is occupied.
        historical: Shift the grid one cell toward the start, as the maps of the
            original data set do (0.15 m off the obstacles).
        corner_m: Outer corner of cell (0, 0) of an arena. Its map has no containment
            and is never historical.

    Raises:
        WorldError: If the resolution is too fine.
    """
    rows, cols = grid.shape
    cells = np.argwhere(grid)
    if corner_m is None:
        origin = (-rows * cell_m, 0.0)
        front = lead_in_cells(cell_m)
        length = front + cols + margin_cells(cell_m)
        # Occupied cells move; the containment is where it really is.
        if historical:
            cells = cells - np.array([0, 1])
        cells = np.concatenate([cells, containment_cells(rows, cell_m)])
    else:
        origin = corner_m
        front = 0
        length = cols

    if resolution_m is None or resolution_m == cell_m:
        data = np.zeros((length, rows), np.int8)
        rows_x, columns_y = cells.T
        data[columns_y + front, rows_x] = OCCUPIED
        return OccupancyMap(data, cell_m, *origin)

    if not (math.isfinite(resolution_m) and resolution_m >= _SMALLEST_MAP_CELL_M):
        raise WorldError(
            f"resolution of a map must be at least {_SMALLEST_MAP_CELL_M} m, "
            f"got {resolution_m}"
        )
    # The last cells may reach beyond the world.
    height = math.ceil(length * cell_m / resolution_m - 1e-6)
    width = math.ceil(rows * cell_m / resolution_m - 1e-6)
    if height * width > LARGEST_MAP:
        raise WorldError(
            f"a map of {height} x {width} cells is too large, "
            f"at most {LARGEST_MAP} cells; use a coarser one"
        )
    data = np.zeros((height, width), np.int8)
    centers: Points = np.asarray((cells + 0.5) * cell_m, np.float64)
    if corner_m is None:
        centers = cell_centers(cells, rows, cell_m)
        centers -= np.array(origin)
    _occupy_discs(data, centers, cell_m / 2.0, resolution_m)
    return OccupancyMap(data, resolution_m, *origin)


def occupy_wall(occupancy_map: OccupancyMap, wall: Wall) -> None:
    """Set to occupied, in place, the cells of a map that a straight wall reaches into.

    Args:
        occupancy_map: The map, which is changed.
        wall: Seen from above, a turned rectangle.
    """
    height, width = occupancy_map.data.shape
    resolution = occupancy_map.resolution
    columns = (np.arange(width) + 0.5)[None, :]
    rows = (np.arange(height) + 0.5)[:, None]
    dx = occupancy_map.origin_x + resolution * columns - wall.x_m
    dy = occupancy_map.origin_y + resolution * rows - wall.y_m

    # A wall that only touches a cell's border does not reach into it.
    half = resolution / 2.0 * (1.0 - 1e-9)
    half_length = wall.size_x_m / 2.0
    half_width = wall.size_y_m / 2.0
    cos = math.cos(wall.yaw_rad)
    sin = math.sin(wall.yaw_rad)
    along = np.abs(dx * cos + dy * sin)
    across = np.abs(dy * cos - dx * sin)
    cos = abs(cos)
    sin = abs(sin)
    corner = half * (cos + sin)

    # Two rectangles overlap unless a side of one of them separates them.
    inside_x = np.abs(dx) < half + half_length * cos + half_width * sin
    inside_y = np.abs(dy) < half + half_length * sin + half_width * cos
    inside = inside_x & inside_y
    inside &= along < half_length + corner
    inside &= across < half_width + corner
    occupancy_map.data[inside] = OCCUPIED


@strict_kernel
def _occupy_discs(
    data: SignedBytes, centers: Points, radius: float, resolution: float
) -> None:
    """Occupy, in place, the cells of data (row: y, column: x) that discs reach into.

    Centers are in m from the outer corner of data[0, 0].
    """
    height, width = data.shape
    # A disc that only touches a cell's border does not reach into it.
    reach = radius * (1.0 - 1e-9)
    for k in range(len(centers)):
        x, y = centers[k]
        first_row = max(0, int((y - radius) / resolution))
        end_row = min(height, int((y + radius) / resolution) + 1)
        first_column = max(0, int((x - radius) / resolution))
        end_column = min(width, int((x + radius) / resolution) + 1)
        for row in range(first_row, end_row):
            dy = max(row * resolution - y, 0.0, y - (row + 1) * resolution)
            for column in range(first_column, end_column):
                dx = max(column * resolution - x, 0.0, x - (column + 1) * resolution)
                if dx * dx + dy * dy < reach * reach:
                    data[row, column] = OCCUPIED
