"""Compiled loops of the dynamic window approach: its samples and their rollouts."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_planners.costmap.kernels import (
    footprint_spans,
    line_between,
    next_cell,
    placed,
)
from barn_planners.dwa.wavefront import (
    UNREACHED,
    Wavefront,
    begin,
    blocked,
    plan_cells,
    steps_to,
)

TOUCHES, NO_WAY = -1.0, -2.0  # costs of samples that are not allowed
_ALL = 2**62

# Columns of the table of samples.
SPEED, TURN, COST, END_X, END_Y, END_YAW, PATH, GOAL, OBSTACLE = range(9)


class Grid(NamedTuple):
    """Place of a costmap: outer corner of the first cell in metres, and the cells per metre."""

    x: float
    y: float
    per_m: float


class Ground(NamedTuple):
    """A costmap, its clear cells (see `open_around`) and the corners (n, 2) of the padded footprint."""

    costs: npt.NDArray[np.uint8]
    clear: npt.NDArray[np.int16]
    grid: Grid
    outline: npt.NDArray[np.float64]


class Scene(NamedTuple):
    """What rollouts are scored on."""

    ground: Ground
    path: Wavefront  # steps to the plan
    goal: Wavefront  # and to its end


class Start(NamedTuple):
    """Pose (m, rad) and velocity (m/s, rad/s) that rollouts begin with."""

    x: float
    y: float
    yaw: float
    speed: float
    turn: float


class Movement(NamedTuple):
    """How a rollout moves: its time, the distance and the turn between its poses, and the accelerations."""

    time_s: float
    step_m: float
    turn_step_rad: float
    acceleration: float
    turn_acceleration: float


class Weights(NamedTuple):
    """Weights of the steps to the plan, of those to its end, and of the highest cost under the edges."""

    path: float
    goal: float
    obstacle: float


@njit(cache=True)
def _evenly(low, high, count, added_up):  # type: ignore[no-untyped-def]
    """Return `count` values from low to high, to the last bit those of numpy.linspace, or steps added up."""
    step, value, values = (high - low) / (count - 1), low, np.empty(count)
    for k in range(count):
        values[k] = value if added_up else k * step + low
        value += step
    if not added_up:
        values[-1] = high
    return values


@njit(cache=True)
def sample_table(speeds, turns, counts, highest, slowest, skip_slow, added_up):  # type: ignore[no-untyped-def]
    """Return the table of samples, all else 0, and how many of them drive forward; the others turn in place.

    speeds, turns: lowest and highest; counts: of both, no speeds if none may drive forward. Each speed has a sample
    straight ahead and one per turn. slowest: of turns in place; skip_slow: none of these within a step of zero.
    """
    (low, high), (speed_count, turn_count) = turns, counts
    rates, kept = (
        _evenly(low, high, turn_count, added_up),
        turn_count + 1 if highest else turn_count,
    )
    drives = speed_count * kept
    table, end = np.zeros((drives + turn_count, OBSTACLE + 1)), drives
    if drives > 0:
        forward = _evenly(speeds[0], speeds[1], speed_count, added_up)
        for k in range(drives):
            table[k, SPEED], table[k, TURN] = (
                forward[k // kept],
                rates[k % kept - 1] if k % kept > 0 else 0.0,
            )
    for rate in rates:
        if not skip_slow or abs(rate) > (high - low) / (turn_count - 1):
            table[end, TURN] = max(rate, slowest) if rate > 0.0 else min(rate, -slowest)
            end += 1
    return table[:end], drives


@njit(cache=True)
def prepare(costs, fields, plan, frame, pose, outline, reach, robot_blocks_goal):  # type: ignore[no-untyped-def]
    """Bring the fields of `_Fields` up to date; tell whether the plan is on the grid. reach: metres of rollouts."""
    (copy, clear, walls, seeds, path, goal), (rows, cols) = fields, costs.shape
    (origin_x, origin_y, resolution), (x, y, yaw) = frame, pose
    count = plan_cells(plan, origin_x, origin_y, resolution, rows, cols, seeds)
    if count == 0:
        return False
    for row in range(rows):
        for col in range(cols):
            copy[row, col] = costs[row, col]
    low_row, high_row = (
        math.floor((y - reach - origin_y) / resolution),
        math.floor((y + reach - origin_y) / resolution),
    )
    low_col, high_col = (
        math.floor((x - reach - origin_x) / resolution),
        math.floor((x + reach - origin_x) / resolution),
    )
    open_around(costs, (low_row - 1, high_row + 2, low_col - 1, high_col + 2), clear)
    first, spans = footprint_spans(
        placed(outline, x, y, yaw), origin_x, origin_y, resolution
    )
    blocked(costs, first, spans, walls)
    begin(path, walls, seeds[:count])
    if robot_blocks_goal:
        blocked(costs, first, spans[:0], walls)
    begin(goal, walls, seeds[count - 1 : count])
    return True


@njit(cache=True)
def open_around(costs, window, clear):  # type: ignore[no-untyped-def]
    """Write the cells to the next cost or edge of a window (row, end row, column, end column); 0 outside of it."""
    (rows, cols), (row_lo, row_hi, col_lo, col_hi) = costs.shape, window
    row_lo, row_hi, col_lo, col_hi = (
        max(0, row_lo),
        min(rows, row_hi),
        max(0, col_lo),
        min(cols, col_hi),
    )
    clear[:] = 0
    for row in range(row_lo + 1, row_hi - 1):
        for col in range(col_lo + 1, col_hi - 1):
            r, c = np.uint64(row), np.uint64(col)
            if costs[r, c] == 0:
                above = r - np.uint64(1)
                low = min(
                    clear[above, c - np.uint64(1)],
                    clear[above, c],
                    clear[above, c + np.uint64(1)],
                )
                clear[r, c] = min(low, clear[r, c - np.uint64(1)]) + 1
    for row in range(row_hi - 2, row_lo, -1):
        for col in range(col_hi - 2, col_lo, -1):
            r, c = np.uint64(row), np.uint64(col)
            if clear[r, c] > 1:
                below = r + np.uint64(1)
                low = min(
                    clear[below, c - np.uint64(1)],
                    clear[below, c],
                    clear[below, c + np.uint64(1)],
                )
                clear[r, c] = min(clear[r, c], min(low, clear[r, c + np.uint64(1)]) + 1)


@njit(cache=True)
def along_edge(costs, clear, row, col, end_row, end_col, highest):  # type: ignore[no-untyped-def]
    """Return the larger of `highest` and the highest cost between two cells, -1 if it is lethal."""
    line, rest = line_between(row, col, end_row, end_col)
    steps = line.steps
    if (
        clear[np.uint64((row + end_row) // 2), np.uint64((col + end_col) // 2)]
        <= steps // 2 + 1
    ):
        for _ in range(steps + 1):
            highest = max(highest, costs[np.uint64(row), np.uint64(col)])
            row, col, rest = next_cell(row, col, rest, line)
        if highest >= 254:
            return -1
    return highest


@njit(cache=True)
def row_col(grid, x, y):  # type: ignore[no-untyped-def]
    """Return row and column of the cell of a point."""
    return math.floor((y - grid.y) * grid.per_m), math.floor((x - grid.x) * grid.per_m)


@njit(cache=True)
def edges_cost(costs, clear, grid, outline, x, y, cos_yaw, sin_yaw, corners, highest):  # type: ignore[no-untyped-def]
    """Return the larger of `highest` and what `edge_cost` gives for the footprint at a pose, -1 if that is -1.

    The first arguments are those of `Ground`, one by one: taking an array out of a tuple would count references.
    corners: int64 (n,), cells of the corners at the pose before, -1 before the first, whose edges are part of
    `highest`; takes those of this pose. Edges that have not moved are skipped.
    """
    rows, cols = costs.shape
    last = len(outline) - 1
    along, across = outline[last, 0], outline[last, 1]
    row, col = row_col(
        grid,
        x + cos_yaw * along - sin_yaw * across,
        y + sin_yaw * along + cos_yaw * across,
    )
    if row < 0 or row >= rows or col < 0 or col >= cols:
        return -1
    last_row, last_col = row, col
    last_moved = moved = row * cols + col != corners[last]
    for k in range(last):
        along, across = outline[k, 0], outline[k, 1]
        end_row, end_col = row_col(
            grid,
            x + cos_yaw * along - sin_yaw * across,
            y + sin_yaw * along + cos_yaw * across,
        )
        if end_row < 0 or end_row >= rows or end_col < 0 or end_col >= cols:
            return -1
        here = end_row * cols + end_col != corners[k]
        if moved or here:
            highest = along_edge(costs, clear, row, col, end_row, end_col, highest)
            if highest < 0:
                return -1
            corners[k] = end_row * cols + end_col
        row, col, moved = end_row, end_col, here
    if moved or last_moved:
        highest = along_edge(costs, clear, row, col, last_row, last_col, highest)
        corners[last] = last_row * cols + last_col
    return highest


@njit(cache=True)
def approach(wanted, now, change):  # type: ignore[no-untyped-def]
    """Return a velocity moved towards the wanted one by at most `change`."""
    return min(wanted, now + change) if wanted >= now else max(wanted, now - change)


@njit(cache=True)
def step_count(speed, turn, motion):  # type: ignore[no-untyped-def]
    """Return the number of poses of a rollout; the turn counts per second, not over the whole time."""
    return max(
        1,
        int(
            max(
                abs(speed) * motion.time_s / motion.step_m,
                abs(turn) / motion.turn_step_rad,
            )
            + 0.5
        ),
    )


@njit(cache=True)
def steps_at(front, row, col):  # type: ignore[no-untyped-def]
    """Return the steps of a wavefront to a cell of the grid."""
    return steps_to(front, (row + 1) * front.columns + col + 1)


@njit(cache=True)
def turn_along(start, turn, steps, motion, headings):  # type: ignore[no-untyped-def]
    """Fill `headings` (steps or more, 3) with yaw, its cosine and its sine at each pose of a rollout."""
    yaw, rate, dt = start.yaw, start.turn, motion.time_s / steps
    for k in range(steps):
        headings[k, 0], headings[k, 1], headings[k, 2] = (
            yaw,
            math.cos(yaw),
            math.sin(yaw),
        )
        rate = approach(turn, rate, motion.turn_acceleration * dt)
        yaw += rate * dt


@njit(cache=True)
def drive_along(start, speed, steps, motion, headings, places):  # type: ignore[no-untyped-def]
    """Fill `places` (steps or more, 2) with x and y at each pose of a rollout."""
    x, y, now, dt = start.x, start.y, start.speed, motion.time_s / steps
    for k in range(steps):
        places[k, 0], places[k, 1] = x, y
        now = approach(speed, now, motion.acceleration * dt)
        x += now * headings[k, 1] * dt
        y += now * headings[k, 2] * dt


@njit(cache=True)
def poses_of(start, speed, turn, motion, most):  # type: ignore[no-untyped-def]
    """Return places (n, 2) and headings (n, 3) of a rollout of at most so many poses."""
    steps = min(step_count(speed, turn, motion), most)
    places, headings = np.empty((steps, 2)), np.empty((steps, 3))
    turn_along(start, turn, steps, motion, headings)
    drive_along(start, speed, steps, motion, headings, places)
    return places, headings


@njit(cache=True)
def traces(start, velocities, motion, most):  # type: ignore[no-untyped-def]
    """Return poses (n, most, 3) of rollouts at velocities (n, 2), the last one of each repeated to the end."""
    shown = np.empty((len(velocities), most, 3))
    for i in range(len(velocities)):
        places, headings = poses_of(
            start, velocities[i, SPEED], velocities[i, TURN], motion, most
        )
        for k in range(most):
            last = min(k, len(places) - 1)
            shown[i, k, 0], shown[i, k, 1], shown[i, k, 2] = (
                places[last, 0],
                places[last, 1],
                headings[last, 0],
            )
    return shown


@njit(cache=True)
def score(scene, start, motion, weights, table):  # type: ignore[no-untyped-def]
    """Score samples by their speeds and turns; the cost is TOUCHES or NO_WAY where a pose is not allowed."""
    (costs, clear, grid, outline), path, goal = scene
    for row in table:
        places, headings = poses_of(start, row[SPEED], row[TURN], motion, _ALL)
        obstacle, corners, row[COST] = 0, np.full(len(outline), -1), TOUCHES
        for k in range(len(places)):
            (x, y), (yaw, cos_yaw, sin_yaw) = places[k], headings[k]
            obstacle = edges_cost(
                costs, clear, grid, outline, x, y, cos_yaw, sin_yaw, corners, obstacle
            )
            if obstacle < 0:
                break
            cell = row_col(grid, x, y)
            to_path, to_goal = steps_at(path, *cell), steps_at(goal, *cell)
            if to_path >= UNREACHED or to_goal >= UNREACHED:
                obstacle, row[COST] = -1, NO_WAY
                break
            row[END_X], row[END_Y], row[END_YAW], row[PATH], row[GOAL] = (
                x,
                y,
                yaw,
                to_path,
                to_goal,
            )
        if obstacle >= 0:
            row[OBSTACLE] = obstacle
            row[COST] = (
                weights.path * row[PATH]
                + weights.goal * row[GOAL]
                + weights.obstacle * obstacle
            )
