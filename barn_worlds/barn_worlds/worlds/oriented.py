"""Ways of a turned footprint through a grid: a search over position and heading that proves a margin.

A robot turns in place and drives straight ahead, on a lattice of three points to a cell and 16 headings. A motion is
allowed if the footprint, at poses along it that lie close together, keeps the margin and half of what any of its points
moves between two of them: the margin then holds all along.
"""

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from barn_worlds.base.arrays import BoolGrid, Cells, Floats, Integers
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.robots.robot import Chassis

POINTS_PER_CELL = 3
# steps (x, y) of the 16 headings, counter-clockwise from x
STEPS = np.array(
    [(1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1)]
    + [(-1, 0), (-2, -1), (-1, -1), (-1, -2), (0, -1), (1, -2), (1, -1), (2, -1)]
)
HEADINGS_RAD = np.arctan2(STEPS[:, 1], STEPS[:, 0])
_SAMPLES = 9  # poses of a motion that are looked at
_RAD_AS_CELLS = 1.0  # of way, so that a way turns no more than it gains by it


@dataclass(frozen=True)
class Lattice:
    """The allowed motions of a footprint in a grid of cylinders, one to a filled cell.

    cell_m: side of a cell. drives, turns (16, x, y): whether the robot may drive a step ahead at a heading, or turn
    from it to the next one counter-clockwise, at the point (x, y) from the outer corner of cell (0, 0).
    """

    cell_m: float
    drives: BoolGrid
    turns: BoolGrid

    def way(self, start: tuple[int, int, int], goal: tuple[int, int]) -> Floats | None:
        """Return the cheapest way (n, 3) from a pose (x, y, heading) to a point, both of the lattice; None without one.

        Its rows are x and y in cells from the outer corner of cell (0, 0), and the yaw in rad.
        """
        found = _search(self.drives, self.turns, np.array(start), np.array(goal))
        if not len(found):
            return None
        points: Floats = found[:, :2] / POINTS_PER_CELL
        return np.column_stack([points, HEADINGS_RAD[found[:, 2]]])


def lattice(
    grid: BoolGrid, cell_m: float, chassis: Chassis, margin_m: float
) -> Lattice:
    """Return the lattice of a robot in a grid (rows, cols); beyond the grid nothing stands, and it may not go there."""
    footprint = Footprint(np.array(chassis.hull_m), chassis.footprint_radius_m)
    cylinders = np.argwhere(grid)
    shape = tuple(POINTS_PER_CELL * side + 1 for side in grid.shape)
    both = np.ones((2, len(STEPS), *shape), np.bool_)
    for k, yaw in enumerate(HEADINGS_RAD.tolist()):
        turn = (HEADINGS_RAD[(k + 1) % len(STEPS)] - yaw) % (2.0 * math.pi)
        step = STEPS[k] * cell_m / POINTS_PER_CELL
        motions = (
            (step, 0.0, math.hypot(*step)),
            (0.0 * step, turn, turn * chassis.circumscribed_m),
        )
        for motion, (ahead, by, moved_m) in enumerate(motions):
            apart_m = margin_m + cell_m / 2.0 + 0.5 * moved_m / (_SAMPLES - 1)
            poses = [
                (*(share * ahead), yaw + share * by)
                for share in np.linspace(0.0, 1.0, _SAMPLES)
            ]
            _forbid(
                both[motion, k],
                cylinders,
                _stencil(footprint, poses, cell_m / POINTS_PER_CELL, apart_m),
            )
    return Lattice(cell_m, both[0], both[1])


def cells_of(way: Floats) -> Cells:
    """Return the cells (n, 2) that a way (n, 3) goes through, none twice in a row."""
    cells = np.floor(way[:, :2]).astype(np.int64)
    kept: Cells = cells[
        np.concatenate([[True], (np.diff(cells, axis=0) != 0).any(axis=1)])
    ]
    return kept


def _stencil(
    footprint: Footprint,
    poses: list[tuple[float, float, float]],
    point_m: float,
    apart_m: float,
) -> Integers:
    """Return the points (n, 2) from which poses (x, y in m, yaw) bring the footprint too near to a cylinder at (0, 0).

    The cylinder stands half way between points, on whole ones from its cell's corner; points are counted from there.
    """
    reach_m = (
        float(np.hypot(*footprint.corners_m.T).max())
        + apart_m
        + max(math.hypot(x, y) for x, y, _ in poses)
    )
    far = math.ceil(reach_m / point_m) + 1
    points = np.stack(
        np.meshgrid(np.arange(-far, far + 1), np.arange(-far, far + 1), indexing="ij"),
        -1,
    ).reshape(-1, 2)
    away = point_m * (0.5 * POINTS_PER_CELL - points)  # from the point to the cylinder
    near = np.zeros(len(points), np.bool_)
    for x, y, yaw in poses:
        dx, dy = away[:, 0] - x, away[:, 1] - y
        ahead, left = (
            math.cos(yaw) * dx + math.sin(yaw) * dy,
            math.cos(yaw) * dy - math.sin(yaw) * dx,
        )
        near |= footprint.distances(ahead, left) < apart_m
    found: Integers = points[near]
    return found


@njit(cache=True)
def _forbid(allowed: BoolGrid, cylinders: Cells, stencil: Integers) -> None:
    """Forbid a motion at the points (x, y) of a stencil about each cylinder."""
    for row, column in cylinders:
        for i, j in stencil:
            x, y = POINTS_PER_CELL * row + i, POINTS_PER_CELL * column + j
            if 0 <= x < allowed.shape[0] and 0 <= y < allowed.shape[1]:
                allowed[x, y] = False


@njit(cache=True)
def _search(
    drives: BoolGrid, turns: BoolGrid, start: Integers, goal: Integers
) -> Integers:
    """Return the states x, y, heading (n, 3) of the cheapest way, found by A*; (0, 3) if there is none."""
    headings, wide, long = drives.shape
    cost = np.full(headings * wide * long, np.inf)
    parent = np.full(headings * wide * long, -1, np.int64)
    first = (start[2] * wide + start[0]) * long + start[1]
    cost[first] = 0.0
    heap = [(0.0, first)]
    while len(heap) > 0:
        priority, state = heapq.heappop(heap)
        k, x, y = state // (wide * long), state // long % wide, state % long
        left = math.hypot(goal[0] - x, goal[1] - y)
        if priority > cost[state] + left + 1e-9:
            continue
        if left == 0.0:
            return _states(parent, state, wide, long)
        for move in range(3):
            u, v, turned, price = x, y, k, 0.0
            if move == 0:
                u, v = x + STEPS[k, 0], y + STEPS[k, 1]
                price = math.hypot(STEPS[k, 0], STEPS[k, 1])
                allowed = 0 <= u < wide and 0 <= v < long and drives[k, x, y]
            else:
                turned = (k + (1 if move == 1 else -1)) % headings
                low = k if move == 1 else turned
                angle = (HEADINGS_RAD[(low + 1) % headings] - HEADINGS_RAD[low]) % (
                    2.0 * math.pi
                )
                price = _RAD_AS_CELLS * POINTS_PER_CELL * angle
                allowed = turns[low, x, y]
            reached = (turned * wide + u) * long + v
            if allowed and cost[state] + price < cost[reached] - 1e-9:
                cost[reached], parent[reached] = cost[state] + price, state
                heapq.heappush(
                    heap,
                    (cost[reached] + math.hypot(goal[0] - u, goal[1] - v), reached),
                )
    return np.empty((0, 3), np.int64)


@njit(cache=True)
def _states(parent: Integers, last: int, wide: int, long: int) -> Integers:
    """Return the states (n, 3) from the first to the last one."""
    found, state = [(0, 0, 0)], last
    while state >= 0:
        found.append((state // long % wide, state % long, state // (wide * long)))
        state = parent[state]
    return np.array(found[:0:-1])
