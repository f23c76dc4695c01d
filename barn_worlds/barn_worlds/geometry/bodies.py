"""Upright cylinders and boxes at poses, to be drawn or measured."""

import math
from collections.abc import Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from barn_worlds.base.arrays import Floats, Points, unit_vectors
from barn_worlds.base.types import Pose2D
from barn_worlds.moving.motion import Wall
from barn_worlds.moving.tracks import Tracks

# Of the outline of a cylinder, the last of which is the first again.
_CIRCLE_POINTS = 40
_UNIT_SQUARE = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])


class Bodies(NamedTuple):
    """Upright bodies in the map frame, in meters and radians."""

    # (n, 3): x, y, yaw.
    poses: Floats
    # (n,) of cylinders, 0 for a box.
    radius_m: Floats
    # (n, 2) of boxes along their own x and y, 0 for a cylinder.
    size_m: Points
    # (n,)
    height_m: Floats

    def move_to(self, centers_m: Points) -> "Bodies":
        """Return a copy of the bodies with other centers x, y (n, 2); headings stay."""
        return self._replace(poses=np.column_stack([centers_m, self.poses[:, 2]]))

    def outlines(self) -> list[Points]:
        """Return each body's outline x, y (k, 2) in m, map frame, seen from above."""
        circle = unit_vectors(np.linspace(0.0, 2.0 * math.pi, _CIRCLE_POINTS))
        outlines = []
        for pose, radius, size in zip(
            self.poses.tolist(), self.radius_m, self.size_m, strict=True
        ):
            if radius:
                outlines.append(radius * circle + pose[:2])
            else:
                outlines.append(Pose2D(*pose).transform(_UNIT_SQUARE * size))
        return outlines

    def shapes(self) -> Floats:
        """Return the bodies as rows (n, 7), the shapes of `geometry.kernels`."""
        return shape_rows(
            self.poses[:, :2], self.radius_m, self.size_m, self.poses[:, 2]
        )


def shape_rows(
    centers_m: Points, radius_m: Floats, size_m: Points, yaw_rad: Floats
) -> Floats:
    """Return rows (n, 7), the shapes of `geometry.kernels`, from columns of numbers.

    Args:
        centers_m: x and y (n, 2) in the map frame.
        radius_m: (n,) of cylinders, 0 for a box.
        size_m: (n, 2) of boxes along their own x and y, 0 for a cylinder.
        yaw_rad: Headings (n,).
    """
    headings = unit_vectors(yaw_rad)
    return np.column_stack([centers_m, radius_m, 0.5 * size_m, headings])


def moving_bodies(tracks: Tracks, time_s: float) -> Bodies:
    """Return the moving obstacles as bodies, where they are at `time_s`.

    Args:
        tracks: The motions of the obstacles.
        time_s: Time for which they are placed.
    """
    positions, _ = tracks.at(time_s)
    poses = np.column_stack([positions, tracks.yaw_rad])
    return Bodies(poses, tracks.radius_m, tracks.size_m, tracks.height_m)


def wall_bodies(walls: Sequence[Wall]) -> Bodies:
    """Return straight walls as boxes, one body each; no walls make no bodies."""
    numbers = attrgetter("x_m", "y_m", "yaw_rad", "size_x_m", "size_y_m", "height_m")
    table = np.array(list(map(numbers, walls)), np.float64).reshape(-1, 6)
    return Bodies(table[:, :3], np.zeros(len(table)), table[:, 3:5], table[:, 5])
