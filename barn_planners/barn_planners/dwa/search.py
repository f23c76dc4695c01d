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
    COST,
    END_X,
    END_Y,
    END_YAW,
    GOAL,
    NO_WAY,
    OBSTACLE,
    PATH,
    SPEED,
    TOUCHES,
    TURN,
    UNREACHED,
    YAW,
    Ground,
    Raster,
    Rules,
    Wavefront,
    X,
    Y,
    approach,
    edges_cost,
    is_bordered,
    padded,
    raster_cell,
    roll_out,
    step_count,
    steps_to,
)
from barn_worlds.base.arrays import Floats, kernel

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
    start_cost: int  # highest cost under the edges at the start


@kernel
def find_best(
    ground: Ground,
    path: Wavefront,
    goal: Wavefront,
    rules: Rules,
    table: Floats,
    choice: Choice,
) -> int:
    """Return the best sample's row, -1 if none is allowed; fill it in as `score` does.

    Other rows that were scored have their cost too; those ruled out before have NaN.

    The first of the cheapest rows that drive forward wins. A turn in place wins over it
    if it costs no more and the goal is nearer ahead of its end than for all turns
    before.

    Args:
        ground: What footprints are checked on.
        path: Steps to the plan.
        goal: Steps to the plan's end.
        rules: How rollouts move and what they cost.
        table: Table of samples with speeds and yaw rates.
        choice: Which samples may win.

    Returns:
        Row of the best sample, -1 if none is allowed.
    """
    table[:, COST] = TOUCHES
    start = rules.start
    costs, raster, outline = ground
    cos_yaw = math.cos(start.yaw)
    sin_yaw = math.sin(start.yaw)
    # All rollouts begin here, so nothing is allowed if this pose is not.
    start_cost = edges_cost(costs, raster, outline, start.x, start.y, cos_yaw, sin_yaw)
    if start_cost < 0 or not _is_reached(raster, path, goal, start.x, start.y):
        return -1

    table[:, COST] = math.nan
    longest = 1
    for row in table:
        longest = max(longest, step_count(row[SPEED], row[TURN], rules.motion))
    work = _Work(np.empty((longest, 5)), start_cost)
    best, cost = _best_drive(ground, path, goal, rules, table, choice, work)
    return _best_turn(ground, path, goal, rules, table, choice, work, best, cost)


@kernel
def _is_reached(
    raster: Raster, path: Wavefront, goal: Wavefront, x: float, y: float
) -> bool:
    """Return whether ways lead from a point (m) on the costmap to plan and plan end."""
    cell = padded(raster_cell(raster, x, y), path.columns)
    return steps_to(path, cell) < UNREACHED and steps_to(goal, cell) < UNREACHED


@kernel
def _best_drive(
    ground: Ground,
    path: Wavefront,
    goal: Wavefront,
    rules: Rules,
    table: Floats,
    choice: Choice,
    work: _Work,
) -> tuple[int, float]:
    """Fill in promising forward rows; return best row and cost, (-1, inf) if none."""
    bounds = np.empty(choice.drives)
    for k in range(choice.drives):
        row = table[k]
        bounds[k] = _least_cost(ground.raster, path, goal, rules, row, work.start_cost)

    # The sooner a cheap row is known, the fewer others are rolled out. The likely row
    # comes first, then those of the lowest bounds.
    if choice.likely < choice.drives:
        bounds[choice.likely] = -math.inf
    best = -1
    best_cost = math.inf
    for _ in range(choice.drives):
        k = int(np.argmin(bounds))
        bound = bounds[k]
        bounds[k] = math.inf
        # Of equal costs the first row of the table wins.
        limit = best_cost if k < best else np.nextafter(best_cost, -math.inf)
        if bound > best_cost:
            break
        if bound > limit:
            continue

        cost = _cost(ground, path, goal, rules, table[k], limit, work)
        if cost >= 0.0:
            best = k
            best_cost = cost

    return best, best_cost


@kernel
def _best_turn(
    ground: Ground,
    path: Wavefront,
    goal: Wavefront,
    rules: Rules,
    table: Floats,
    choice: Choice,
    work: _Work,
    best: int,
    cost: float,
) -> int:
    """Fill in turns; return the one of no more cost that ends nearest, or `best`."""
    nearest = math.inf
    for k in range(choice.drives, len(table)):
        row = table[k]
        is_allowed = choice.left if row[TURN] > 0.0 else choice.right
        if not is_allowed:
            continue
        least = _least_cost(ground.raster, path, goal, rules, row, work.start_cost)
        if least > cost:
            continue

        turn_cost = _cost(ground, path, goal, rules, row, cost, work)
        if turn_cost < 0.0:
            continue

        # The original compares only this among turns that cost no more.
        distance = _goal_ahead(ground, goal, row, choice)
        if distance < nearest:
            best = k
            cost = turn_cost
            nearest = distance

    return best


@kernel
def _goal_ahead(ground: Ground, goal: Wavefront, row: Floats, choice: Choice) -> float:
    """Return the steps to the goal from ahead of a sample's end, inf if it may not win.

    The original's distance of a cell without a way is one of two large numbers: a
    smaller one if its wavefront stops there, a larger one if it never comes near.
    """
    x = row[END_X] + choice.lookahead_m * math.cos(row[END_YAW])
    y = row[END_Y] + choice.lookahead_m * math.sin(row[END_YAW])
    cell = raster_cell(ground.raster, x, y)
    if not is_on_grid(cell, ground.costs.shape):
        return math.inf

    place = padded(cell, goal.columns)
    steps = steps_to(goal, place)
    if steps < UNREACHED:
        return float(steps)
    if not choice.past_blocked:
        return math.inf
    if is_bordered(goal, place):
        return float(UNREACHED)
    return float(UNREACHED) + 1.0


@kernel
def _cost(
    ground: Ground,
    path: Wavefront,
    goal: Wavefront,
    rules: Rules,
    row: Floats,
    limit: float,
    work: _Work,
) -> float:
    """Return a sample's cost, its row filled in; -1 if not allowed or over `limit`.

    At -1, the row has TOUCHES or NO_WAY, or its cost stays unknown.
    """
    weights = rules.weights
    steps = step_count(row[SPEED], row[TURN], rules.motion)
    # The rollout is cheap beside its footprints, which come only if the end may win.
    poses = work.poses[:steps]
    roll_out(rules.start, row[SPEED], row[TURN], rules.motion, poses)
    end = poses[steps - 1]
    cell = raster_cell(ground.raster, end[X], end[Y])
    if not is_on_grid(cell, ground.costs.shape):
        row[COST] = TOUCHES
        return -1.0

    place = padded(cell, path.columns)
    to_path = steps_to(path, place)
    to_goal = steps_to(goal, place)
    if to_path >= UNREACHED or to_goal >= UNREACHED:
        row[COST] = NO_WAY
        return -1.0

    # The footprint costs no less than at the start, which all rollouts share.
    end_cost = weights.path * to_path + weights.goal * to_goal
    if end_cost + weights.obstacle * work.start_cost > limit:
        return -1.0

    highest = _highest_cost(
        ground, path, goal, poses, weights.obstacle, limit - end_cost, work
    )
    cost = end_cost + weights.obstacle * highest
    if highest < 0:
        row[COST] = TOUCHES
    if highest < 0 or cost > limit:
        return -1.0

    row[END_X] = end[X]
    row[END_Y] = end[Y]
    row[END_YAW] = end[YAW]
    row[PATH] = to_path
    row[GOAL] = to_goal
    row[OBSTACLE] = highest
    row[COST] = cost
    return cost


@kernel
def _least_cost(
    raster: Raster,
    path: Wavefront,
    goal: Wavefront,
    rules: Rules,
    row: Floats,
    start_cost: int,
) -> float:
    """Return a lower bound of a sample's cost, from the steps where its rollout ends.

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
    low = raster_cell(raster, x - _ROUNDING_M, y - _ROUNDING_M)
    high = raster_cell(raster, x + _ROUNDING_M, y + _ROUNDING_M)
    weights = rules.weights
    to_path = _least_steps(path, low, high)
    to_goal = _least_steps(goal, low, high)
    return (
        weights.path * to_path + weights.goal * to_goal + weights.obstacle * start_cost
    )


@kernel
def _least_steps(front: Wavefront, low: Cell, high: Cell) -> int:
    """Return the least steps to a cell of a block, corners included, or UNREACHED."""
    columns = front.columns
    shape = (len(front.state) // columns - 2, columns - 2)
    steps = UNREACHED
    for row in range(low.row, high.row + 1):
        for col in range(low.col, high.col + 1):
            cell = Cell(row, col)
            if is_on_grid(cell, shape):
                steps = min(steps, steps_to(front, padded(cell, columns)))
    return steps


@kernel
def _highest_cost(
    ground: Ground,
    path: Wavefront,
    goal: Wavefront,
    poses: Floats,
    weight: float,
    limit: float,
    work: _Work,
) -> int:
    """Return the highest edge cost of a rollout, -1 if not allowed; stop over `limit`.

    It may be a lower one that costs more than the limit already.
    """
    costs, raster, outline = ground
    highest = work.start_cost

    # A few poses along the whole rollout first: most bad ones are found out by them.
    for stride in (_STRIDE, 1):
        for k in range(stride, len(poses), stride):
            if stride == 1 and k % _STRIDE == 0:
                continue

            x, y, _, cos_yaw, sin_yaw = poses[k]
            cost = edges_cost(costs, raster, outline, x, y, cos_yaw, sin_yaw)
            highest = max(highest, cost)
            if cost < 0:
                return -1
            if weight * highest > limit + _ROUNDING:
                return highest

            if not _is_reached(raster, path, goal, x, y):
                return -1

    return highest
