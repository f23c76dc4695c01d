"""Kernels of the dynamic window approach: velocities, rollouts, costs, steps to the plan.

They follow base_local_planner's trajectory_planner.cpp: `createTrajectories` (samples)
and `generateTrajectory` (rollouts and costs).

Steps on the grid to the plan and to its end are `MapGrid::computeTargetDistance`
(map_grid.cpp), but a wavefront spreads only as far as someone asks for. Its cells are
numbers in a flat grid that is padded by one blocked cell on each side, which spares
checks at the edges.
"""

import math
from typing import NamedTuple

import numpy as np

from barn_planners.costmap.kernels import (
    INSCRIBED,
    Cell,
    Grid,
    Pose,
    cell_at,
    corners_at,
    footprint_cells,
    is_on_grid,
    line_cost,
)
from barn_worlds.base.arrays import (
    Bytes,
    Cells,
    Floats,
    Integers,
    MediumIntegers,
    Points,
    kernel,
)

UNREACHED = 2**30

# States of a cell.
OPEN = np.uint8(0)
BLOCKED = np.uint8(1)
REACHED = np.uint8(2)

# Positions in `Wavefront.ends`.
_HEAD = 0  # place in the queue of the cell to go on with
_TAIL = 1  # number of cells in the queue

# Costs of samples that are not allowed.
TOUCHES = -1.0  # the footprint touches an obstacle or leaves the costmap
NO_WAY = -2.0  # no way leads from the rollout to the plan or to its end

# Columns of the table of samples, of which the first two are given.
SPEED, TURN, COST, END_X, END_Y, END_YAW, PATH, GOAL, OBSTACLE = range(9)
COLUMNS = 9

# Columns of the poses of a rollout.
X, Y, YAW, COS, SIN = range(5)

# More than a plan across the largest local costmap has.
_MAX_PLAN_CELLS = 4096


class Wavefront(NamedTuple):
    """Flat arrays over the padded grid, and how far the wavefront has come."""

    distances: MediumIntegers  # steps from the nearest seed, valid where REACHED
    state: Bytes  # OPEN, BLOCKED or REACHED
    queue: MediumIntegers  # cells in the order in which they are reached
    ends: Integers  # head and tail of the queue
    columns: int  # of the padded grid


def new_wavefront(rows: int, cols: int) -> Wavefront:
    """Return uninitialized memory for a wavefront on rows x cols cells, padded by one.

    Args:
        rows: Number of rows of the costmap.
        cols: Number of its columns.
    """
    size = (rows + 2) * (cols + 2)
    return Wavefront(
        np.empty(size, np.int32),
        np.empty(size, np.uint8),
        np.empty(size, np.int32),
        np.zeros(2, np.int64),
        cols + 2,
    )


@kernel
def padded(cell: Cell, columns: int) -> int:
    """Return a cell's index in the flat grid that is padded by a cell on each side.

    Args:
        cell: Cell of the costmap.
        columns: Number of columns of the padded grid.
    """
    return (cell.row + 1) * columns + cell.col + 1


@kernel
def block_cells(costs: Bytes, state: Bytes) -> None:
    """Write BLOCKED for cells of cost 253 and more and the padding, OPEN for others.

    Args:
        costs: Costs of the costmap (rows, columns).
        state: Array over the padded grid that receives OPEN or BLOCKED.
    """
    rows, cols = costs.shape
    width = cols + 2
    state[:] = BLOCKED
    for row in range(rows):
        source = costs[row]
        target = state[(row + 1) * width + 1 : (row + 2) * width - 1]
        for col in range(cols):
            target[col] = BLOCKED if source[col] >= INSCRIBED else OPEN


@kernel
def open_cells(cells: Cells, columns: int, state: Bytes) -> None:
    """Set cells under the robot to OPEN in the padded `state`, whatever they cost.

    `MapGrid` sets them within_robot.

    Args:
        cells: Cells (n, 2) of the costmap.
        columns: Number of columns of the padded grid.
        state: Array over the padded grid, from `block_cells`.
    """
    for row, col in cells:
        state[padded(Cell(row, col), columns)] = OPEN


@kernel
def plan_cells(
    plan: Points, grid: Grid, shape: tuple[int, int], cells: Integers
) -> int:
    """Write padded indices of cells on a plan until it leaves the grid; return count.

    Follows `MapGrid::adjustPlanResolution` and `setTargetCells`: long segments are cut
    so that no cell is left out.

    Args:
        plan: Points (n, 2 or more), x and y in m.
        grid: Place of the costmap.
        shape: Numbers of rows and columns of the costmap.
        cells: Array that receives the padded numbers; a longer plan is cut off.

    Returns:
        Number of cells.
    """
    count = 0
    for k in range(len(plan)):
        before = max(0, k - 1)
        dx = plan[k, 0] - plan[before, 0]
        dy = plan[k, 1] - plan[before, 1]
        pieces = max(1, math.ceil(math.hypot(dx, dy) / grid.resolution + 1e-6))
        for piece in range(1, pieces + 1):
            # From the start of the segment, so that errors do not add up.
            share = piece / pieces
            x = plan[before, 0] + share * dx
            y = plan[before, 1] + share * dy
            cell = cell_at(grid, x, y)
            # The plan may begin off the costmap; it ends where it first leaves it.
            if not is_on_grid(cell, shape):
                if count > 0:
                    return count
                continue

            number = padded(cell, shape[1] + 2)
            if count == 0 or cells[count - 1] != number:
                if count == len(cells):
                    return count
                cells[count] = number
                count += 1

    return count


@kernel
def start_wavefront(front: Wavefront, walls: Bytes, seeds: Integers) -> None:
    """Reset a wavefront in place: cells as in `walls`, but seeds reached in 0 steps.

    Args:
        front: Wavefront to start.
        walls: What blocks, from `block_cells`.
        seeds: Padded numbers of the cells with distance 0, wherever they are.
    """
    # A loop is ten times as fast here as numba's assignment of a whole array.
    for cell in range(len(walls)):
        front.state[cell] = walls[cell]

    # Seeds count as reached even where they are blocked, so that ways lead out of them.
    tail = 0
    for seed in seeds:
        if front.state[seed] != REACHED:
            front.distances[seed] = 0
            front.state[seed] = REACHED
            front.queue[tail] = seed
            tail += 1
    front.ends[_HEAD] = 0
    front.ends[_TAIL] = tail


@kernel
def steps_to(front: Wavefront, cell: int) -> int:
    """Spread a wavefront to a cell; return its steps from a seed, UNREACHED if no way.

    Args:
        front: Wavefront, which spreads to the cell.
        cell: Padded number of the cell.

    Returns:
        UNREACHED if no way leads to the cell.
    """
    place = np.uint64(cell)
    if front.state[place] == OPEN:
        _spread(front, place)
    if front.state[place] != REACHED:
        return UNREACHED

    steps: int = front.distances[place]
    return steps


@kernel
def is_bordered(front: Wavefront, cell: int) -> bool:
    """Return whether a wavefront, which spreads for that, reaches a neighbor of a cell.

    Args:
        front: Wavefront, which spreads as far as necessary.
        cell: Padded number of the cell, which is not in the padding.
    """
    steps = min(
        steps_to(front, cell - 1),
        steps_to(front, cell + 1),
        steps_to(front, cell - front.columns),
        steps_to(front, cell + front.columns),
    )
    return steps < UNREACHED


@kernel
def _spread(front: Wavefront, goal: np.uint64) -> None:
    """Continue a wavefront in place until it reaches a padded index or cannot go on."""
    distances = front.distances
    state = front.state
    queue = front.queue
    row = np.uint64(front.columns)
    unit = np.uint64(1)
    head = np.uint64(front.ends[_HEAD])
    tail = np.uint64(front.ends[_TAIL])
    while head < tail and state[goal] == OPEN:
        cell = np.uint64(queue[head])
        head += unit
        steps = distances[cell] + np.int32(1)
        for neighbor in (cell - unit, cell + unit, cell - row, cell + row):
            # Selections instead of branches, half of which would be mispredicted.
            is_open = state[neighbor] == OPEN
            distances[neighbor] = steps if is_open else distances[neighbor]
            state[neighbor] = REACHED if is_open else state[neighbor]
            # Written in any case; the place counts only if the tail moves on.
            queue[tail] = neighbor
            tail += np.uint64(is_open)

    front.ends[_HEAD] = head
    front.ends[_TAIL] = tail


class Raster(NamedTuple):
    """Place of a costmap, by cells per meter, as a division takes longer."""

    # Outer corner of cell (0, 0) in m.
    x: float
    y: float
    per_m: float


class Ground(NamedTuple):
    """What footprints are checked on."""

    costs: Bytes  # (rows, columns)
    raster: Raster
    outline: Points  # corners (n, 2) of the padded footprint in base_link, in m


class Scene(NamedTuple):
    """What rollouts are scored on; kernels take its parts one by one."""

    ground: Ground
    path: Wavefront  # steps to the plan
    goal: Wavefront  # steps to the plan's end


class Start(NamedTuple):
    """Pose (m, rad) and velocity (m/s, rad/s) that rollouts begin with."""

    x: float
    y: float
    yaw: float
    speed: float
    turn: float


class Motion(NamedTuple):
    """How rollouts move."""

    time_s: float
    # Distance and turn between two poses.
    step_m: float
    turn_step_rad: float
    # m/s2 and rad/s2.
    acceleration: float
    turn_acceleration: float


class Weights(NamedTuple):
    """Weights of the three parts of a cost."""

    path: float  # of a step to the plan
    goal: float  # of a step to the plan's end
    obstacle: float  # of the highest cost under the footprint's edges


class Rules(NamedTuple):
    """How rollouts begin and move in one control cycle, and what they cost."""

    start: Start
    motion: Motion
    weights: Weights


class Fields(NamedTuple):
    """Memory for the scenes of all cycles on one size of costmap."""

    costs: Bytes  # copy of the costs, since the costmap changes in place
    path: Wavefront
    goal: Wavefront
    walls: Bytes  # what blocks, over the padded grid of wavefronts
    plan: Integers  # padded cells of the plan


def new_fields(rows: int, cols: int) -> Fields:
    """Return uninitialized memory for the scenes on a costmap of rows x cols cells.

    Args:
        rows: Number of rows of the costmap.
        cols: Number of its columns.
    """
    return Fields(
        np.empty((rows, cols), np.uint8),
        new_wavefront(rows, cols),
        new_wavefront(rows, cols),
        np.empty((rows + 2) * (cols + 2), np.uint8),
        np.empty(_MAX_PLAN_CELLS, np.int64),
    )


@kernel
def even_values(low: float, high: float, count: int, accumulate: bool) -> Floats:
    """Return `count` evenly spaced values from low to high, by linspace or by sums.

    Sums of steps end near `high`, not at it.

    Args:
        low: First value.
        high: Last value.
        count: Number of values, at least 2.
        accumulate: Whether to add up steps as the original does, with its rounding.
    """
    step = (high - low) / (count - 1)
    values = np.empty(count)
    value = low
    for k in range(count):
        values[k] = value if accumulate else k * step + low
        value += step
    if not accumulate:
        values[-1] = high

    return values


@kernel
def sample_table(
    speeds: Floats, turns_ahead: Floats, turns: Floats, slowest: float, fast: float
) -> tuple[Floats, int]:
    """Return unscored samples (n, COLUMNS), forward ones first, and how many those are.

    Args:
        speeds: Forward speeds in m/s.
        turns_ahead: Yaw rates for each speed in rad/s, besides straight ahead.
        turns: Yaw rates in rad/s to turn in place with.
        slowest: Slowest yaw rate in place in rad/s; those below are raised to it.
        fast: Only faster turns are tried in place, in rad/s; below 0 all are.

    Returns:
        Table (n, COLUMNS) with speeds and yaw rates; the rest is 0. Rows that drive
        forward come first, for each speed straight ahead and one per yaw rate. The
        others turn in place.
    """
    turns_per_speed = len(turns_ahead) + 1
    drives = len(speeds) * turns_per_speed
    table = np.zeros((drives + len(turns), COLUMNS))
    for k in range(drives):
        table[k, SPEED] = speeds[k // turns_per_speed]
        if k % turns_per_speed > 0:
            table[k, TURN] = turns_ahead[k % turns_per_speed - 1]

    count = drives
    for turn in turns:
        if abs(turn) > fast:
            in_place = max(turn, slowest) if turn > 0.0 else min(turn, -slowest)
            table[count, TURN] = in_place
            count += 1

    return table[:count], drives


@kernel
def prepare(
    fields: Fields,
    costs: Bytes,
    grid: Grid,
    plan: Points,
    pose: Pose,
    outline: Points,
    robot_blocks_goal: bool,
) -> bool:
    """Copy costs, start both wavefronts in `fields`; False if the plan is off the grid.

    Args:
        fields: Fields to write.
        costs: Costs of the local costmap (rows, columns).
        grid: Place of the costmap.
        plan: Points (n, 2 or more) of the visible plan, x and y in m.
        pose: Pose of base_link.
        outline: Corners (n, 2) of the padded footprint in base_link, in m.
        robot_blocks_goal: Whether cells under the robot block the way to the goal.

    Returns:
        False if the plan does not lie on the costmap.
    """
    rows, cols = costs.shape
    count = plan_cells(plan, grid, costs.shape, fields.plan)
    if count == 0:
        return False

    # A display may ask for all samples after the costmap has changed.
    for row in range(rows):
        for col in range(cols):
            fields.costs[row, col] = costs[row, col]

    # The robot may stand on blocked cells and must still find its way out of them.
    robot = footprint_cells(corners_at(outline, pose), grid, costs.shape)
    plan_end = fields.plan[count - 1 : count]
    block_cells(costs, fields.walls)
    if robot_blocks_goal:
        start_wavefront(fields.goal, fields.walls, plan_end)
    open_cells(robot, cols + 2, fields.walls)
    if not robot_blocks_goal:
        start_wavefront(fields.goal, fields.walls, plan_end)
    start_wavefront(fields.path, fields.walls, fields.plan[:count])
    return True


@kernel
def raster_cell(raster: Raster, x: float, y: float) -> Cell:
    """Return the cell (row along y, column along x) of a point, also off the grid.

    Args:
        raster: Place of the costmap.
        x: Coordinate in m in the frame of the costmap, as `y`.
        y: Coordinate in m.
    """
    row = math.floor((y - raster.y) * raster.per_m)
    col = math.floor((x - raster.x) * raster.per_m)
    return Cell(row, col)


@kernel
def edges_cost(
    costs: Bytes,
    raster: Raster,
    outline: Points,
    x: float,
    y: float,
    cos_yaw: float,
    sin_yaw: float,
) -> int:
    """Return the highest cost under a footprint's edges, -1 if lethal or off the grid.

    It takes the parts of `Ground` one by one, because numba counts references to the
    arrays of a tuple each time it takes one out.

    Args:
        costs: Costs (rows, columns), as in `Ground`.
        raster: Place of the costmap.
        outline: Corners (n, 2) of the footprint.
        x: Position of base_link in m in the frame of the costmap, as `y`.
        y: Position of base_link in m.
        cos_yaw: Cosine of the heading.
        sin_yaw: Sine of the heading.

    Returns:
        The cost, -1 if the edges touch a lethal cell or leave the costmap.
    """
    highest = 0
    end = Cell(0, 0)
    # The last corner comes first: an edge leads from it to the first one.
    for k in range(-1, len(outline)):
        start = end
        end = raster_cell(
            raster,
            x + cos_yaw * outline[k, 0] - sin_yaw * outline[k, 1],
            y + sin_yaw * outline[k, 0] + cos_yaw * outline[k, 1],
        )
        if not is_on_grid(end, costs.shape):
            return -1
        if k >= 0:
            highest = line_cost(costs, start, end, highest)
            if highest < 0:
                return -1

    return highest


@kernel
def step_count(speed: float, turn: float, motion: Motion) -> int:
    """Return the number of poses of a sample's rollout, at least 1.

    As in the original, the distance counts over the whole time, the turn per second.

    Args:
        speed: Forward speed of the sample in m/s.
        turn: Yaw rate of the sample in rad/s.
        motion: How rollouts move.
    """
    # The footprint is checked only at poses, so fast rollouts get more of them.
    steps = abs(speed) * motion.time_s / motion.step_m
    return max(1, int(max(steps, abs(turn) / motion.turn_step_rad) + 0.5))


@kernel
def approach(velocity: float, target: float, change: float) -> float:
    """Return `velocity` moved toward `target` by at most `change`, all in one unit."""
    if target >= velocity:
        return min(target, velocity + change)
    return max(target, velocity - change)


@kernel
def roll_out(
    start: Start, speed: float, turn: float, motion: Motion, poses: Floats
) -> None:
    """Write the rollout of a sample into `poses`, its first row at the start.

    Args:
        start: Pose and velocity at the start.
        speed: Forward speed of the sample in m/s.
        turn: Yaw rate of the sample in rad/s.
        motion: How rollouts move.
        poses: Array (steps, 5) that receives x and y in m, yaw in rad, and its cosine
            and sine; its length sets the time between two poses.
    """
    x = start.x
    y = start.y
    yaw = start.yaw
    # The rollout begins with the robot's own velocity and approaches the sample's.
    velocity = start.speed
    rate = start.turn
    dt = motion.time_s / len(poses)
    for k in range(len(poses)):
        cos_yaw = math.cos(yaw)
        sin_yaw = math.sin(yaw)
        poses[k, X] = x
        poses[k, Y] = y
        poses[k, YAW] = yaw
        poses[k, COS] = cos_yaw
        poses[k, SIN] = sin_yaw
        # The original moves by the new speed along the old heading.
        velocity = approach(velocity, speed, motion.acceleration * dt)
        x += velocity * cos_yaw * dt
        y += velocity * sin_yaw * dt
        rate = approach(rate, turn, motion.turn_acceleration * dt)
        yaw += rate * dt


@kernel
def traces(start: Start, table: Floats, motion: Motion, count: int) -> Floats:
    """Return rollouts for display, stretched or padded to `count` poses: (n, count, 3).

    Args:
        start: Pose and velocity at their start.
        table: Samples (n, 2 or more), speed and yaw rate.
        motion: How rollouts move.
        count: Number of poses of each.

    Returns:
        Poses (n, count, 3), x and y in m, yaw in rad. A rollout of more poses takes
        longer steps; the last pose of a shorter one is repeated.
    """
    lines = np.empty((len(table), count, 3))
    for i in range(len(table)):
        steps = min(step_count(table[i, SPEED], table[i, TURN], motion), count)
        poses = np.empty((steps, 5))
        roll_out(start, table[i, SPEED], table[i, TURN], motion, poses)
        for k in range(count):
            lines[i, k] = poses[min(k, steps - 1), :3]

    return lines


@kernel
def score(
    ground: Ground, path: Wavefront, goal: Wavefront, rules: Rules, table: Floats
) -> None:
    """Fill in cost, end, distances of each sample; TOUCHES or NO_WAY if not allowed.

    `search.find_best` scores only the best sample.

    Args:
        ground: What footprints are checked on.
        path: Steps to the plan.
        goal: Steps to the plan's end.
        rules: How rollouts move and what they cost.
        table: Table of samples with speeds and yaw rates. The cost is TOUCHES or NO_WAY
            where a pose of the rollout is not allowed.
    """
    costs, raster, outline = ground
    weights = rules.weights
    for row in table:
        poses = np.empty((step_count(row[SPEED], row[TURN], rules.motion), 5))
        roll_out(rules.start, row[SPEED], row[TURN], rules.motion, poses)
        obstacle = 0
        row[COST] = TOUCHES
        for pose in poses:
            x, y, yaw, c, s = pose
            cost = edges_cost(costs, raster, outline, x, y, c, s)
            # The highest cost of the whole rollout counts, the distances only of its
            # end.
            obstacle = max(obstacle, cost) if cost >= 0 else -1
            if obstacle < 0:
                break

            cell = padded(raster_cell(raster, x, y), path.columns)
            to_path = steps_to(path, cell)
            to_goal = steps_to(goal, cell)
            if to_path >= UNREACHED or to_goal >= UNREACHED:
                obstacle = -1
                row[COST] = NO_WAY
                break

            row[END_X] = x
            row[END_Y] = y
            row[END_YAW] = yaw
            row[PATH] = to_path
            row[GOAL] = to_goal

        if obstacle >= 0:
            row[OBSTACLE] = obstacle
            row[COST] = (
                weights.path * row[PATH]
                + weights.goal * row[GOAL]
                + weights.obstacle * obstacle
            )
