"""What of a robot can touch, seen from above: a rectangle, a disc or a convex polygon, and its distances."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numba import njit

from barn_sim.body.model import jackal
from barn_sim.config import JACKAL
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import from_dict
from barn_worlds.robots.robot import Chassis


@dataclass(frozen=True, eq=False)
class Outline:
    """A convex outline in base_link, in metres.

    corners_m: (k, 2), counter-clockwise; of a disc, a polygon around it to be drawn. radius_m: of a disc about
    base_link, 0 for anything else.
    """

    corners_m: Floats
    radius_m: float = 0.0

    @cached_property
    def extent_m(self) -> Floats:
        """x_min, y_min, x_max, y_max."""
        if self.radius_m:
            return np.array([-self.radius_m, -self.radius_m, self.radius_m, self.radius_m])
        return np.concatenate([self.corners_m.min(axis=0), self.corners_m.max(axis=0)])

    @cached_property
    def rectangle(self) -> bool:
        """Whether it is a rectangle along x and y."""
        sides = [set(column) for column in self.corners_m.T.tolist()]
        return not self.radius_m and len(self.corners_m) == 4 and all(len(side) == 2 for side in sides)

    def plain(self) -> dict[str, Any]:
        """Return what a page draws it by: corners, radius, and how far its front is ahead of base_link."""
        front_m = float(self.extent_m[2])
        return {"corners": self.corners_m.tolist(), "radius": self.radius_m, "front": front_m}

    def distances(self, x: Floats, y: Floats) -> Floats:
        """Return the distances in m of points from the outline; below zero inside, minus the depth."""
        if self.radius_m:
            return np.hypot(x, y) - self.radius_m
        if self.rectangle:
            return _from_rectangle(x, y, self.extent_m)
        found = np.empty(np.shape(x))
        _from_polygon(x.ravel(), y.ravel(), self.corners_m, found.reshape(-1))
        return found

    def gaps(self, shapes: Floats, x: float, y: float, yaw: float) -> Floats:
        """Return the distances (n,) in m from the robot at a pose to shapes (n, 7) of `body.shapes`, 0 inside."""
        from barn_sim.body.shapes import shape_gaps  # noqa: PLC0415 (compiled kernels)

        if self.rectangle:
            return shape_gaps(shapes, x, y, yaw, self.extent_m)
        corners = np.zeros((1, 2)) if self.radius_m else self.corners_m
        return _gaps(shapes, x, y, yaw, corners, self.radius_m)

    def times_to_contact(
        self, shapes: Floats, velocities: Floats, x: float, y: float, yaw: float, speed: float
    ) -> Floats:
        """Return when (n,) in s the robot meets shapes (n, 7) if all keep their velocities, inf for never.

        velocities (n, 2): of the shapes, m/s; the robot goes straight ahead at `speed`. A box counts as the disc around
        it.
        """
        from barn_sim.body.shapes import times_to_contact  # noqa: PLC0415 (compiled kernels)

        if self.rectangle:
            return times_to_contact(shapes, velocities, x, y, yaw, speed, self.extent_m)
        corners = np.zeros((1, 2)) if self.radius_m else self.corners_m
        return _times(shapes, velocities, x, y, yaw, speed, corners, self.radius_m)

    def nearest(self, x: float, y: float) -> Floats:
        """Return the point (2,) of the outline's inside or edge that is nearest to a point."""
        if self.radius_m:
            far = math.hypot(x, y)
            return np.array([x, y]) * (min(1.0, self.radius_m / far) if far > 0.0 else 1.0)
        if self.rectangle or _signed(x, y, self.corners_m) <= 0.0:
            return np.clip([x, y], self.extent_m[:2], self.extent_m[2:])
        starts, sides = self.corners_m, np.roll(self.corners_m, -1, axis=0) - self.corners_m
        along = np.clip(((np.array([x, y]) - starts) * sides).sum(axis=1) / (sides**2).sum(axis=1), 0.0, 1.0)
        points = starts + along[:, None] * sides
        nearest: Floats = points[np.hypot(points[:, 0] - x, points[:, 1] - y).argmin()]
        return nearest


def rectangle(extent_m: Iterable[float]) -> Outline:
    """Return the outline from x_min, y_min, x_max, y_max."""
    left, low, right, high = extent_m
    return Outline(np.array([[left, low], [right, low], [right, high], [left, high]]))


@cache
def outline_of(chassis: Chassis = JACKAL.chassis) -> Outline:
    """Return what can touch of a robot: of the Jackal its collision shapes, of others the hull of the footprint."""
    if chassis == JACKAL.chassis:
        return rectangle(jackal().extent())
    return Outline(np.array(chassis.hull_m), chassis.footprint_radius_m)


def chassis_in(simulator: Any) -> Chassis:
    """Return the robot of a simulator's configuration as plain data: the Jackal where it names none.

    Raises ConfigError for one that is not allowed.
    """
    given = simulator.get("chassis") if isinstance(simulator, Mapping) else None
    return JACKAL.chassis if given is None else from_dict(Chassis, given, "simulator.chassis")


def _from_rectangle(x: Floats, y: Floats, extent_m: Floats) -> Floats:
    middle_x, middle_y = 0.5 * (extent_m[:2] + extent_m[2:])
    half_x, half_y = 0.5 * (extent_m[2:] - extent_m[:2])
    beyond_x, beyond_y = np.abs(x - middle_x) - half_x, np.abs(y - middle_y) - half_y
    outside = np.hypot(np.maximum(beyond_x, 0.0), np.maximum(beyond_y, 0.0))
    signed: Floats = outside + np.minimum(np.maximum(beyond_x, beyond_y), 0.0)
    return signed


@njit(cache=True)
def _signed(x: float, y: float, corners: Floats) -> float:
    """Return the distance of a point from a convex polygon, below zero inside; from its only corner if it has one."""
    count = len(corners)
    if count == 1:
        return math.hypot(x - corners[0, 0], y - corners[0, 1])
    nearest, deepest = math.inf, -math.inf
    for k in range(count):
        ax, ay = corners[k, 0], corners[k, 1]
        sx, sy = corners[(k + 1) % count, 0] - ax, corners[(k + 1) % count, 1] - ay
        square = sx * sx + sy * sy
        dx, dy = x - ax, y - ay
        deepest = max(deepest, (dx * sy - dy * sx) / math.sqrt(square))
        along = min(max((dx * sx + dy * sy) / square, 0.0), 1.0)
        nearest = min(nearest, math.hypot(dx - along * sx, dy - along * sy))
    return nearest if deepest > 0.0 else deepest


@njit(cache=True)
def _from_polygon(x: Floats, y: Floats, corners: Floats, found: Floats) -> None:
    for i in range(len(x)):
        found[i] = _signed(x[i], y[i], corners)


@njit(cache=True)
def _gaps(shapes: Floats, x: float, y: float, yaw: float, corners: Floats, radius: float) -> Floats:
    """Return distances as `Outline.gaps`; corners, radius: those of a polygon and 0, or middle and radius of a disc."""
    gaps = np.empty(len(shapes))
    box = np.empty((4, 2))
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(len(shapes)):
        dx, dy = shapes[i, 0] - x, shapes[i, 1] - y
        ahead, left = c * dx + s * dy, c * dy - s * dx
        if shapes[i, 2] > 0.0:
            gaps[i] = max(0.0, _signed(ahead, left, corners) - radius - shapes[i, 2])
            continue
        ux, uy = c * shapes[i, 5] + s * shapes[i, 6], c * shapes[i, 6] - s * shapes[i, 5]
        for k in range(4):
            i_long = shapes[i, 3] if k in (0, 3) else -shapes[i, 3]
            i_wide = shapes[i, 4] if k in (0, 1) else -shapes[i, 4]
            box[k, 0], box[k, 1] = ahead + i_long * ux - i_wide * uy, left + i_long * uy + i_wide * ux
        gaps[i] = max(0.0, _apart(corners, box) - radius)
    return gaps


@njit(cache=True)
def _apart(a: Floats, b: Floats) -> float:
    """Return the distance of two convex polygons, 0 where they overlap; one may be a point."""
    if not (_separated(a, b) or _separated(b, a)):
        return 0.0
    nearest = math.inf
    for k in range(len(a)):
        nearest = min(nearest, max(_signed(a[k, 0], a[k, 1], b), 0.0))
    for k in range(len(b)):
        nearest = min(nearest, max(_signed(b[k, 0], b[k, 1], a), 0.0))
    return nearest


@njit(cache=True)
def _separated(a: Floats, b: Floats) -> bool:
    """Tell whether all of b lies beyond one side of a."""
    count = len(a)
    if count < 2:
        return False
    for k in range(count):
        sx, sy = a[(k + 1) % count, 0] - a[k, 0], a[(k + 1) % count, 1] - a[k, 1]
        least = math.inf
        for j in range(len(b)):
            least = min(least, (b[j, 0] - a[k, 0]) * sy - (b[j, 1] - a[k, 1]) * sx)
        if least > 0.0:
            return True
    return False


@njit(cache=True)
def _times(
    shapes: Floats, velocities: Floats, x: float, y: float, yaw: float, speed: float, corners: Floats, radius: float
) -> Floats:
    """Return times as `Outline.times_to_contact`; corners, radius as for `_gaps`."""
    times = np.empty(len(shapes))
    c, s = math.cos(yaw), math.sin(yaw)
    count = len(corners)
    for i in range(len(shapes)):
        reach = radius + (shapes[i, 2] if shapes[i, 2] > 0.0 else math.hypot(shapes[i, 3], shapes[i, 4]))
        dx, dy = shapes[i, 0] - x, shapes[i, 1] - y
        px, py = c * dx + s * dy, c * dy - s * dx
        vx = c * velocities[i, 0] + s * velocities[i, 1] - speed
        vy = c * velocities[i, 1] - s * velocities[i, 0]
        if _signed(px, py, corners) <= reach:
            times[i] = 0.0
            continue
        first, square = math.inf, vx * vx + vy * vy
        for k in range(count):
            # the disc's centre meets the outline widened by its radius: a disc at each corner, and each side moved out
            qx, qy = px - corners[k, 0], py - corners[k, 1]
            along = qx * vx + qy * vy
            root = along * along - square * (qx * qx + qy * qy - reach * reach)
            if root >= 0.0 and along < 0.0:
                first = min(first, (-along - math.sqrt(root)) / square)
            if count == 1:
                continue
            sx, sy = corners[(k + 1) % count, 0] - corners[k, 0], corners[(k + 1) % count, 1] - corners[k, 1]
            length = math.hypot(sx, sy)
            outward, closing = (qx * sy - qy * sx) / length - reach, (vx * sy - vy * sx) / length
            if closing < 0.0 <= outward:
                after = -outward / closing
                where = ((qx + after * vx) * sx + (qy + after * vy) * sy) / length
                if 0.0 <= where <= length:
                    first = min(first, after)
        times[i] = first
    return times
