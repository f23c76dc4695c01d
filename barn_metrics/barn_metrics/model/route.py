"""Where a robot would drive: cheapest routes from the paper's start to its goal, and what lies beside them.

The obstacles are squares, as on the map that planners are given, at a third of the world's resolution.
"""

import heapq
import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import njit
from scipy.ndimage import distance_transform_edt, map_coordinates, maximum_filter

from barn_worlds.base.arrays import Cells, Floats
from barn_worlds.worlds.world import World

WIDTH_REACH_M = 0.4
FINE = 3  # cells of the clearance map per cell of the world, along each side
_LEAD_CELLS, _TAIL_CELLS = (
    8,
    4,
)  # of the world, looked at before its first and beyond its last column
_SIDE_CELLS = 1
# Start and goal of the paper's trials, about the ends of the path as the original tools place it (Sec. IV).
_START_Y_M, _START_MARGIN_M = 4.075, 0.6
_GOAL_AHEAD_M = 0.30
_SAMPLE_M = 0.1
_SMOOTHED = 5  # samples
# Steps to the 8 neighbours and the 8 cells a knight's move away.
_DOWN = np.array([0, 1, 0, -1, 1, 1, -1, -1, 1, 1, -1, -1, 2, 2, -2, -2])
_RIGHT = np.array([1, 0, -1, 0, 1, -1, 1, -1, 2, -2, 2, -2, 1, -1, 1, -1])
_STEP = np.hypot(_DOWN, _RIGHT)
SAMPLES = (
    128  # points of a route that are kept, 0.1 m apart; what lies beyond is not seen
)
_ASIDE_M = np.linspace(-0.6, 0.6, 17)
_FAR_M = 0.8  # clearance that counts as free
_TURN_SCALE = 10.0  # turns from point to point are small beside headings
CHANNELS = len(_ASIDE_M) + 3
HEADING, TURN, PRESENT = CHANNELS - 3, CHANNELS - 2, CHANNELS - 1


@dataclass(frozen=True, eq=False)
class ClearanceMap:
    """Distances in metres from fine cells to the nearest obstacle; start and goal are those of the paper's trials."""

    clearance_m: Floats  # (rows, cols)
    width_m: Floats  # twice the largest clearance within `WIDTH_REACH_M`: of the passage that a cell lies in
    cell_m: float
    start: tuple[int, int]
    goal: tuple[int, int]

    def at(self, cells: Cells) -> Cells:
        """Return fine cells (n, 2), moved into the map where they are outside."""
        inside: Cells = np.clip(cells, 0, np.array(self.clearance_m.shape) - 1)
        return inside


@dataclass(frozen=True, eq=False)
class Route:
    """A route as equally spaced, smoothed samples."""

    cost_m: float  # metres where all is free
    length_m: float
    points: Floats  # (n + 1, 2) row and column in fine cells
    heading_rad: Floats  # (n,) direction of travel, 0 straight ahead, unwrapped
    clearance_m: Floats  # at each point but those at the very start and goal
    width_m: Floats


def clearance_map(world: World) -> ClearanceMap:
    """Return the clearance map of a world, the corridor in front of it included."""
    rows, cols = world.grid.shape
    squares = np.zeros(
        (rows + 2 * _SIDE_CELLS, _LEAD_CELLS + cols + _TAIL_CELLS), np.bool_
    )
    squares[_SIDE_CELLS:-_SIDE_CELLS, _LEAD_CELLS : _LEAD_CELLS + cols] = world.grid
    squares[:_SIDE_CELLS] = squares[-_SIDE_CELLS:] = True
    squares[[_SIDE_CELLS, -_SIDE_CELLS - 1], :_LEAD_CELLS] = True
    cell_m = world.resolution_m / FINE
    clearance = (
        distance_transform_edt(~np.kron(squares, np.ones((FINE, FINE), np.bool_)))
        * cell_m
    )
    reach = round(WIDTH_REACH_M / cell_m)
    width = 2.0 * maximum_filter(clearance, size=2 * reach + 1)
    first, last = world.path_m(historical=True)[[0, -1]]
    start_x_m = np.clip(first[0], world.bounds_m[0] + _START_MARGIN_M, -_START_MARGIN_M)
    ends = np.array([(start_x_m, _START_Y_M), (last[0], last[1] + _GOAL_AHEAD_M)])
    # y runs along columns; the first row of cells lies at the lowest x.
    from_y_m = world.bounds_m[3] - (cols + _LEAD_CELLS) * world.resolution_m
    corner = np.array([world.bounds_m[0] - _SIDE_CELLS * world.resolution_m, from_y_m])
    cells = np.clip(
        np.floor((ends - corner) / cell_m).astype(np.int64),
        1,
        np.array(clearance.shape) - 2,
    )
    start, goal = ((int(row), int(column)) for row, column in cells)
    return ClearanceMap(clearance, width, cell_m, start, goal)


def cheapest_route(where: ClearanceMap, cost_per_m: Floats) -> Route:
    """Return the cheapest route from start to goal at a cost per metre (rows, cols) of at least 1."""
    cost, cells = _search(cost_per_m, *where.start, *where.goal)
    steps_m = np.hypot(*np.diff(cells, axis=0).T) * where.cell_m
    along = np.append(0.0, np.cumsum(steps_m))
    places = np.linspace(0.0, along[-1], max(int(along[-1] / _SAMPLE_M), _SMOOTHED) + 1)
    points = np.stack(
        [_smooth(np.interp(places, along, cells[:, axis])) for axis in (0, 1)], axis=1
    )
    heading = np.unwrap(np.arctan2(*np.diff(points, axis=0).T))
    row, column = where.at(np.round(points).astype(np.int64)).T
    inner = (
        slice(round(0.8 / _SAMPLE_M), -round(0.3 / _SAMPLE_M))
        if len(places) > 15
        else slice(None)
    )
    clearance, width = (
        where.clearance_m[row, column][inner],
        where.width_m[row, column][inner],
    )
    return Route(
        cost * where.cell_m, float(along[-1]), points, heading, clearance, width
    )


def _smooth(values: Floats) -> Floats:
    """Return the moving average (n,) of values (n,) over `_SMOOTHED` of them, the ends repeated."""
    reach = _SMOOTHED // 2
    window = np.full(_SMOOTHED, 1.0 / _SMOOTHED)
    return np.convolve(np.pad(values, reach, mode="edge"), window, "valid")


@njit(cache=True)
def _search(
    cost: Floats, start_row: int, start_column: int, goal_row: int, goal_column: int
) -> tuple[float, Cells]:
    """Return the cost of the cheapest route and its cells (n, 2): A* over 16 directions at costs of at least 1."""
    rows, cols = cost.shape
    total = np.full(rows * cols, math.inf)
    parent = np.full(rows * cols, -1, np.int64)
    done = np.zeros(rows * cols, np.bool_)
    goal = goal_row * cols + goal_column
    total[start_row * cols + start_column] = 0.0
    heap = [(0.0, start_row * cols + start_column)]
    while len(heap) > 0:
        _, cell = heapq.heappop(heap)
        if done[cell]:
            continue
        done[cell] = True
        if cell == goal:
            break
        row, column = cell // cols, cell % cols
        for k in range(len(_STEP)):
            r, c = row + _DOWN[k], column + _RIGHT[k]
            if r < 0 or c < 0 or r >= rows or c >= cols:
                continue
            reached = total[cell] + _STEP[k] * 0.5 * (cost[row, column] + cost[r, c])
            if reached < total[r * cols + c]:
                total[r * cols + c] = reached
                parent[r * cols + c] = cell
                remaining = math.hypot(r - goal_row, c - goal_column)
                heapq.heappush(heap, (reached + remaining, r * cols + c))
    count, cell = 0, goal
    while cell >= 0:
        count, cell = count + 1, parent[cell]
    cells = np.empty((count, 2), np.int64)
    cell = goal
    for index in range(count - 1, -1, -1):
        cells[index, 0], cells[index, 1] = cell // cols, cell % cols
        cell = parent[cell]
    return total[goal], cells


def route_strip(where: ClearanceMap, route: Route) -> Floats:
    """Return what lies beside a route, (SAMPLES, CHANNELS), zero after its end.

    Channels: the clearance on a line across the route, from -1 (none) to 1 (`_FAR_M` and more), from left to right;
    heading in radians; change of heading per sample, scaled; 1 where there is a sample.
    """
    points = route.points[:SAMPLES]
    along = np.gradient(points, axis=0)
    heading = np.unwrap(np.arctan2(along[:, 0], along[:, 1]))
    aside = np.stack([np.cos(heading), -np.sin(heading)])[:, :, None] * (
        _ASIDE_M / where.cell_m
    )
    clearance = map_coordinates(
        where.clearance_m, points.T[:, :, None] + aside, order=1, mode="nearest"
    )
    strip = np.zeros((SAMPLES, CHANNELS))
    seen = strip[: len(points)]
    seen[:, :HEADING] = np.minimum(clearance, _FAR_M) / (0.5 * _FAR_M) - 1.0
    seen[:, HEADING], seen[:, TURN], seen[:, PRESENT] = (
        heading,
        _TURN_SCALE * np.gradient(heading),
        1.0,
    )
    return strip


def mirror_strips(strips: Floats) -> Floats:
    """Return strips (..., CHANNELS) of the same routes in mirrored worlds."""
    other: Floats = strips.copy()
    other[..., :HEADING] = strips[..., HEADING - 1 :: -1]
    other[..., HEADING : TURN + 1] *= -1.0
    return other


@cache
def strip_names(route: str) -> tuple[str, ...]:
    """Return the names of the numbers of a route's strip, flattened."""
    channels = [
        *(f"clearance_{aside:+.3f}_m" for aside in _ASIDE_M),
        "heading",
        "turn",
        "present",
    ]
    return tuple(
        f"{route}_{sample}_{channel}"
        for sample in range(SAMPLES)
        for channel in channels
    )
