"""Worlds as occupancy maps, for planners that are given a map."""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_worlds import geometry
from barn_worlds.arrays import BoolGrid, Points
from barn_worlds.errors import WorldError
from barn_worlds.types import OccupancyMap

OCCUPIED = 100
LARGEST_MAP = 16_000_000  # cells


def world_map(
    grid: BoolGrid,
    cell_m: float,
    resolution_m: float | None = None,
    *,
    historical: bool = False,
) -> OccupancyMap:
    """Return the occupancy map of a grid with its containment; nothing is unknown.

    cell_m: size of the grid's cells. resolution_m: of the map. With None it is the grid's, and each filled cell is one
    occupied cell (30 x 66 for the standard world). At any other resolution every cell that a cylinder reaches into is
    occupied. Cells that the .world files leave out are occupied as well. historical: shift the grid one cell towards
    the start, as in the maps of the original data set (0.15 m off the obstacles). Raises WorldError for a resolution
    out of range.
    """
    rows, cols = grid.shape
    front = geometry.lead_in_cells(cell_m)
    cells = np.argwhere(grid) - np.array([0, 1 if historical else 0])
    cells = np.concatenate([cells, geometry.containment_cells(rows, cell_m)])
    high = front + cols + geometry.margin_cells(cell_m)
    origin = -rows * cell_m, 0.0
    if resolution_m is None or resolution_m == cell_m:
        data = np.zeros((high, rows), np.int8)
        data[cells[:, 1] + front, cells[:, 0]] = OCCUPIED
        return OccupancyMap(data, cell_m, *origin)
    if not (math.isfinite(resolution_m) and resolution_m >= 0.005):
        raise WorldError(f"resolution of a map must be at least 0.005 m, got {resolution_m}")
    size = _ceil(high * cell_m / resolution_m), _ceil(rows * cell_m / resolution_m)
    if size[0] * size[1] > LARGEST_MAP:
        raise WorldError(
            f"a map of {size[0]} x {size[1]} cells is too large, at most {LARGEST_MAP} cells; use a coarser one"
        )
    data = np.zeros(size, np.int8)
    _occupy_discs(data, geometry.cell_centres(cells, rows, cell_m) - np.array(origin), cell_m / 2.0, resolution_m)
    return OccupancyMap(data, resolution_m, *origin)


def _ceil(number: float) -> int:
    return math.ceil(number - 1e-6)


@njit(cache=True)
def _occupy_discs(data: npt.NDArray[np.int8], centres: Points, radius: float, resolution: float) -> None:
    """Occupy the cells of data (row along y, column along x) whose inside a disc reaches."""
    height, width = data.shape
    reach = radius * (1.0 - 1e-9)
    for k in range(len(centres)):
        x, y = centres[k]
        for row in range(max(0, int((y - radius) / resolution)), min(height, int((y + radius) / resolution) + 1)):
            dy = max(row * resolution - y, 0.0, y - (row + 1) * resolution)
            for column in range(max(0, int((x - radius) / resolution)), min(width, int((x + radius) / resolution) + 1)):
                dx = max(column * resolution - x, 0.0, x - (column + 1) * resolution)
                if dx * dx + dy * dy < reach * reach:
                    data[row, column] = OCCUPIED
