"""A robot's body seen from above: a rectangle, a disc or a convex polygon, with its distances and times to contact."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.geometry import kernels


class Footprint:
    """A convex outline in base_link, in metres: a polygon, or a disc about base_link.

    corners_m: (k, 2), counter-clockwise; of a disc, a polygon around it to be drawn. radius_m: of a disc, else 0.
    extent_m: x_min, y_min, x_max, y_max.
    """

    def __init__(self, corners_m: Floats, radius_m: float = 0.0) -> None:
        self.corners_m, self.radius_m = corners_m, radius_m
        self._core = np.zeros((1, 2)) if radius_m else corners_m
        self._gaps: Callable[..., Floats] = kernels.gaps_to_polygon
        self._times: Callable[..., Floats] = kernels.times_to_polygon
        self._outline: tuple[Floats | float, ...] = self._core, radius_m
        self.extent_m = np.concatenate(
            [self._core.min(axis=0) - radius_m, self._core.max(axis=0) + radius_m]
        )

    def plain(self) -> dict[str, object]:
        """Return what a page draws it by: corners, radius, and how far its front is ahead of base_link."""
        front_m = float(self.extent_m[2])
        return {
            "corners": self.corners_m.tolist(),
            "radius": self.radius_m,
            "front": front_m,
        }

    def distances(self, x: Floats, y: Floats) -> Floats:
        """Return the distances in m of points in base_link from the outline; below zero inside, minus the depth."""
        if self.radius_m:
            return np.hypot(x, y) - self.radius_m
        found = np.empty(np.shape(x))
        kernels.polygon_gaps(x.ravel(), y.ravel(), self._core, found.reshape(-1))
        return found

    def gaps(self, shapes: Floats, x: float, y: float, yaw: float) -> Floats:
        """Return the distances (n,) in m from the robot at a pose to shapes (n, 7) of `geometry.kernels`, 0 inside."""
        return self._gaps(shapes, x, y, yaw, *self._outline)

    def times_to_contact(
        self,
        shapes: Floats,
        motions: Floats,
        x: float,
        y: float,
        yaw: float,
        speed: float,
    ) -> Floats:
        """Return when (n,) in s the robot meets shapes (n, 7) if all keep their velocities, inf for never.

        motions (n, 2): velocities of the shapes, m/s; the robot goes straight ahead at `speed`. A box counts as a disc.
        """
        return self._times(shapes, motions, x, y, yaw, speed, *self._outline)

    def nearest(self, x: float, y: float) -> Floats:
        """Return the point (2,) of the outline's inside or edge that is nearest to a point in base_link."""
        if self.radius_m:
            far = math.hypot(x, y)
            return np.array([x, y]) * (
                min(1.0, self.radius_m / far) if far > 0.0 else 1.0
            )
        if kernels.polygon_gap(x, y, self._core) <= 0.0:
            return np.array([x, y])
        starts, sides = self._core, np.roll(self._core, -1, axis=0) - self._core
        along = np.clip(
            ((np.array([x, y]) - starts) * sides).sum(axis=1) / (sides**2).sum(axis=1),
            0.0,
            1.0,
        )
        points = starts + along[:, None] * sides
        nearest: Floats = points[np.hypot(points[:, 0] - x, points[:, 1] - y).argmin()]
        return nearest


class Rectangle(Footprint):
    """A rectangle along x and y from x_min, y_min, x_max, y_max; the same in shorter times."""

    def __init__(self, extent_m: Sequence[float]) -> None:
        left, low, right, high = extent_m
        super().__init__(
            np.array([[left, low], [right, low], [right, high], [left, high]])
        )
        self._gaps, self._times, self._outline = (
            kernels.gaps_to_rectangle,
            kernels.times_to_rectangle,
            (self.extent_m,),
        )

    def distances(self, x: Floats, y: Floats) -> Floats:
        """Return the distances of points, see `Footprint`."""
        low, high = self.extent_m[:2], self.extent_m[2:]
        (middle_x, middle_y), (half_x, half_y) = 0.5 * (low + high), 0.5 * (high - low)
        beyond_x, beyond_y = (
            np.abs(x - middle_x) - half_x,
            np.abs(y - middle_y) - half_y,
        )
        outside = np.hypot(np.maximum(beyond_x, 0.0), np.maximum(beyond_y, 0.0))
        signed: Floats = outside + np.minimum(np.maximum(beyond_x, beyond_y), 0.0)
        return signed

    def nearest(self, x: float, y: float) -> Floats:
        """Return the nearest point, see `Footprint`."""
        return np.clip([x, y], self.extent_m[:2], self.extent_m[2:])
