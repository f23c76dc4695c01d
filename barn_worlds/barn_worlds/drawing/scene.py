"""The scene of a trial from above, drawn onto axes in metres: what stands, what moves, where the robot went."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.patches import Circle

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing.palette import (
    CONTACT,
    FAINT,
    GOAL,
    INK,
    MOVER,
    OBSTACLE,
    START,
    WALL,
)
from barn_worlds.moving.tracks import Tracks, jumps
from barn_worlds.worlds.scene import TrialScene

_LEAST_TOP_MPS = 0.5  # of the scale of speeds


def draw_discs(
    axes: Axes, centres_m: npt.NDArray[np.floating], radii_m: npt.ArrayLike, **look: Any
) -> EllipseCollection:
    """Draw discs around centres (n, 2); radii_m: one for all, or (n,)."""
    sizes = np.broadcast_to(2.0 * np.asarray(radii_m), len(centres_m))
    where: Any = {
        "units": "xy",
        "offsets": centres_m,
        "offset_transform": axes.transData,
    }
    ellipses = EllipseCollection(sizes, sizes, np.zeros(len(sizes)), **where, **look)
    axes.add_collection(ellipses)
    return ellipses


def circle_outlines(centres_m: Points, radii_m: npt.ArrayLike) -> list[Points]:
    """Return the outlines (k, 2) of discs around centres (n, 2); radii_m: one for all, or (n,)."""
    turns = np.linspace(0.0, 2.0 * math.pi, 41)
    around = np.column_stack([np.cos(turns), np.sin(turns)])
    radii = np.broadcast_to(np.asarray(radii_m, np.float64), len(centres_m))
    return list(centres_m[:, None] + radii[:, None, None] * around)


def draw_scene(axes: Axes, scene: TrialScene, *, faint: bool = False) -> None:
    """Draw obstacles, walls and path of a world, with start, goal and how near to it counts as arrival.

    faint: all but start and goal in one light colour, for maps on which trajectories are what counts.
    """
    if len(scene.boxes.poses):
        axes.add_collection(PolyCollection(scene.boxes.outlines(), facecolor=WALL))
    draw_discs(axes, scene.walls_m, scene.radius_m, facecolor=FAINT if faint else WALL)
    draw_discs(
        axes, scene.obstacles_m, scene.radius_m, facecolor=FAINT if faint else OBSTACLE
    )
    look: dict[str, Any] = {"color": FAINT, "linestyle": "--", "linewidth": 1.4}
    axes.plot(
        *scene.path_m.T,
        **look if faint else {"color": WALL, "linestyle": ":", "linewidth": 1.0},
    )
    above: dict[str, Any] = {"zorder": 6} if faint else {}
    if scene.start is not None:
        axes.plot(
            scene.start.x,
            scene.start.y,
            "o",
            color=START,
            markersize=7,
            label="start",
            **above,
        )
    if scene.goal is not None:
        middle = (scene.goal.x, scene.goal.y)
        axes.plot(*middle, "*", color=GOAL, markersize=13, label="goal", **above)
        if not faint:
            circle: dict[str, Any] = {
                "fill": False,
                "color": GOAL,
                "linewidth": 1.0,
                "linestyle": ":",
            }
            axes.add_patch(Circle(middle, scene.goal_distance_m, **circle))


def draw_outlines(
    axes: Axes, poses: Floats, corners_m: Points, colour: str = INK, **look: Any
) -> PolyCollection:
    """Draw a robot's outline, given by its corners (k, 2), at poses (n, 3)."""
    outlines = [Pose2D(*pose).transform(corners_m) for pose in poses.tolist()]
    shown = PolyCollection(outlines, facecolor="none", edgecolor=colour, **look)
    axes.add_collection(shown)
    return shown


def draw_trail(
    axes: Axes, points_m: Points, speeds_mps: Floats | None = None, colour: str = ""
) -> LineCollection:
    """Draw where a robot went, (n, 2), in one colour, or coloured by its speeds (n,) with a dark edge."""
    look: dict[str, Any] = (
        {"colors": colour} if speeds_mps is None else {"cmap": "viridis"}
    )
    segments = list(np.stack([points_m[:-1], points_m[1:]], axis=1))
    trail = LineCollection(
        segments, linewidths=1.8, alpha=0.85, zorder=3, capstyle="round", **look
    )
    if speeds_mps is not None:
        trail.set_array(np.abs(speeds_mps[1:]))
        axes.plot(
            *points_m.T, color=INK, linewidth=2.8, zorder=2.9
        )  # on which bright colours are seen
    axes.add_collection(trail)
    return trail


def draw_contacts(axes: Axes, points_m: Points, label: str = "") -> None:
    """Draw where a robot touched something, (n, 2)."""
    axes.plot(
        *points_m.T,
        "x",
        color=CONTACT,
        markersize=8,
        markeredgewidth=2.0,
        zorder=5,
        label=label,
    )


def scale_speeds(axes: Axes, trails: Sequence[LineCollection]) -> None:
    """Give trails that are coloured by speed one scale, from 0, with a bar of colours."""
    arrays = [np.asarray(trail.get_array()) for trail in trails]
    fastest = max(
        _LEAST_TOP_MPS, *(float(np.nanmax(one, initial=0.0)) for one in arrays)
    )
    for trail in trails:
        trail.set_clim(0.0, fastest)
    axes.figure.colorbar(
        trails[-1], ax=axes, label="speed [m/s]", fraction=0.05, pad=0.02
    )


def motion_paths(tracks: Tracks, times_s: Floats) -> list[Points]:
    """Return where moving obstacles are over times at equal steps, pieces (k, 2) between their jumps."""
    positions, velocities = tracks.over(times_s)
    if len(times_s) < 2:
        return []
    jumped = jumps(positions, velocities, float(times_s[1] - times_s[0]))
    ends = [np.flatnonzero(jumped[:, k]) + 1 for k in range(len(tracks))]
    return [
        piece
        for k, at in enumerate(ends)
        for piece in np.split(positions[:, k], at)
        if len(piece) > 1
    ]


def draw_motion_paths(axes: Axes, pieces: Sequence[Points], **look: Any) -> None:
    """Draw where moving obstacles go, pieces (k, 2)."""
    axes.add_collection(
        LineCollection(list(pieces), colors=MOVER, linewidths=0.8, **look)
    )


def draw_arrow(axes: Axes, at: Floats, along: Floats, **look: object) -> None:
    """Draw the head of an arrow at a point (2,) in a direction (2,), none if that is 0; look: of matplotlib's patch."""
    length = math.hypot(*along)
    if length > 1e-6:
        begin, end = (float(at[0]), float(at[1])), (at + along / length * 0.01).tolist()
        style = {"arrowstyle": "-|>", "color": MOVER, "shrinkA": 0.0, "shrinkB": 0.0}
        axes.annotate("", (end[0], end[1]), begin, arrowprops=style | look)
