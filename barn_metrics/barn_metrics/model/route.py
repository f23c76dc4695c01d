"""Cheapest routes for a robot from the paper's start to its goal.

Obstacles are squares, as on the map that planners get, at a third of the world's
resolution.
"""

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates, maximum_filter

from barn_worlds.base.arrays import Cells, Floats, side_lengths, strict_kernel
from barn_worlds.worlds.path_planner import trace
from barn_worlds.worlds.world import World

WIDTH_REACH_M = 0.4
# Cells of the clearance map per cell of the world, along each side.
FINE = 3
# Cells of the world that are looked at before its first and beyond its last column, and
# beyond each side wall.
_LEAD_CELLS = 8
_TAIL_CELLS = 4
_SIDE_CELLS = 1
# Start and goal of the paper's trials, relative to the ends of the path as the original
# tools place it (Sec. IV).
_START_Y_M = 4.075
_START_MARGIN_M = 0.6
_GOAL_AHEAD_M = 0.30
_SAMPLE_M = 0.1
# Samples that are averaged.
_SMOOTHING = 5
# Samples at the very start and goal whose clearance does not count.
_START_SAMPLES = round(0.8 / _SAMPLE_M)
_GOAL_SAMPLES = round(0.3 / _SAMPLE_M)
# Steps to the 8 neighbors and the 8 cells a knight's move away.
_ROW_STEPS = np.array([0, 1, 0, -1, 1, 1, -1, -1, 1, 1, -1, -1, 2, 2, -2, -2])
_COLUMN_STEPS = np.array([1, 0, -1, 0, 1, -1, 1, -1, 2, -2, 2, -2, 1, -1, 1, -1])
_STEP_LENGTHS = np.hypot(_ROW_STEPS, _COLUMN_STEPS)

# Points of a route that a strip has, 0.1 m apart; the model does not see what lies
# beyond.
SAMPLES = 128
# Places of a strip across the route, to its left and right.
_ACROSS_M = np.linspace(-0.6, 0.6, 17)
# Clearance that counts as free.
_FREE_M = 0.8
# Turns from point to point are small beside headings.
_TURN_SCALE = 10.0
HEADING = len(_ACROSS_M)
TURN = HEADING + 1
PRESENT = HEADING + 2
CHANNELS = HEADING + 3


@dataclass(frozen=True, eq=False)
class ClearanceMap:
    """Distances from fine cells to the nearest obstacle, with a start and a goal."""

    # (rows, cols)
    clearance_m: Floats
    # Width of the passage that a cell lies in: twice the largest clearance within
    # `WIDTH_REACH_M`, (rows, cols).
    width_m: Floats
    cell_m: float
    # Row and column of the start and goal of the paper's trials.
    start: Sequence[int]
    goal: Sequence[int]


@dataclass(frozen=True, eq=False)
class Route:
    """A route as equally spaced, smoothed samples."""

    # In meters where everything is free.
    cost_m: float
    length_m: float
    # (n + 1, 2) row and column in fine cells.
    points: Floats
    # (n,) direction of travel, 0 straight ahead, unwrapped.
    heading_rad: Floats
    # At each point but those at the very start and goal.
    clearance_m: Floats
    width_m: Floats


def clearance_map(world: World) -> ClearanceMap:
    """Return clearances (m) of a world in cells a third as large, with start and goal.

    The corridor in front of the world is part of the map.
    """
    rows, cols = world.grid.shape
    shape = (rows + 2 * _SIDE_CELLS, _LEAD_CELLS + cols + _TAIL_CELLS)
    squares = np.zeros(shape, np.bool_)
    squares[_SIDE_CELLS:-_SIDE_CELLS, _LEAD_CELLS : _LEAD_CELLS + cols] = world.grid
    squares[:_SIDE_CELLS] = True
    squares[-_SIDE_CELLS:] = True
    # The side walls of the containment.
    squares[[_SIDE_CELLS, -_SIDE_CELLS - 1], :_LEAD_CELLS] = True

    cell_m = world.resolution_m / FINE
    fine_squares = np.kron(squares, np.ones((FINE, FINE), np.bool_))
    clearance = distance_transform_edt(~fine_squares) * cell_m
    reach = round(WIDTH_REACH_M / cell_m)
    width = 2.0 * maximum_filter(clearance, size=2 * reach + 1)

    left_m, _, _, top_m = world.bounds_m
    first, last = world.path_m(historical=True)[[0, -1]]
    start_x_m = np.clip(first[0], left_m + _START_MARGIN_M, -_START_MARGIN_M)
    ends_m = np.array([(start_x_m, _START_Y_M), (last[0], last[1] + _GOAL_AHEAD_M)])
    # Rows begin at the lowest x, columns at the lowest y of the map.
    corner_m = np.array(
        [
            left_m - _SIDE_CELLS * world.resolution_m,
            top_m - (cols + _LEAD_CELLS) * world.resolution_m,
        ]
    )
    cells = np.floor((ends_m - corner_m) / cell_m).astype(np.int64)
    cells = np.clip(cells, 1, np.array(clearance.shape) - 2)
    start, goal = cells.tolist()
    return ClearanceMap(clearance, width, cell_m, start, goal)


def cheapest_route(clearance: ClearanceMap, cost_per_m: Floats) -> Route:
    """Return the cheapest route from start to goal, smoothed and sampled each 0.1 m.

    Args:
        clearance: The map.
        cost_per_m: Cost per meter of each cell (rows, cols), at least 1.
    """
    cost, cells = _search(cost_per_m, *clearance.start, *clearance.goal)
    places_m = np.append(0.0, np.cumsum(side_lengths(cells) * clearance.cell_m))
    length_m = float(places_m[-1])

    count = max(int(length_m / _SAMPLE_M), _SMOOTHING) + 1
    samples_m = np.linspace(0.0, length_m, count)
    # Moving averages, the ends repeated.
    window = np.full(_SMOOTHING, 1.0 / _SMOOTHING)
    smoothed = []
    for line in cells.T:
        values = np.interp(samples_m, places_m, line)
        padded = np.pad(values, _SMOOTHING // 2, mode="edge")
        smoothed.append(np.convolve(padded, window, "valid"))
    points = np.stack(smoothed, axis=1)
    heading = np.unwrap(np.arctan2(*np.diff(points, axis=0).T))

    last_cell = np.array(clearance.clearance_m.shape) - 1
    row, column = np.clip(np.round(points).astype(np.int64), 0, last_cell).T
    # The start and the goal of a short route would leave nothing between them.
    middle = slice(_START_SAMPLES, -_GOAL_SAMPLES) if count > 15 else slice(None)
    return Route(
        cost * clearance.cell_m,
        length_m,
        points,
        heading,
        clearance.clearance_m[row, column][middle],
        clearance.width_m[row, column][middle],
    )


@strict_kernel
def _search(
    cost: Floats, start_row: int, start_column: int, goal_row: int, goal_column: int
) -> tuple[float, Cells]:
    """Return cost (in cells) and cells (n, 2) of the cheapest route, start first.

    Args:
        cost: Per cell length (rows, cols), at least 1, so that the straight line is a
            lower bound.
        start_row: First cell.
        start_column: First cell.
        goal_row: Last cell.
        goal_column: Last cell.
    """
    rows, cols = cost.shape
    total = np.full(rows * cols, math.inf)
    parent = np.full(rows * cols, -1, np.int64)
    done = np.zeros(rows * cols, np.bool_)
    start = start_row * cols + start_column
    goal = goal_row * cols + goal_column
    total[start] = 0.0
    heap = [(0.0, start)]
    while len(heap) > 0:
        _, cell = heapq.heappop(heap)
        if done[cell]:
            continue
        done[cell] = True
        if cell == goal:
            break

        row = cell // cols
        column = cell % cols
        for k in range(len(_STEP_LENGTHS)):
            r = row + _ROW_STEPS[k]
            c = column + _COLUMN_STEPS[k]
            if r < 0 or c < 0 or r >= rows or c >= cols:
                continue
            mean_cost = 0.5 * (cost[row, column] + cost[r, c])
            new_total = total[cell] + _STEP_LENGTHS[k] * mean_cost
            target = r * cols + c
            if new_total < total[target]:
                total[target] = new_total
                parent[target] = cell
                remaining = math.hypot(r - goal_row, c - goal_column)
                heapq.heappush(heap, (new_total + remaining, target))

    return total[goal], trace(parent, goal, 1, cols)


def route_strip(clearance: ClearanceMap, route: Route) -> Floats:
    """Return a route's strip (SAMPLES, CHANNELS) for the model, cut or zero-padded.

    Args:
        clearance: The map.
        route: Route along which the strip lies; only its points are used.

    Returns:
        Samples (SAMPLES, CHANNELS), zero after the end of the route. Channels are: the
        clearance on a line across the route from left to right, from -1 (none) to 1
        (`_FREE_M` and more); heading in rad; change of heading per sample, scaled; 1
        where there is a sample.
    """
    points = route.points[:SAMPLES]
    heading = np.unwrap(np.arctan2(*np.gradient(points, axis=0).T))
    right = np.stack([np.cos(heading), -np.sin(heading)])
    offsets = right[:, :, None] * (_ACROSS_M / clearance.cell_m)
    across = map_coordinates(
        clearance.clearance_m,
        points.T[:, :, None] + offsets,
        order=1,
        mode="nearest",
    )

    strip = np.zeros((SAMPLES, CHANNELS))
    samples = strip[: len(points)]
    samples[:, :HEADING] = np.minimum(across, _FREE_M) / (0.5 * _FREE_M) - 1.0
    samples[:, HEADING] = heading
    samples[:, TURN] = _TURN_SCALE * np.gradient(heading)
    samples[:, PRESENT] = 1.0
    return strip


def mirror_strips(strips: Floats) -> Floats:
    """Return mirrored strips (..., CHANNELS): sides swapped, headings negated."""
    mirrored: Floats = strips.copy()
    mirrored[..., :HEADING] = strips[..., HEADING - 1 :: -1]
    mirrored[..., HEADING : TURN + 1] *= -1.0
    return mirrored


def strip_names(route: str) -> tuple[str, ...]:
    """Return the names of a strip's numbers, flattened; `route` is their prefix."""
    channels = [f"clearance_{offset:+.3f}_m" for offset in _ACROSS_M]
    channels += ["heading", "turn", "present"]
    return tuple(
        f"{route}_{sample}_{channel}"
        for sample in range(SAMPLES)
        for channel in channels
    )
