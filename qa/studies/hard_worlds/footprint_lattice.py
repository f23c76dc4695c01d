"""Paths of a turned footprint through a grid, with a margin that is proven.

A robot turns in place and drives straight ahead on a lattice of three points per cell
and 16 headings. The footprint is checked at nine poses along each motion. Between two
of them no point of it moves more than half of their distance from the nearer one, so
the margin holds all along if it holds at the poses with this half step added.
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
# Steps (x, y) of the 16 headings in lattice points, counterclockwise from x.
_QUARTER = np.array([(1, 0), (2, 1), (1, 1), (1, 2)])
_NEXT_QUARTER = _QUARTER @ [(0, 1), (-1, 0)]
STEPS = np.concatenate([_QUARTER, _NEXT_QUARTER, -_QUARTER, -_NEXT_QUARTER])
HEADINGS_RAD = np.arctan2(STEPS[:, 1], STEPS[:, 0])
_POSES_PER_MOTION = 9
# Cost of a turn by 1 rad in cells, so that a path turns no more than it gains by it.
_CELLS_PER_RAD = 1.0


@dataclass(frozen=True)
class Lattice:
    """The motions of a footprint that keep the margin in a grid of cylinders."""

    # Side of a cell in m; each filled cell holds one cylinder of this diameter.
    cell_m: float
    # (16, x, y): whether the robot may drive one step ahead from a point at a heading.
    drives: BoolGrid
    # (16, x, y): whether it may turn there from a heading to the next counterclockwise.
    turns: BoolGrid

    def find_path(
        self, start: tuple[int, int, int], goal: tuple[int, int]
    ) -> Floats | None:
        """Return the cheapest path from a pose to a point, or None if there is none.

        Args:
            start: x, y and heading of the lattice.
            goal: x and y of the lattice.

        Returns:
            Poses (n, 3): x and y in cells from the outer corner of cell (0, 0), yaw in
            rad.
        """
        states = _search(self.drives, self.turns, np.array(start), np.array(goal))
        if not len(states):
            return None

        points: Floats = states[:, :2] / POINTS_PER_CELL
        return np.column_stack([points, HEADINGS_RAD[states[:, 2]]])


def build_lattice(
    grid: BoolGrid, cell_m: float, chassis: Chassis, margin_m: float
) -> Lattice:
    """Return the lattice of a robot in a grid.

    Args:
        grid: (rows, cols), True where a cylinder stands. The robot may not leave it.
        cell_m: Side of a cell in m.
        chassis: The robot's body; its hull is the footprint.
        margin_m: Distance that the footprint keeps from every cylinder.
    """
    footprint = Footprint(np.array(chassis.hull_m), chassis.footprint_radius_m)
    cylinders = np.argwhere(grid)
    point_m = cell_m / POINTS_PER_CELL
    shape = tuple(POINTS_PER_CELL * side + 1 for side in grid.shape)
    drives = np.ones((len(STEPS), *shape), np.bool_)
    turns = drives.copy()

    for heading, yaw in enumerate(HEADINGS_RAD.tolist()):
        next_yaw = HEADINGS_RAD[(heading + 1) % len(STEPS)]
        turn_rad = (next_yaw - yaw) % (2.0 * math.pi)
        step_m = STEPS[heading] * cell_m / POINTS_PER_CELL
        # Steps in m and rad of the motion, and how far it moves any point at most.
        motions = (
            (drives, step_m, 0.0, math.hypot(*step_m)),
            (turns, 0.0 * step_m, turn_rad, turn_rad * chassis.circumscribed_m),
        )
        for allowed, ahead_m, rotation_rad, longest_m in motions:
            half_step_m = 0.5 * longest_m / (_POSES_PER_MOTION - 1)
            clearance_m = margin_m + cell_m / 2.0 + half_step_m
            poses = [
                (*(share * ahead_m), yaw + share * rotation_rad)
                for share in np.linspace(0.0, 1.0, _POSES_PER_MOTION)
            ]
            points = _blocked_points(footprint, poses, point_m, clearance_m)
            _forbid(allowed[heading], cylinders, points)

    return Lattice(cell_m, drives, turns)


def path_cells(poses: Floats) -> Cells:
    """Return the cells (n, 2) that poses (n, 3) pass, none twice in a row."""
    cells = np.floor(poses[:, :2]).astype(np.int64)
    enters_cell = (np.diff(cells, axis=0) != 0).any(axis=1)
    distinct: Cells = cells[np.concatenate([[True], enters_cell])]
    return distinct


def _blocked_points(
    footprint: Footprint,
    poses: list[tuple[float, float, float]],
    point_m: float,
    clearance_m: float,
) -> Integers:
    """Return the points from which a motion comes too close to a cylinder.

    Args:
        footprint: Outline of the robot.
        poses: x, y in m and yaw along the motion, relative to its first point.
        point_m: Distance of two lattice points.
        clearance_m: Least distance of the outline from the cylinder's axis.

    Returns:
        Points (n, 2), counted from the outer corner of the cell with the cylinder.
    """
    outline_m = float(np.hypot(*footprint.corners_m.T).max())
    motion_m = max(math.hypot(x, y) for x, y, _ in poses)
    reach = math.ceil((outline_m + clearance_m + motion_m) / point_m) + 1
    side = np.arange(-reach, reach + 1)
    points = np.stack(np.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 2)

    # From each point to the cylinder, which stands in the middle of its cell.
    offsets = point_m * (0.5 * POINTS_PER_CELL - points)
    too_close = np.zeros(len(points), np.bool_)
    for x, y, yaw in poses:
        dx = offsets[:, 0] - x
        dy = offsets[:, 1] - y
        ahead = math.cos(yaw) * dx + math.sin(yaw) * dy
        left = math.cos(yaw) * dy - math.sin(yaw) * dx
        too_close |= footprint.distances(ahead, left) < clearance_m

    blocked: Integers = points[too_close]
    return blocked


@njit(cache=True)
def _forbid(allowed: BoolGrid, cylinders: Cells, points: Integers) -> None:
    """Forbid a motion at some points (n, 2) relative to each cylinder's cell."""
    for row, column in cylinders:
        for i, j in points:
            x = POINTS_PER_CELL * row + i
            y = POINTS_PER_CELL * column + j
            if 0 <= x < allowed.shape[0] and 0 <= y < allowed.shape[1]:
                allowed[x, y] = False


@njit(cache=True)
def _search(
    drives: BoolGrid, turns: BoolGrid, start: Integers, goal: Integers
) -> Integers:
    """Return the states x, y, heading (n, 3) of the cheapest path by A*, or (0, 3)."""
    headings, x_count, y_count = drives.shape
    cost = np.full(headings * x_count * y_count, np.inf)
    parent = np.full(headings * x_count * y_count, -1, np.int64)
    first = (start[2] * x_count + start[0]) * y_count + start[1]
    cost[first] = 0.0
    heap = [(0.0, first)]

    while len(heap) > 0:
        priority, state = heapq.heappop(heap)
        heading = state // (x_count * y_count)
        x = state // y_count % x_count
        y = state % y_count
        remaining = math.hypot(goal[0] - x, goal[1] - y)
        # A cheaper path to this state was found after the entry was pushed.
        if priority > cost[state] + remaining + 1e-9:
            continue
        if remaining == 0.0:
            return _trace(parent, state, x_count, y_count)

        for move in range(3):
            next_x = x
            next_y = y
            next_heading = heading
            if move == 0:
                next_x = x + STEPS[heading, 0]
                next_y = y + STEPS[heading, 1]
                price = math.hypot(STEPS[heading, 0], STEPS[heading, 1])
                inside = 0 <= next_x < x_count and 0 <= next_y < y_count
                allowed = inside and drives[heading, x, y]
            else:
                next_heading = (heading + (1 if move == 1 else -1)) % headings
                # A turn back takes the same poses as the turn ahead from below.
                low = heading if move == 1 else next_heading
                high_rad = HEADINGS_RAD[(low + 1) % headings]
                angle = (high_rad - HEADINGS_RAD[low]) % (2.0 * math.pi)
                price = _CELLS_PER_RAD * POINTS_PER_CELL * angle
                allowed = turns[low, x, y]

            target = (next_heading * x_count + next_x) * y_count + next_y
            if allowed and cost[state] + price < cost[target] - 1e-9:
                cost[target] = cost[state] + price
                parent[target] = state
                remaining = math.hypot(goal[0] - next_x, goal[1] - next_y)
                heapq.heappush(heap, (cost[target] + remaining, target))

    return np.empty((0, 3), np.int64)


@njit(cache=True)
def _trace(parent: Integers, last: int, x_count: int, y_count: int) -> Integers:
    """Return the states (n, 3) from the first one to `last`."""
    # Numba infers the type of the list from its first entry, which is dropped below.
    states = [(0, 0, 0)]
    state = last
    while state >= 0:
        x = state // y_count % x_count
        states.append((x, state % y_count, state // (x_count * y_count)))
        state = parent[state]
    return np.array(states[:0:-1])
