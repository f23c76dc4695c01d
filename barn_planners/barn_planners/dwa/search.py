"""The search for the best velocity sample, without scoring every sample.

It takes the sample that base_local_planner's `createTrajectories` takes. The end of a
rollout comes first: what its distances cost alone rules out most samples before
anybody looks at their footprints.
"""

import math
from typing import NamedTuple

import numpy as np

from barn_planners.costmap.kernels import Cell, is_on_grid
from barn_planners.dwa.kernels import (
    COS,
    COST,
    END_X,
    END_Y,
    END_YAW,
    GOAL,
    OBSTACLE,
    PATH,
    SIN,
    SPEED,
    TOUCHES,
    TURN,
    YAW,
    Rules,
    Scene,
    X,
    Y,
    approach,
    edges_cost,
    raster_cell,
    roll_out,
    step_count,
)
from barn_planners.dwa.wavefront import (
    REACHED,
    UNREACHED,
    Wavefront,
    is_bordered,
    padded,
    steps_to,
)
from barn_planners.kernel import kernel
from barn_worlds.base.arrays import Floats, Integers

_STRIDE = 6  # poses between two of those that are checked first
_ROUNDING = 1e-6
_ROUNDING_M = 1e-6  # far more than the sums of a rollout are off
_STRAIGHT_RAD = 1e-9


class Choice(NamedTuple):
    """Which samples of a table may win."""

    drives: int  # so many rows drive forward, the others turn in place
    # Whether the robot may turn in place to this side.
    left: bool
    right: bool
    # A turn in place counts by how near the goal is this far ahead of its end, ...
    lookahead_m: float
    # ... if True, also where no way leads from there.
    past_blocked: bool
    # Row to look at first: that of the last cycle rules out most others.
    likely: int


class _Work(NamedTuple):
    """What all samples share."""

    poses: Floats  # memory for rollouts, (longest, 5)
    corners: Integers  # memory for `edges_cost`
    # Corners and highest cost at the start, which all rollouts have in common.
    start_corners: Integers
    start_cost: int
    # Cells from base_link to the furthest corner. Where it is so far to the next cost,
    # the edges cost nothing.
    outline_reach: int


@kernel
def find_best(scene: Scene, rules: Rules, table: Floats, choice: Choice) -> int:
    """Find the best sample of a table and fill in its row as `score` does.

    The first of the cheapest rows that drive forward wins. A turn in place wins over it
    if it costs no more and the goal is nearer ahead of its end than for any turn before.

    Args:
        scene: What rollouts are scored on.
        rules: How rollouts move and what they cost.
        table: Table of samples with speeds and yaw rates.
        choice: Which samples may win.

    Returns:
        Row of the best sample, -1 if none is allowed.
    """
    table[:, COST] = TOUCHES
    ground = scene.ground
    start = rules.start
    cos_yaw = math.cos(start.yaw)
    sin_yaw = math.sin(start.yaw)
    corners = np.full(len(ground.outline), -1)
    costs, clear, raster, outline = ground
    start_cost = edges_cost(
        costs, clear, raster, outline, start.x, start.y, cos_yaw, sin_yaw, corners, 0
    )
    if start_cost < 0 or not _is_reached(scene, start.x, start.y):
        return -1

    longest = 1
    for row in table:
        longest = max(longest, step_count(row[SPEED], row[TURN], rules.motion))
    reach_m = 0.0
    for x, y in ground.outline:
        reach_m = max(reach_m, math.hypot(x, y))
    outline_reach = math.ceil(reach_m * ground.raster.per_m)
    work = _Work(
        np.empty((longest, 5)),
        corners.copy(),
        corners,
        start_cost,
        outline_reach,
    )

    best, cost = _best_drive(scene, rules, table, choice, work)
    best, cost = _best_turn(scene, rules, table, choice, work, best, cost)
    if best >= 0:
        table[best, COST] = cost
    return best


@kernel
def _is_reached(scene: Scene, x: float, y: float) -> bool:
    """Return whether ways lead from a point on the costmap to the plan and its end."""
    cell = padded(raster_cell(scene.ground.raster, x, y), scene.path.columns)
    return (
        steps_to(scene.path, cell) < UNREACHED
        and steps_to(scene.goal, cell) < UNREACHED
    )


@kernel
def _best_drive(
    scene: Scene, rules: Rules, table: Floats, choice: Choice, work: _Work
) -> tuple[int, float]:
    """Return the best row that drives forward, -1 if none may, and its cost."""
    best = -1
    best_cost = math.inf
    for n in range(-1, choice.drives):
        k = n if n >= 0 else choice.likely
        if k >= choice.drives or n == choice.likely:
            continue

        row = table[k]
        if best >= 0 and _least_cost(scene, rules, row, work.start_cost) > best_cost:
            continue

        # The likely row is out of order: of equal costs the first row wins.
        cost = _cost(scene, rules, row, best_cost, work)
        if cost >= 0.0 and (cost < best_cost or k < best):
            best = k
            best_cost = cost

    return best, best_cost


@kernel
def _best_turn(
    scene: Scene,
    rules: Rules,
    table: Floats,
    choice: Choice,
    work: _Work,
    best: int,
    cost: float,
) -> tuple[int, float]:
    """Return the best row and its cost, where `best` is the one to win over."""
    nearest = math.inf
    for k in range(choice.drives, len(table)):
        row = table[k]
        if not (choice.left if row[TURN] > 0.0 else choice.right):
            continue
        if _least_cost(scene, rules, row, work.start_cost) > cost:
            continue

        turn_cost = _cost(scene, rules, row, cost, work)
        if turn_cost < 0.0:
            continue

        distance = _goal_ahead(scene, row, choice)
        if distance < nearest:
            best = k
            cost = turn_cost
            nearest = distance

    return best, cost


@kernel
def _goal_ahead(scene: Scene, row: Floats, choice: Choice) -> float:
    """Return the steps to the goal from ahead of a sample's end, inf if it may not win.

    The original's distance of a cell without a way is one of two large numbers: a
    smaller one if its wavefront stops there, a larger one if it never comes near.
    """
    x = row[END_X] + choice.lookahead_m * math.cos(row[END_YAW])
    y = row[END_Y] + choice.lookahead_m * math.sin(row[END_YAW])
    rows, cols = scene.ground.costs.shape
    cell = raster_cell(scene.ground.raster, x, y)
    if not is_on_grid(cell, rows, cols):
        return math.inf

    place = padded(cell, scene.goal.columns)
    steps = steps_to(scene.goal, place)
    if steps < UNREACHED:
        return float(steps)
    if not choice.past_blocked:
        return math.inf
    return float(UNREACHED) + (0.0 if is_bordered(scene.goal, place) else 1.0)


@kernel
def _cost(scene: Scene, rules: Rules, row: Floats, limit: float, work: _Work) -> float:
    """Fill in a row as `score` does, but for the cost, and return that.

    It is -1 if the sample is not allowed or costs more than the limit.
    """
    weights = rules.weights
    rows, cols = scene.ground.costs.shape
    steps = step_count(row[SPEED], row[TURN], rules.motion)
    poses = work.poses[:steps]
    roll_out(rules.start, row[SPEED], row[TURN], rules.motion, poses)
    end = poses[steps - 1]
    cell = raster_cell(scene.ground.raster, end[X], end[Y])
    if not is_on_grid(cell, rows, cols):
        return -1.0

    place = padded(cell, scene.path.columns)
    to_path = steps_to(scene.path, place)
    to_goal = steps_to(scene.goal, place)
    if to_path >= UNREACHED or to_goal >= UNREACHED:
        return -1.0

    end_cost = weights.path * to_path + weights.goal * to_goal
    if end_cost + weights.obstacle * work.start_cost > limit:
        return -1.0

    highest = _highest_cost(scene, poses, weights.obstacle, limit - end_cost, work)
    cost = end_cost + weights.obstacle * highest
    if highest < 0 or cost > limit:
        return -1.0

    row[END_X] = end[X]
    row[END_Y] = end[Y]
    row[END_YAW] = end[YAW]
    row[PATH] = to_path
    row[GOAL] = to_goal
    row[OBSTACLE] = highest
    return cost


@kernel
def _least_cost(scene: Scene, rules: Rules, row: Floats, start_cost: int) -> float:
    """Return what a sample costs at least: its distances where the rollout ends.

    The end is in closed form, which spares the rollout of most samples. Once speed and
    yaw rate are the sample's, the steps of a rollout add up to a geometric series.
    """
    x, y, yaw, speed, turn = rules.start
    motion = rules.motion
    steps = step_count(row[SPEED], row[TURN], motion)
    dt = motion.time_s / steps
    left = steps - 1
    while left > 0 and (speed != row[SPEED] or turn != row[TURN]):
        speed = approach(speed, row[SPEED], motion.acceleration * dt)
        x += speed * math.cos(yaw) * dt
        y += speed * math.sin(yaw) * dt
        turn = approach(turn, row[TURN], motion.turn_acceleration * dt)
        yaw += turn * dt
        left -= 1

    # The chord of the arc that is left, and its direction.
    half = 0.5 * turn * dt
    length = float(left)
    if abs(half) > _STRAIGHT_RAD:
        length = math.sin(left * half) / math.sin(half)
    middle = yaw + (left - 1) * half
    x += speed * dt * length * math.cos(middle)
    y += speed * dt * length * math.sin(middle)

    # The end of the rollout itself may lie in the next cell because of rounding.
    raster = scene.ground.raster
    low = raster_cell(raster, x - _ROUNDING_M, y - _ROUNDING_M)
    high = raster_cell(raster, x + _ROUNDING_M, y + _ROUNDING_M)
    weights = rules.weights
    to_path = _least_steps(scene.path, low, high)
    to_goal = _least_steps(scene.goal, low, high)
    return (
        weights.path * to_path + weights.goal * to_goal + weights.obstacle * start_cost
    )


@kernel
def _least_steps(front: Wavefront, low: Cell, high: Cell) -> int:
    """Return the least steps to the cells of a block, UNREACHED off the costmap."""
    columns = front.columns
    rows = len(front.state) // columns - 2
    steps = UNREACHED
    for row in range(low.row, high.row + 1):
        for col in range(low.col, high.col + 1):
            cell = Cell(row, col)
            if is_on_grid(cell, rows, columns - 2):
                steps = min(steps, steps_to(front, padded(cell, columns)))
    return steps


@kernel
def _highest_cost(
    scene: Scene, poses: Floats, weight: float, limit: float, work: _Work
) -> int:
    """Return the highest cost under the edges along a rollout, -1 if not allowed.

    It may be a lower one that costs more than the limit already.
    """
    ground = scene.ground
    rows, cols = ground.costs.shape
    highest = work.start_cost
    path = scene.path
    goal = scene.goal
    costs, clear, raster, outline = ground
    path_state = path.state
    goal_state = goal.state
    corners = work.corners

    # A few poses along the whole rollout first: most bad ones are found out by them.
    for stride in (_STRIDE, 1):
        work.corners[:] = work.start_corners
        for k in range(stride, len(poses), stride):
            if stride == 1 and k % _STRIDE == 0:
                continue

            x = poses[k, X]
            y = poses[k, Y]
            cell = raster_cell(raster, x, y)
            if (
                not is_on_grid(cell, rows, cols)
                or clear[cell.row, cell.col] <= work.outline_reach
            ):
                highest = edges_cost(
                    costs,
                    clear,
                    raster,
                    outline,
                    x,
                    y,
                    poses[k, COS],
                    poses[k, SIN],
                    corners,
                    highest,
                )
                if highest < 0 or weight * highest > limit + _ROUNDING:
                    return highest

            place = np.uint64(padded(cell, cols + 2))
            if path_state[place] != REACHED and steps_to(path, place) >= UNREACHED:
                return -1
            if goal_state[place] != REACHED and steps_to(goal, place) >= UNREACHED:
                return -1

    return highest
