"""Draws the scene of a trial from above onto axes in meters.

It shows static and moving obstacles and the robot's trail.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.patches import Circle

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing.palette import CONTACT, FAINT, GOAL, INK, MOVER, OBSTACLE, WALL
from barn_worlds.moving.tracks import Tracks, jumps
from barn_worlds.worlds.scene import TrialScene

START_MARK: dict[str, Any] = {
    "color": INK,
    "linestyle": "",
    "marker": "o",
    "markersize": 8,
    "markeredgewidth": 2,
    "fillstyle": "none",
}
"""Look of a start: a ring, since planners have filled marks."""

# The scale of speeds reaches at least this far.
_LOWEST_TOP_MPS = 0.5


def draw_discs(axes: Axes, centers_m: Points, radius_m: float, **style: Any) -> None:
    """Draw discs of one radius at centers (n, 2) onto axes in meters.

    Args:
        axes: Axes in meters.
        centers_m: Centers (n, 2).
        radius_m: Radius of all discs.
        style: Properties of matplotlib's collection.
    """
    sizes = np.full(len(centers_m), 2.0 * radius_m)
    discs = EllipseCollection(
        sizes,
        sizes,
        np.zeros(len(sizes)),
        units="xy",
        offsets=centers_m,
        offset_transform=axes.transData,
        **style,
    )
    axes.add_collection(discs)


def draw_scene(axes: Axes, scene: TrialScene, *, faint: bool = False) -> None:
    """Draw cylinders, straight walls, path, start and goal of a scene onto axes.

    Args:
        axes: Axes in meters.
        scene: Cylinders, boxes, path, start and goal to draw.
        faint: Draw everything but start and goal in one light color, for maps that
            focus on trajectories. The circle of arrival is left out.
    """
    if len(scene.boxes.poses):
        axes.add_collection(PolyCollection(scene.boxes.outlines(), facecolor=WALL))
    wall_color = FAINT if faint else WALL
    obstacle_color = FAINT if faint else OBSTACLE
    draw_discs(axes, scene.walls_m, scene.radius_m, facecolor=wall_color)
    draw_discs(axes, scene.obstacles_m, scene.radius_m, facecolor=obstacle_color)

    path_style: dict[str, Any] = {"color": WALL, "linestyle": ":", "linewidth": 1.0}
    end_style: dict[str, Any] = {}
    if faint:
        path_style = {"color": FAINT, "linestyle": "--", "linewidth": 1.4}
        # Above the trajectories.
        end_style = {"zorder": 6}
    axes.plot(*scene.path_m.T, **path_style)

    if scene.start is not None:
        axes.plot(*scene.start.position, label="start", **START_MARK, **end_style)
    if scene.goal is not None:
        goal = scene.goal.position
        end_style |= {"color": GOAL, "markersize": 13, "label": "goal"}
        axes.plot(*goal, "*", **end_style)
        if not faint:
            circle = Circle(
                goal,
                scene.goal_distance_m,
                fill=False,
                color=GOAL,
                linewidth=1.0,
                linestyle=":",
            )
            axes.add_patch(circle)


def draw_outlines(
    axes: Axes, poses: Floats, corners_m: Points, color: str = INK, **style: Any
) -> PolyCollection:
    """Draw a robot's outline at n poses and return it as one collection.

    Args:
        axes: Axes in meters.
        poses: x, y and yaw (n, 3).
        corners_m: Corners (k, 2) of the outline in base_link.
        color: Color of the line.
        style: Properties of matplotlib's collection.
    """
    corners = [Pose2D(*pose).transform(corners_m) for pose in poses.tolist()]
    outlines = PolyCollection(corners, facecolor="none", edgecolor=color, **style)
    axes.add_collection(outlines)
    return outlines


def draw_trail(
    axes: Axes, points_m: Points, speeds_mps: Floats | None = None, color: str = ""
) -> LineCollection:
    """Draw a robot's positions as a line, colored by speed if known, and return it.

    Args:
        axes: Axes in meters.
        points_m: Positions (n, 2).
        speeds_mps: Speeds (n,) that color the trail. It then has a dark edge.
        color: Color of a trail without speeds.
    """
    style: dict[str, Any] = {"colors": color}
    if speeds_mps is not None:
        style = {"cmap": "viridis"}
        # Bright colors are visible on a dark edge.
        axes.plot(*points_m.T, color=INK, linewidth=2.8, zorder=2.9)

    # One piece per pair of samples, so that each can have its own color.
    trail = LineCollection(
        list(np.stack([points_m[:-1], points_m[1:]], axis=1)),
        linewidths=1.8,
        alpha=0.85,
        zorder=3,
        capstyle="round",
        **style,
    )
    if speeds_mps is not None:
        # The speed at the end of a piece; driving backwards counts as fast.
        trail.set_array(np.abs(speeds_mps[1:]))
    axes.add_collection(trail)
    return trail


def draw_contacts(axes: Axes, points_m: Points) -> None:
    """Draw a cross at each position where a robot touched something.

    Args:
        axes: Axes in meters.
        points_m: Positions (n, 2) of the robot.
    """
    axes.plot(
        *points_m.T,
        "x",
        color=CONTACT,
        markersize=8,
        markeredgewidth=2.0,
        zorder=5,
        label="",
    )


def scale_speeds(axes: Axes, trails: Sequence[LineCollection]) -> None:
    """Set one color scale from 0 m/s for all trails colored by speed; add a color bar.

    Args:
        axes: Axes of the trails.
        trails: The trails, at least one.
    """
    fastest_mps = _LOWEST_TOP_MPS
    for trail in trails:
        speeds_mps = np.asarray(trail.get_array())
        fastest_mps = max(fastest_mps, float(np.nanmax(speeds_mps, initial=0.0)))
    for trail in trails:
        trail.set_clim(0.0, fastest_mps)
    axes.figure.colorbar(
        trails[-1], ax=axes, label="speed [m/s]", fraction=0.05, pad=0.02
    )


def motion_paths(tracks: Tracks, times_s: Floats) -> list[Points]:
    """Return motions as pieces x, y (k, 2) in m, split at jumps; none below two times.

    Args:
        tracks: The motions.
        times_s: Times at equal steps.

    Returns:
        Pieces (k, 2) of at least two points.
    """
    if len(times_s) < 2:
        return []
    positions, velocities = tracks.over(times_s)
    is_jump = jumps(positions, velocities, float(times_s[1] - times_s[0]))
    pieces: list[Points] = []
    for k in range(len(tracks)):
        # A piece ends at the sample before a jump.
        ends = np.flatnonzero(is_jump[:, k]) + 1
        pieces += np.split(positions[:, k], ends)
    return [piece for piece in pieces if len(piece) > 1]


def draw_motion_paths(axes: Axes, pieces: Sequence[Points], **style: Any) -> None:
    """Draw the pieces of `motion_paths` as thin lines of one color.

    Args:
        axes: Axes in meters.
        pieces: Pieces from `motion_paths`.
        style: Properties of matplotlib's collection.
    """
    axes.add_collection(
        LineCollection(list(pieces), colors=MOVER, linewidths=0.8, **style)
    )


def draw_arrow(
    axes: Axes, position: Floats, direction: Floats, **style: object
) -> None:
    """Draw an arrowhead at a position; draw nothing if the direction has no length.

    Args:
        axes: Axes in meters.
        position: Position (2,).
        direction: Direction (2,) that it points in; its length does not matter.
        style: Properties of matplotlib's patch.
    """
    length = math.hypot(*direction)
    if length <= 1e-6:
        return
    # Only the head is visible, because it is longer than the shaft of 1 cm.
    tip = position + direction / length * 0.01
    arrow = {"arrowstyle": "-|>", "color": MOVER, "shrinkA": 0.0, "shrinkB": 0.0}
    axes.annotate("", tuple(tip), tuple(position), arrowprops=arrow | style)
