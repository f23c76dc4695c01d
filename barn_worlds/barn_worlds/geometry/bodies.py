"""Upright cylinders and boxes at poses, for whatever draws them or measures distances to them."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.moving.motion import Wall
from barn_worlds.moving.tracks import Tracks

_CORNERS = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])


class Bodies(NamedTuple):
    """Upright bodies in the map frame, metres and radians.

    poses (n, 3): x, y, yaw. radius_m (n,): of a cylinder, 0 for a box. size_m (n, 2): of a box along its own x and y, 0
    for a cylinder. height_m (n,).
    """

    poses: Floats
    radius_m: Floats
    size_m: Points
    height_m: Floats

    def move_to(self, places: Points) -> "Bodies":
        """Return them with their centres at places (n, 2), their headings kept."""
        return self._replace(poses=np.column_stack([places, self.poses[:, 2]]))

    def outlines(self, points: int = 40) -> list[Points]:
        """Return the outline of each from above, (k, 2) m; of a cylinder, so many points of its circle."""
        turns = np.linspace(0.0, 2.0 * math.pi, points)
        circle = np.stack([np.cos(turns), np.sin(turns)], axis=1)
        found = []
        for (x, y, yaw), radius, size in zip(
            self.poses.tolist(), self.radius_m, self.size_m, strict=True
        ):
            turned = np.array(
                [[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]]
            )
            found.append(
                (radius * circle if radius else (_CORNERS * size) @ turned) + (x, y)
            )
        return found

    def shapes(self) -> Floats:
        """Return them as the shapes (n, 7) of `geometry.kernels`."""
        return shape_rows(
            self.poses[:, :2], self.radius_m, self.size_m, self.poses[:, 2]
        )


def shape_rows(
    centres: Points, radius_m: Floats, size_m: Points, yaw_rad: Floats
) -> Floats:
    """Return shapes (n, 7) of centres (n, 2), radii (n,) of cylinders, sizes (n, 2) of boxes and headings (n,)."""
    sides = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
    return np.column_stack([centres, radius_m, 0.5 * size_m, sides])


def moving_bodies(tracks: Tracks, time_s: float) -> Bodies:
    """Return moving obstacles where they are at a time."""
    poses = np.column_stack([tracks.at(time_s)[0], tracks.yaw_rad])
    return Bodies(poses, tracks.radius_m, tracks.size_m, tracks.height_m)


def wall_bodies(walls: Sequence[Wall]) -> Bodies:
    """Return walls as bodies."""
    rows = [
        (one.x_m, one.y_m, one.yaw_rad, one.size_x_m, one.size_y_m, one.height_m)
        for one in walls
    ]
    table = np.array(rows, np.float64).reshape(-1, 6)
    return Bodies(table[:, :3], np.zeros(len(table)), table[:, 3:5], table[:, 5])
