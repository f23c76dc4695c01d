"""A robot's body seen from above, with its distances and times to contact."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.geometry import kernels


class Footprint:
    """A convex outline in base_link, in meters: a polygon, or a disc about it."""

    # (k, 2), counterclockwise; of a disc, a polygon around it to be drawn.
    corners_m: Floats
    # Of a disc, else 0.
    radius_m: float
    # x_min, y_min, x_max, y_max.
    extent_m: Floats

    def __init__(self, corners_m: Floats, radius_m: float = 0.0):
        """Take corners (k, 2) in base_link in m and, of a disc about it, the radius.

        Args:
            corners_m: (k, 2), counterclockwise.
            radius_m: Radius of a disc; 0 for a polygon.
        """
        self.corners_m = corners_m
        self.radius_m = radius_m
        # A disc is its center, widened by the radius.
        self._core = np.zeros((1, 2)) if radius_m else corners_m
        self.extent_m = np.concatenate(
            [self._core.min(axis=0) - radius_m, self._core.max(axis=0) + radius_m]
        )
        # `Rectangle` replaces all three; `_outline` is what the kernels take last.
        self._gaps: Callable[..., Floats] = kernels.gaps_to_polygon
        self._times: Callable[..., Floats] = kernels.times_to_polygon
        self._outline: tuple[Floats | float, ...] = (self._core, radius_m)

    def plain(self) -> dict[str, object]:
        """Return corners (k, 2), radius and x of the front in m, ready for JSON."""
        return {
            "corners": self.corners_m.tolist(),
            "radius": self.radius_m,
            "front": float(self.extent_m[2]),
        }

    def distances(self, x: Floats, y: Floats) -> Floats:
        """Return signed distances in m of points from the outline, negative inside.

        Args:
            x: Positions ahead of base_link.
            y: Positions to its left, of the same shape.

        Returns:
            An array of that shape; inside the outline, minus the depth.
        """
        if self.radius_m:
            return np.hypot(x, y) - self.radius_m
        distances = np.empty(np.shape(x))
        kernels.polygon_gaps(x.ravel(), y.ravel(), self._core, distances.reshape(-1))
        return distances

    def gaps(self, shapes: Floats, x: float, y: float, yaw: float) -> Floats:
        """Return distances (n,) in m from the robot at a pose to shapes, 0 for overlap.

        Args:
            shapes: (n, 7), see `geometry.kernels`.
            x: Position of the robot in the map frame.
            y: Position of the robot in the map frame.
            yaw: Heading of the robot.
        """
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
        """Return times (n,) in s until the robot meets shapes' discs, inf for never.

        All keep their velocities.

        Args:
            shapes: (n, 7), see `geometry.kernels`. A box counts as the disc around it.
            motions: Velocities (n, 2) of the shapes in m/s.
            x: Position of the robot in the map frame.
            y: Position of the robot in the map frame.
            yaw: Heading of the robot.
            speed: Speed of the robot in m/s, straight ahead.

        Returns:
            Times (n,) in s, inf for never.
        """
        return self._times(shapes, motions, x, y, yaw, speed, *self._outline)

    def nearest(self, x: float, y: float) -> Floats:
        """Return the footprint's point (2,) nearest to a point, itself if inside.

        Args:
            x: Position ahead of base_link.
            y: Position to its left.
        """
        point = np.array([x, y])
        if self.radius_m:
            distance = math.hypot(x, y)
            if distance == 0.0:
                return point
            return point * min(1.0, self.radius_m / distance)
        if kernels.polygon_gap(x, y, self._core) <= 0.0:
            return point

        starts = self._core
        sides = np.roll(self._core, -1, axis=0) - starts
        # The nearest point of each side, then the nearest of these.
        shares = ((point - starts) * sides).sum(axis=1) / (sides**2).sum(axis=1)
        shares = np.clip(shares, 0.0, 1.0)
        points = starts + shares[:, None] * sides
        distances = np.hypot(*(points - point).T)
        nearest: Floats = points[distances.argmin()]
        return nearest


class Rectangle(Footprint):
    """A rectangle along x and y: a polygon with faster kernels."""

    def __init__(self, extent_m: Sequence[float]):
        """Take x_min, y_min, x_max and y_max in m, in base_link."""
        left, low, right, high = extent_m
        super().__init__(
            np.array([[left, low], [right, low], [right, high], [left, high]])
        )
        self._gaps = kernels.gaps_to_rectangle
        self._times = kernels.times_to_rectangle
        self._outline = (self.extent_m,)

    def distances(self, x: Floats, y: Floats) -> Floats:
        """Return signed distances in m of points from the outline, negative inside.

        Args:
            x: Positions ahead of base_link.
            y: Positions to its left, of the same shape.
        """
        low = self.extent_m[:2]
        high = self.extent_m[2:]
        center_x, center_y = 0.5 * (low + high)
        half_x, half_y = 0.5 * (high - low)
        beyond_x = np.abs(x - center_x) - half_x
        beyond_y = np.abs(y - center_y) - half_y
        outside = np.hypot(np.maximum(beyond_x, 0.0), np.maximum(beyond_y, 0.0))
        # One of both is 0.
        distances: Floats = outside + np.minimum(np.maximum(beyond_x, beyond_y), 0.0)
        return distances

    def nearest(self, x: float, y: float) -> Floats:
        """Return the rectangle's point (2,) nearest to a point, itself if inside.

        Args:
            x: Position ahead of base_link.
            y: Position to its left.
        """
        return np.clip([x, y], self.extent_m[:2], self.extent_m[2:])
