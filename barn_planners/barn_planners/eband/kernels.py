"""Kernels of the elastic band: bubbles, refining, connecting; `forces` moves bubbles.

They follow eband_local_planner.cpp. A band is float64 (capacity, 4) with the columns X,
Y, RADIUS (m) and YAW (rad), robot first; only its first n rows are in use. Functions
that change a band return its new length, or below 0 one of the codes of REASONS.
"""

import math
from typing import NamedTuple

import numpy as np

from barn_planners.costmap.kernels import Grid, Pose, cell_at, is_on_grid
from barn_worlds.base.arrays import Bytes, Floats, Integers, kernel

# Kernels cannot raise texts cheaply, so failures are negative lengths.
IN_COLLISION = -1
GAP = -2
FULL = -3

REASONS = {
    IN_COLLISION: "a bubble of the band is in collision",
    GAP: "a gap of the band cannot be filled",
    FULL: "the band has too many bubbles",
}

# Columns of a band.
X, Y, RADIUS, YAW = range(4)

_FULL_TURN = 2.0 * math.pi
_STACK = 64  # depth of a stack; numba cannot cache kernels that call themselves


class Clearance(NamedTuple):
    """Radii of bubbles by their centers."""

    costs: Bytes  # of the local costmap (rows, columns)
    grid: Grid
    radii: Floats  # in m by cost, (256,)


class BandGains(NamedTuple):
    """Constants of forces; all but the first are fields of `EBandConfig`."""

    metres_per_rad: float  # distance that a radian of heading counts as; 0: none
    min_overlap: float
    tiny_bubble_m: float
    internal_gain: float
    external_gain: float
    overshoot: float
    significant_force: float
    halvings: int
    sweeps: int
    weighs_x_twice: bool


class BandWork(NamedTuple):
    """Memory for bands of one capacity."""

    nodes: Floats  # bubbles that take part in refining, in any order, (capacity, 4)
    links: Integers  # node before and node after each of them, (capacity, 2)
    # First node, last node and whether the halves are done, of intervals to refine.
    stack: Integers
    ends: Integers  # nodes that a bridge still has to reach


class Context(NamedTuple):
    """What all operations on a band share."""

    clearance: Clearance
    gains: BandGains
    work: BandWork


def new_band_work(capacity: int) -> BandWork:
    """Return zeroed memory for bands of up to `capacity` bubbles."""
    return BandWork(
        np.zeros((capacity, 4)),
        np.zeros((capacity, 2), np.int64),
        np.zeros((_STACK, 3), np.int64),
        np.zeros(_STACK, np.int64),
    )


@kernel
def radius_at(clearance: Clearance, x: float, y: float) -> float:
    """Return a bubble's radius in m by the cost at its center; off the grid as if free.

    Follows `EBandPlanner::calcObstacleKinematicDistance`.

    Args:
        clearance: Costmap, and radii by cost.
        x: Center of the bubble in m in the frame of the costmap, as `y`.
        y: Center of the bubble in m.
    """
    costs, grid, radii = clearance
    cell = cell_at(grid, x, y)
    if is_on_grid(cell, costs.shape):
        return float(radii[costs[cell.row, cell.col]])
    return float(radii[0])


@kernel
def overlap(
    bubbles: Floats, index: int, second: Floats, second_index: int, share: float
) -> bool:
    """Return whether centers are nearer than `share` of the sum of both radii.

    Follows `EBandPlanner::checkOverlap`.

    Args:
        bubbles: Array with the first bubble; a view of its row would take longer.
        index: Row of the first bubble.
        second: Array with the second bubble.
        second_index: Row of the second bubble.
        share: Centers must be nearer than this share of the sum of radii.
    """
    dx = bubbles[index, X] - second[second_index, X]
    dy = bubbles[index, Y] - second[second_index, Y]
    limit: float = share * (bubbles[index, RADIUS] + second[second_index, RADIUS])
    return math.hypot(dx, dy) < limit


@kernel
def put(bubbles: Floats, index: int, x: float, y: float, r: float, yaw: float) -> None:
    """Write center, radius and yaw of a bubble to row `index` of an array.

    Args:
        bubbles: Array to write to.
        index: Row of the bubble.
        x: Center in m, as `y`.
        y: Center in m.
        r: Radius in m.
        yaw: Heading in rad.
    """
    bubbles[index, X] = x
    bubbles[index, Y] = y
    bubbles[index, RADIUS] = r
    bubbles[index, YAW] = yaw


@kernel
def copy(bubbles: Floats, index: int, second: Floats, second_index: int) -> None:
    """Copy row `second_index` of `second` to row `index` of `bubbles`.

    Numba's assignment of a row takes longer.

    Args:
        bubbles: Array to write to.
        index: Row to write to.
        second: Array to copy from.
        second_index: Row to copy from.
    """
    for column in range(4):
        bubbles[index, column] = second[second_index, column]


@kernel
def place(band: Floats, poses: Floats, gains: BandGains) -> None:
    """Write poses to a band's first rows, yaw 0 if headings do not count; radii stay.

    Args:
        band: Band to write to.
        poses: Poses (n, 3), x and y in m, yaw in rad.
        gains: They tell whether headings count.
    """
    for k in range(len(poses)):
        band[k, X] = poses[k, 0]
        band[k, Y] = poses[k, 1]
        band[k, YAW] = poses[k, 2] if gains.metres_per_rad > 0.0 else 0.0


@kernel
def wrap(angle: float) -> float:
    """Return an angle in rad wrapped to (-pi, pi], as ROS 1's package angles does."""
    # To the last bit what the division gives, which takes longer.
    if abs(angle) < _FULL_TURN:
        angle += _FULL_TURN if angle < 0.0 else 0.0
    else:
        angle %= _FULL_TURN
    return angle - _FULL_TURN if angle > math.pi else angle


@kernel
def measure(band: Floats, n: int, clearance: Clearance) -> int:
    """Recompute radii in place; return n, or IN_COLLISION and stop at a radius of 0.

    Args:
        band: Band to change.
        n: Its length.
        clearance: Radii by centers.

    Returns:
        The length, or IN_COLLISION if a radius is zero.
    """
    for i in range(n):
        band[i, RADIUS] = radius_at(clearance, band[i, X], band[i, Y])
        if band[i, RADIUS] <= 0.0:
            return IN_COLLISION
    return n


@kernel
def bridge(context: Context, first: int, last: int, count: int) -> int:
    """Link two nodes by new ones halfway until they overlap; return count or a code.

    Follows `EBandPlanner::fillGap` without its recursion.

    Args:
        context: Memory with the nodes, and what bubbles depend on.
        first: Node to start at.
        last: Node to reach.
        count: Number of nodes in use; new ones come after them.

    Returns:
        The new number of nodes, or a code of REASONS.
    """
    gains = context.gains
    nodes, links, _, ends = context.work
    # The stack holds what the bridge still has to reach, the nearest on top.
    depth = 1
    node = first
    ends[0] = last
    while depth > 0:
        end = ends[depth - 1]
        # The nearest end is reached: it becomes the node from which the next one is
        # sought.
        if overlap(nodes, node, nodes, end, gains.min_overlap):
            links[node, 1] = end
            links[end, 0] = node
            node = end
            depth -= 1
            continue

        if count >= len(nodes) or depth >= len(ends):
            return FULL
        # The original's recursion also goes halfway, left half first.
        x = 0.5 * (nodes[node, X] + nodes[end, X])
        y = 0.5 * (nodes[node, Y] + nodes[end, Y])
        radius = radius_at(context.clearance, x, y)
        if radius <= gains.tiny_bubble_m:
            return GAP
        turn = wrap(nodes[end, YAW] - nodes[node, YAW])
        put(nodes, count, x, y, radius, wrap(nodes[node, YAW] + 0.5 * turn))
        ends[depth] = count
        depth += 1
        count += 1

    return count


@kernel
def _drop_and_fill(context: Context, n: int) -> int:
    """Link the first n nodes so that neighbors overlap; return node count or a code.

    If the ends of an interval overlap, all between is dropped. Else it is halved, left
    half first, and its middle is dropped if its neighbors overlap. Neighbors that do
    not overlap are bridged.
    """
    nodes, links, stack, _ = context.work
    share = context.gains.min_overlap
    count = n
    depth = 1
    stack[0] = (0, n - 1, 0)
    while depth > 0:
        depth -= 1
        first, last, halves_done = stack[depth]
        middle = first + (last - first) // 2

        # An interval comes twice: before its halves and after them.
        if halves_done:
            before, after = links[middle]
            if overlap(nodes, before, nodes, after, share):
                links[before, 1] = after
                links[after, 0] = before
        elif overlap(nodes, first, nodes, last, share):
            links[first, 1] = last
            links[last, 0] = first
        elif last - first == 1:
            count = bridge(context, first, last, count)
            if count < 0:
                return count
        else:
            # The left half is on top, so that it is done first.
            stack[depth] = (first, last, 1)
            stack[depth + 1] = (middle, last, 0)
            stack[depth + 2] = (first, middle, 0)
            depth += 3

    return count


@kernel
def refine(band: Floats, n: int, context: Context) -> int:
    """Drop redundant bubbles, fill gaps; return count, or below 0, band unchanged.

    Follows `EBandPlanner::refineBand`.

    Args:
        band: Band to change; it stays as it is on failure.
        n: Its length.
        context: What bubbles depend on.

    Returns:
        The new length, or a code of REASONS.
    """
    if n < 2:
        return GAP

    nodes = context.work.nodes
    links = context.work.links
    # Nodes have no order but their links, so nothing moves while bubbles come and go.
    nodes[:n] = band[:n]
    count = _drop_and_fill(context, n)
    if count < 0:
        return count

    node = 0
    length = 0
    # From the first node along the links; dropped nodes are in no chain.
    while node != n - 1:
        copy(band, length, nodes, node)
        node = links[node, 1]
        length += 1
    copy(band, length, nodes, n - 1)
    return length + 1


@kernel
def _write_nodes(
    band: Floats, start: int, work: BandWork, node: int, count: int
) -> None:
    """Copy `count` linked nodes, from `node` on, into a band from row `start` on."""
    for k in range(start, start + count):
        copy(band, k, work.nodes, node)
        node = work.links[node, 1]


@kernel
def connect_front(band: Floats, n: int, pose: Pose, context: Context) -> int:
    """Begin a band at the robot: drop bubbles or fill a gap; return its length or code.

    If the robot overlaps none, the gap to the first bubble is filled. Follows the front
    half of `EBandPlanner::addFrames` (add_front).

    Args:
        band: Band to change.
        n: Its length.
        pose: Pose of the robot.
        context: What bubbles depend on.

    Returns:
        The new length, or a code of REASONS.
    """
    nodes = context.work.nodes
    radius = radius_at(context.clearance, pose.x, pose.y)
    put(nodes, 0, pose.x, pose.y, radius, pose.yaw)
    if radius <= 0.0:
        return IN_COLLISION

    # From the far end: the robot has passed all bubbles before the one that it finds.
    passed = n - 1
    while passed >= 0 and not overlap(
        nodes, 0, band, passed, context.gains.min_overlap
    ):
        passed -= 1
    count = 1
    if passed < 0:
        passed = 0
        nodes[1] = band[0]
        # All nodes but the second one, which stands for the band's first bubble.
        count = bridge(context, 0, 1, 2) - 1
        if count < 0:
            return count + 1

    length = n - passed + count
    if length > len(band):
        return FULL
    # Copied first, as both parts of the band may overlap.
    band[count:length] = band[passed:n].copy()
    _write_nodes(band, 0, context.work, 0, count)
    return length


@kernel
def append_back(band: Floats, n: int, poses: Floats, context: Context) -> int:
    """Append poses after an overlapping bubble or a filled gap; return length or code.

    If there is none, the gap from the last bubble is filled. Follows the back half of
    `EBandPlanner::addFrames` (add_back).

    Args:
        band: Band to change.
        n: Its length.
        poses: Poses (k, 3) to append, x and y in m, yaw in rad.
        context: What bubbles depend on.

    Returns:
        The new length, or a code of REASONS.
    """
    gains = context.gains
    nodes = context.work.nodes
    place(nodes[1:], poses[:1], gains)
    nodes[1, RADIUS] = radius_at(context.clearance, poses[0, 0], poses[0, 1])
    if nodes[1, RADIUS] <= 0.0:
        return IN_COLLISION

    end = -1
    for i in range(n - 1):
        if overlap(nodes, 1, band, i, gains.min_overlap):
            end = i + 1
            break

    if end < 0:
        # No bubble overlaps the new poses, so the band's last one has to be connected.
        nodes[0] = band[n - 1]
        count = bridge(context, 0, 1, 2)
        if count < 0:
            return count
        # All nodes between the two; the poses come in place of the second one.
        end = n + count - 2
        if end <= len(band):
            _write_nodes(band, n, context.work, context.work.links[0, 1], count - 2)

    if end + len(poses) > len(band):
        return FULL
    place(band[end:], poses, gains)
    length = measure(band[end:], len(poses), context.clearance)
    if length < 0:
        return length
    return end + length
