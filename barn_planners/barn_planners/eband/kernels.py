"""Compiled loops of the elastic band: bubbles, refining, connecting. Those that move it are in `forces`.

A band is float64 (capacity, 4): x, y, radius in metres, yaw in rad; only the first n rows are used. A grid is (costs,
origin_x, origin_y, resolution, radii (256,) by cost). Functions return a new length or a negative code.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

IN_COLLISION = -1
GAP = -2
FULL = -3

REASONS = {
    IN_COLLISION: "a bubble of the band is in collision",
    GAP: "a gap of the band cannot be filled",
    FULL: "the band has too many bubbles",
}

X, Y, RADIUS, YAW = range(4)  # columns of a band
_TURN = 2.0 * math.pi
_STACK = 64  # no recursion: numba cannot cache it


class BandGains(NamedTuple):
    """Distance that a radian of heading counts as, and fields of `EBandConfig`."""

    metres_per_rad: float
    min_overlap: float
    tiny_bubble_m: float
    internal_gain: float
    external_gain: float
    overshoot: float
    significant_force: float
    halvings: int
    weighs_x_twice: bool


class BandWork(NamedTuple):
    """Work space for bands of one capacity."""

    nodes: npt.NDArray[np.float64]
    links: npt.NDArray[np.int64]
    stack: npt.NDArray[np.int64]
    ends: npt.NDArray[np.int64]


def band_work(capacity: int) -> BandWork:
    """Return work space for bands of up to `capacity` bubbles."""
    stacks = np.zeros((_STACK, 3), np.int64), np.zeros(_STACK, np.int64)
    return BandWork(np.zeros((capacity, 4)), np.zeros((capacity, 2), np.int64), *stacks)


@njit(cache=True, error_model="numpy")
def radius_at(grid, x, y):  # type: ignore[no-untyped-def]
    """Return the radius of a bubble at a point; off the grid, the radius for the lowest cost."""
    costs, origin_x, origin_y, resolution, radii = grid
    row = math.floor((y - origin_y) / resolution)
    col = math.floor((x - origin_x) / resolution)
    if 0 <= row < costs.shape[0] and 0 <= col < costs.shape[1]:
        return radii[costs[int(row), int(col)]]
    return radii[0]


@njit(cache=True)
def overlaps(bubbles, a, others, b, overlap):  # type: ignore[no-untyped-def]
    """Tell whether centres are nearer than `overlap` times the sum of radii; by indices, as views take longer."""
    dx, dy = bubbles[a, X] - others[b, X], bubbles[a, Y] - others[b, Y]
    return math.hypot(dx, dy) < overlap * (bubbles[a, RADIUS] + others[b, RADIUS])


@njit(cache=True)
def put(bubbles, a, others, b):  # type: ignore[no-untyped-def]
    """Copy another's bubble b to bubble a."""
    bubbles[a, X], bubbles[a, Y] = others[b, X], others[b, Y]
    bubbles[a, RADIUS], bubbles[a, YAW] = others[b, RADIUS], others[b, YAW]


@njit(cache=True)
def place(band, poses, gains):  # type: ignore[no-untyped-def]
    """Set centres and, where they count, headings of the first bubbles to poses (n, 3)."""
    for k in range(len(poses)):
        band[k, X], band[k, Y] = poses[k, 0], poses[k, 1]
        band[k, YAW] = poses[k, 2] if gains.metres_per_rad > 0.0 else 0.0


@njit(cache=True)
def wrapped(angle):  # type: ignore[no-untyped-def]
    """Return an angle in (-pi, pi]."""
    if (
        abs(angle) < _TURN
    ):  # to the last bit what the division gives, which takes longer
        angle += _TURN if angle < 0.0 else 0.0
    else:
        angle %= _TURN
    return angle - _TURN if angle > math.pi else angle


@njit(cache=True)
def measure(band, n, grid):  # type: ignore[no-untyped-def]
    """Set all radii from the grid; return n, or IN_COLLISION if one is zero."""
    for i in range(n):
        band[i, RADIUS] = radius_at(grid, band[i, X], band[i, Y])
        if band[i, RADIUS] <= 0.0:
            return IN_COLLISION
    return n


@njit(cache=True)
def bridge(work, first, last, used, grid, gains):  # type: ignore[no-untyped-def]
    """Link node `first` to `last` by new ones, numbered from `used`, until neighbours overlap; return their number."""
    nodes, links, ends = work.nodes, work.links, work.ends
    depth, here = 1, first
    ends[0] = last
    while depth > 0:
        end = ends[depth - 1]
        if overlaps(nodes, here, nodes, end, gains.min_overlap):
            links[here, 1] = end
            links[end, 0] = here
            here = end
            depth -= 1
            continue
        if used >= len(nodes) or depth >= len(ends):
            return FULL
        x, y = (
            0.5 * (nodes[here, X] + nodes[end, X]),
            0.5 * (nodes[here, Y] + nodes[end, Y]),
        )
        radius, yaw = radius_at(grid, x, y), nodes[here, YAW]
        if radius <= gains.tiny_bubble_m:
            return GAP
        nodes[used, X], nodes[used, Y], nodes[used, RADIUS] = x, y, radius
        nodes[used, YAW] = wrapped(yaw + 0.5 * wrapped(nodes[end, YAW] - yaw))
        ends[depth] = used
        depth += 1
        used += 1
    return used


@njit(cache=True)
def _drop_and_fill(work, n, grid, gains):  # type: ignore[no-untyped-def]
    """Refine nodes 0 .. n - 1 into linked ones; return how many are used.

    If the ends overlap, all between is dropped; else the interval is halved, left half first, and its middle is dropped
    if its neighbours overlap. Neighbours that do not overlap are bridged.
    """
    nodes, links, stack = work.nodes, work.links, work.stack
    used, depth = n, 1
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, n - 1, 0
    while depth > 0:
        depth -= 1
        first, last, halves_done = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        middle = first + (last - first) // 2
        if halves_done:
            before, after = links[middle, 0], links[middle, 1]
            if overlaps(nodes, before, nodes, after, gains.min_overlap):
                links[before, 1] = after
                links[after, 0] = before
        elif overlaps(nodes, first, nodes, last, gains.min_overlap):
            links[first, 1] = last
            links[last, 0] = first
        elif last - first == 1:
            used = bridge(work, first, last, used, grid, gains)
            if used < 0:
                return used
        else:
            stack[depth, 2] = 1
            stack[depth + 1, 0], stack[depth + 1, 1], stack[depth + 1, 2] = (
                middle,
                last,
                0,
            )
            stack[depth + 2, 0], stack[depth + 2, 1], stack[depth + 2, 2] = (
                first,
                middle,
                0,
            )
            depth += 3
    return used


@njit(cache=True)
def refine(band, n, grid, gains, work):  # type: ignore[no-untyped-def]
    """Drop redundant bubbles and fill gaps, in place; return the new length. On failure the band stays."""
    if n < 2:
        return GAP
    for k in range(n):
        put(work.nodes, k, band, k)
    used = _drop_and_fill(work, n, grid, gains)
    if used < 0:
        return used
    node, kept = 0, 0
    while node != n - 1:
        put(band, kept, work.nodes, node)
        node = work.links[node, 1]
        kept += 1
    put(band, kept, work.nodes, n - 1)
    return kept + 1


@njit(cache=True)
def _join(band, n, work, used, target):  # type: ignore[no-untyped-def]
    """Write node 0, the nodes linked after it and node 1 before or after a band; return its length."""
    between = used - 2
    if n + between + 1 > len(band):
        return FULL
    if target == 0:
        for k in range(n - 1, -1, -1):
            put(band, k + between + 1, band, k)
    node, place = (0, 0) if target == 0 else (work.links[0, 1], n)
    while node != 1:
        put(band, place, work.nodes, node)
        node = work.links[node, 1]
        place += 1
    if target != 0:
        put(band, place, work.nodes, 1)
    return n + between + 1


@njit(cache=True)
def connect_front(band, n, x, y, yaw, grid, gains, work):  # type: ignore[no-untyped-def]
    """Put a bubble at a pose before the last bubble that it overlaps, or bridge the gap to the first; return n."""
    nodes, radius = work.nodes, radius_at(grid, x, y)
    nodes[0, X], nodes[0, Y], nodes[0, RADIUS], nodes[0, YAW] = x, y, radius, yaw
    if radius <= 0.0:
        return IN_COLLISION
    for i in range(n - 1, -1, -1):
        if overlaps(nodes, 0, band, i, gains.min_overlap):
            kept = n - i
            if kept >= len(band):
                return FULL
            for k in range(1, kept + 1) if i > 0 else range(kept, 0, -1):
                put(band, k, band, i + k - 1)
            put(band, 0, nodes, 0)
            return kept + 1
    put(nodes, 1, band, 0)
    used = bridge(work, 0, 1, 2, grid, gains)
    return used if used < 0 else _join(band, n, work, used, 0)


@njit(cache=True)
def append_back(band, n, poses, grid, gains, work):  # type: ignore[no-untyped-def]
    """Append poses (k, 3) after the first bubble that overlaps them, or after a bridge from the end; return n."""
    nodes, radius = work.nodes, radius_at(grid, poses[0, 0], poses[0, 1])
    place(nodes[1:], poses[:1], gains)
    nodes[1, RADIUS] = radius
    end = -1
    for i in range(n - 1):
        if overlaps(nodes, 1, band, i, gains.min_overlap):
            end = i + 1
            break
    if radius <= 0.0:
        return IN_COLLISION
    if end < 0:
        put(nodes, 0, band, n - 1)
        used = bridge(work, 0, 1, 2, grid, gains)
        n = used if used < 0 else _join(band, n, work, used, 1)
        if n < 0:
            return n
        end = n - 1
    if end + len(poses) > len(band):
        return FULL
    place(band[end:], poses, gains)
    added = measure(band[end:], len(poses), grid)
    return added if added < 0 else end + added
