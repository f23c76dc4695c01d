"""Kernels of MPPI that evaluate: its critics, which add to costs, and its path.

Arrays over samples are float32: controls (steps, 2, samples) in m/s and rad/s, and
poses (steps, 3, samples), x and y in m and yaw in rad. Samples come last, so that the
compiler vectorizes the inner loops over them. Costs (samples,) are changed in place.
"""

import math

import numpy as np

from barn_planners.costmap.kernels import (
    INSCRIBED,
    LETHAL,
    Grid,
    cell_at,
    edge_cost,
    place_corners,
)
from barn_planners.interface import FloatArray
from barn_worlds.base.arrays import Bools, Bytes, MediumIntegers, Singles, kernel

# Points of the path that a trajectory usually passes between two poses that are
# compared.
_USUAL_POINTS = 2


@kernel
def length(x: float, y: float) -> float:
    """Return a vector's length as hypot of glibc since 2.35, but without its scaling.

    It is the same to the last bit where no square overflows or underflows, that is, for
    components of zero or of 1e-138 to 1e153. Above that range the result is NaN; below
    it, imprecise or 0.

    Unlike a call of hypot, a loop over this function is vectorized.

    Args:
        x: Component along one axis.
        y: Component along the other.
    """
    # The rounding error of the plain formula, computed and subtracted.
    longer = max(abs(x), abs(y))
    shorter = min(abs(x), abs(y))
    rough = math.sqrt(longer * longer + shorter * shorter)
    over_shorter = rough - shorter
    over_longer = rough - longer
    near_error = (
        longer * (2.0 * over_shorter - longer)
        + (over_shorter - 2.0 * (longer - shorter)) * over_shorter
    )
    far_error = 2.0 * over_longer * (longer - 2.0 * shorter) + (
        (4.0 * over_longer - shorter) * shorter + over_longer * over_longer
    )
    error = near_error if rough <= 2.0 * shorter else far_error
    return rough - error / (2.0 * rough) if rough > 0.0 else rough


@kernel
def add_obstacle_costs(
    costs: FloatArray,
    poses: Singles,
    cells: Bytes,
    grid: Grid,
    outline: FloatArray,
    lowest_edge_cost: int,
    stride: int,
    weight: float,
    critical_cost: float,
    collision_cost: float,
    is_near_goal: bool,
) -> int:
    """Add costmap costs of trajectories to `costs`; return how many collide.

    A trajectory whose footprint touches a lethal cell costs `collision_cost`. Others
    cost the mean of the cells under their poses, as a share of 254.

    Args:
        costs: Costs (samples,).
        poses: Poses (steps, 3, samples) in the frame of the costmap.
        cells: Costs (rows, columns) of the costmap's cells.
        grid: Place of the costmap.
        outline: Corners (n, 2) of the footprint in base_link, in m.
        lowest_edge_cost: Lowest cost under a pose at which its edges are checked.
        stride: Every n-th pose is checked.
        weight: Weight of the mean cost.
        critical_cost: Cost of a cell that is at least inscribed.
        collision_cost: Cost of a trajectory that collides.
        is_near_goal: Whether only critical cells and collisions count.

    Returns:
        Number of trajectories that collide.
    """
    steps, _, samples = poses.shape
    # In this order: a cost is a share of 254, and its mean is over the checked poses.
    scale = weight / LETHAL / len(range(0, steps, stride))
    prices = np.zeros(256)
    for cost in range(1, 256):
        if cost >= INSCRIBED:
            prices[cost] = critical_cost
        elif not is_near_goal:
            prices[cost] = cost

    totals = np.zeros(samples)
    collides = np.zeros(samples, np.bool_)
    indices = np.empty(samples, np.int32)
    corners = np.empty(outline.shape)
    # Once per cycle, so that most outlines cost four look-ups instead of four lines.
    lethal_counts = _sum_lethal_cells(cells)
    for t in range(0, steps, stride):
        x = poses[t, 0]
        y = poses[t, 1]
        yaw = poses[t, 2]
        _find_cells(x, y, cells, grid, indices)
        for k in range(samples):
            # Off the grid nothing is known, so nothing is added; one collision is
            # enough.
            if indices[k] < 0 or collides[k]:
                continue
            cost = cells.flat[indices[k]]
            totals[k] += prices[cost]
            # Under a low cost or none, no lethal cell is near enough for the edges to
            # touch it.
            if cost >= lowest_edge_cost and cost > 0:
                place_corners(corners, x[k], y[k], yaw[k], outline)
                collides[k] = cost >= LETHAL or _edges_collide(
                    cells, grid, lethal_counts, corners
                )
    for k in range(samples):
        # Not infinite: if all samples collide, weights must still be numbers.
        costs[k] += collision_cost if collides[k] else scale * totals[k]
    collisions: int = collides.sum()
    return collisions


@kernel
def _find_cells(
    x: Singles, y: Singles, cells: Bytes, grid: Grid, indices: MediumIntegers
) -> None:
    """Write the flat index, row by row, of the cell at each point; -1 off the grid."""
    origin_x, origin_y, resolution = grid
    rows, columns = cells.shape
    for k in range(len(x)):
        row = math.floor((y[k] - origin_y) / resolution)
        column = math.floor((x[k] - origin_x) / resolution)
        # Without `and`, so that the loop has no branches.
        is_inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        indices[k] = np.int32(row * columns + column) if is_inside else np.int32(-1)


@kernel
def _sum_lethal_cells(cells: Bytes) -> MediumIntegers:
    """Return the summed-area table (rows + 1, columns + 1) of lethal cells.

    Each entry counts the lethal cells in the rows and columns before it.
    """
    rows, columns = cells.shape
    counts = np.zeros((rows + 1, columns + 1), np.int32)
    for row in range(rows):
        in_row = np.int32(0)
        for column in range(columns):
            in_row += np.int32(cells[row, column] >= LETHAL)
            # A summed-area table: any box's count is a sum of four entries.
            counts[row + 1, column + 1] = counts[row, column + 1] + in_row
    return counts


@kernel
def _edges_collide(
    cells: Bytes, grid: Grid, lethal_counts: MediumIntegers, corners: FloatArray
) -> bool:
    """Return whether a footprint's edges touch a lethal cell or leave the grid.

    Edges are followed only if the box around them holds a lethal cell, by four sums.
    """
    rows, columns = cells.shape
    first_row = rows
    end_row = 0
    first_column = columns
    end_column = 0
    for k in range(len(corners)):
        row, column = cell_at(grid, corners[k, 0], corners[k, 1])
        first_row = min(first_row, row)
        end_row = max(end_row, row + 1)
        first_column = min(first_column, column)
        end_column = max(end_column, column + 1)
    if first_row < 0 or end_row > rows or first_column < 0 or end_column > columns:
        return True

    above = lethal_counts[end_row]
    below = lethal_counts[first_row]
    lethal_above = above[end_column] - above[first_column]
    lethal_below = below[end_column] - below[first_column]
    if lethal_above == lethal_below:
        return False
    return bool(edge_cost(cells, corners, grid) < 0)


@kernel
def find_furthest_point(path: FloatArray, poses: Singles) -> int:
    """Return the highest index of the path points nearest to the trajectories' ends.

    Args:
        path: Points (n, 2) in m.
        poses: Poses (steps, 3, samples).

    Returns:
        The highest index of the points that are nearest to the ends of the
        trajectories.
    """
    end_x = poses[-1, 0]
    end_y = poses[-1, 1]
    squares = np.full(len(end_x), math.inf)
    nearest = np.zeros(len(end_x), np.int64)
    for i in range(len(path)):
        # Points outside, samples inside: the inner loop has no branch and is
        # vectorized.
        path_x, path_y = path[i]
        for k in range(len(end_x)):
            square = (path_x - end_x[k]) ** 2 + (path_y - end_y[k]) ** 2
            nearest[k] = i if square < squares[k] else nearest[k]
            squares[k] = min(square, squares[k])
    furthest: int = nearest.max()
    return furthest


@kernel
def add_follow_costs(
    costs: FloatArray, poses: Singles, x: float, y: float, weight: float
) -> None:
    """Add to `costs` the weighted distance in m from trajectory ends to a point.

    Args:
        costs: Costs (samples,).
        poses: Poses (steps, 3, samples).
        x: Point in m.
        y: Point in m.
        weight: Cost per meter.
    """
    end_x = poses[-1, 0]
    end_y = poses[-1, 1]
    for k in range(len(costs)):
        costs[k] += weight * length(end_x[k] - x, end_y[k] - y)


@kernel
def add_angle_costs(
    costs: FloatArray, poses: Singles, x: float, y: float, weight: float
) -> None:
    """Add to `costs` the weighted angle at trajectory ends from heading to a point.

    Args:
        costs: Costs (samples,).
        poses: Poses (steps, 3, samples).
        x: Point in m.
        y: Point in m.
        weight: Cost per radian.
    """
    end_x = poses[-1, 0]
    end_y = poses[-1, 1]
    end_yaw = poses[-1, 2]
    for k in range(len(costs)):
        # From the end of the trajectory, as in Nav2's path angle critic.
        direction = math.atan2(y - end_y[k], x - end_x[k])
        costs[k] += weight * abs(_wrap_angle(direction - end_yaw[k]))


@kernel
def add_align_costs(
    costs: FloatArray,
    poses: Singles,
    start: tuple[float, float],
    path: FloatArray,
    arc: FloatArray,
    is_clear: Bools,
    stride: int,
    weight: float,
) -> None:
    """Add to `costs` the weighted mean distance from free path points as far along.

    Args:
        costs: Costs (samples,).
        poses: Poses (steps, 3, samples).
        start: Position of the robot in m.
        path: Points (n, 2) in m.
        arc: Distance along the path at each point, (n,) in m.
        is_clear: Whether a point is free, (n,); the others do not count.
        stride: Every n-th pose is compared.
        weight: Cost per meter.
    """
    steps, _, samples = poses.shape
    start_x, start_y = start
    last_x = np.full(samples, start_x)
    last_y = np.full(samples, start_y)
    driven = np.zeros(samples)
    totals = np.zeros(samples)
    counts = np.zeros(samples)
    # Index of the point at which the path is as long as the drive so far.
    beside = np.zeros(samples, np.int64)
    # The sentinel ends the search at the last point without a test of the index.
    ends = np.append(arc, math.inf)
    path_x = np.empty(samples)
    path_y = np.empty(samples)
    clear = np.empty(samples)
    # Several loops over the samples: those without a search are vectorized.
    for t in range(stride, steps, stride):
        x = poses[t, 0]
        y = poses[t, 1]
        for k in range(samples):
            driven[k] += length(x[k] - last_x[k], y[k] - last_y[k])
            last_x[k] = x[k]
            last_y[k] = y[k]
        for k in range(samples):
            i = beside[k]
            # First without branches, which would be mispredicted.
            for _ in range(_USUAL_POINTS):
                i += np.int64(abs(ends[i + 1] - driven[k]) <= abs(ends[i] - driven[k]))
            while abs(ends[i + 1] - driven[k]) <= abs(ends[i] - driven[k]):
                i += 1
            beside[k] = i
            path_x[k] = path[i, 0]
            path_y[k] = path[i, 1]
            clear[k] = is_clear[i]
        for k in range(samples):
            totals[k] += clear[k] * length(path_x[k] - x[k], path_y[k] - y[k])
            counts[k] += clear[k]
    for k in range(samples):
        if counts[k] > 0.0:
            costs[k] += weight * totals[k] / counts[k]


@kernel
def add_goal_costs(
    costs: FloatArray,
    poses: Singles,
    goal: tuple[float, float, float],
    position_weight: float,
    yaw_weight: float,
) -> None:
    """Add to `costs` the weighted mean distance from the goal and angle to its yaw.

    Args:
        costs: Costs (samples,).
        poses: Poses (steps, 3, samples).
        goal: x and y in m, yaw in rad.
        position_weight: Cost per meter.
        yaw_weight: Cost per radian.
    """
    steps, _, samples = poses.shape
    goal_x, goal_y, goal_yaw = goal
    distances = np.zeros(samples)
    angles = np.zeros(samples)
    for t in range(steps):
        x = poses[t, 0]
        y = poses[t, 1]
        yaw = poses[t, 2]
        if position_weight > 0.0:
            for k in range(samples):
                distances[k] += length(x[k] - goal_x, y[k] - goal_y)
        if yaw_weight > 0.0:
            for k in range(samples):
                angles[k] += abs(_wrap_angle(yaw[k] - goal_yaw))
    for k in range(samples):
        costs[k] += (position_weight * distances[k] + yaw_weight * angles[k]) / steps


@kernel
def add_control_costs(
    costs: FloatArray,
    controls: Singles,
    nominal: FloatArray,
    spread: FloatArray,
    limits: FloatArray,
    dt: float,
    gamma: float,
    limit_weight: float,
    forward_weight: float,
) -> None:
    """Add to `costs` the controls' own: deviation, excess over limits, reverse.

    The costs are gamma times control times deviation over variance (Williams 2018), the
    excess over the limits, and the distance driven in reverse.

    Args:
        costs: Costs (samples,).
        controls: Sampled controls (steps, 2, samples).
        nominal: Controls (steps, 2) that they were sampled around.
        spread: Standard deviations (2,) of speed and yaw rate.
        limits: Lowest and highest speed in m/s, and highest yaw rate in rad/s, (3,).
        dt: Time of a step in s.
        gamma: Weight of the deviation.
        limit_weight: Cost per m/s or rad/s beyond the limits, for each second.
        forward_weight: Cost per meter in reverse.
    """
    steps, _, samples = controls.shape
    deviation = np.zeros(samples)
    beyond = np.zeros(samples)
    reverse = np.zeros(samples)
    slowest = limits[0]
    fastest = limits[1]
    fastest_turn = limits[2]
    speed_variance = spread[0] * spread[0]
    rate_variance = spread[1] * spread[1]
    for t in range(steps):
        speed = controls[t, 0]
        rate = controls[t, 1]
        nominal_speed = nominal[t, 0]
        nominal_rate = nominal[t, 1]
        for k in range(samples):
            # The information-theoretic term: it keeps samples near the solution that
            # they are from.
            along = nominal_speed * (speed[k] - nominal_speed) / speed_variance
            turn = nominal_rate * (rate[k] - nominal_rate) / rate_variance
            deviation[k] = deviation[k] + along + turn
        for k in range(samples):
            beyond[k] += (
                max(0.0, speed[k] - fastest)
                + max(0.0, slowest - speed[k])
                + max(0.0, abs(rate[k]) - fastest_turn)
            )
            reverse[k] += max(0.0, -speed[k])
    for k in range(samples):
        penalty = limit_weight * beyond[k] + forward_weight * reverse[k]
        costs[k] += gamma * deviation[k] + penalty * dt


@kernel
def resample(points: FloatArray, spacing: float, max_points: int) -> FloatArray:
    """Return up to `max_points` points evenly along a line, its start first, end last.

    Args:
        points: Corners (n, 2) of the line in m.
        spacing: Distance along the line between two points in m.
        max_points: Highest number of points.

    Returns:
        Points (m, 2): the first corner, and the last one if there is room.
    """
    result = np.empty((max_points, 2))
    result[0] = points[0]
    count = 1
    # Distance since the last point.
    carry = 0.0
    for i in range(len(points) - 1):
        dx = points[i + 1, 0] - points[i, 0]
        dy = points[i + 1, 1] - points[i, 1]
        side = math.hypot(dx, dy)
        # A spacing may begin on one side of a corner and end on the next.
        along = spacing - carry
        while along <= side and count < max_points:
            result[count, 0] = points[i, 0] + dx * along / side
            result[count, 1] = points[i, 1] + dy * along / side
            count += 1
            along += spacing
        carry = side - (along - spacing)
    # Where the last corner is a point already, it must not appear twice.
    if count < max_points and carry > 1e-9:
        result[count] = points[-1]
        count += 1
    return result[:count]


@kernel
def _wrap_angle(angle: float) -> float:
    """Return an angle in rad wrapped to [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
