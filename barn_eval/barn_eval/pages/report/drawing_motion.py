"""Moving obstacles on the maps of reports: their ways while trials ran, and what a trial ended against."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D

from barn_eval.pages.report.drawing import WALL
from barn_eval.pages.template import MOVER
from barn_eval.trials.result import TrialResult
from barn_worlds.base.arrays import Floats, Points
from barn_worlds.drawing.moving import draw_arrow
from barn_worlds.geometry.bodies import Bodies, moving_bodies, wall_bodies
from barn_worlds.moving.tracks import Tracks, jumps
from barn_worlds.worlds.world import World

_STEP_S = 0.1
_LONGEST_S = 200.0
_SHORTEST_ARROW_M = 0.3


def draw_boxes(axes: Axes, walls: Bodies) -> None:
    """Draw walls."""
    if len(walls.poses):
        axes.add_collection(PolyCollection(walls.outlines(), facecolor=WALL))


def draw_motion_of(axes: Axes, world: World, spans_s: Sequence[tuple[float, float]]) -> None:
    """Draw a world's walls, and the ways of its moving obstacles in spans of time into their motions, with arrows."""
    draw_boxes(axes, wall_bodies(world.walls))
    if not world.moving:
        return
    longest = {begin_s: max(end for begin, end in spans_s if begin == begin_s) for begin_s, _ in spans_s}
    for begin_s, end_s in longest.items():
        times_s = np.arange(max(begin_s, end_s - _LONGEST_S), end_s + 1e-9, _STEP_S)
        pieces = _ways(world.tracks, times_s)
        axes.add_collection(LineCollection(pieces, colors=MOVER, linewidths=0.8, alpha=0.55, zorder=1.5))
        for piece in pieces:
            if np.hypot(*(piece[-1] - piece[0])) > _SHORTEST_ARROW_M:
                draw_arrow(axes, piece[-1], piece[-1] - piece[-2], mutation_scale=8.0, linewidth=0.6, alpha=0.7)


def draw_touched(axes: Axes, world: World, result: TrialResult, time_s: float, colour: str) -> list[Artist]:
    """Draw and return the moving obstacle that ended a trial, where it was then; nothing where none did."""
    name = result.motion.touched if result.motion else ""
    if result.motion is None or name not in world.tracks.names:
        return []
    outline = moving_bodies(world.tracks, result.motion.phase_s + time_s).outlines()[world.tracks.names.index(name)]
    shown = PolyCollection([outline], facecolor=MOVER + "55", edgecolor=colour, linewidth=1.4, zorder=2.5)
    return [axes.add_collection(shown)]


def spans_of(driven: Iterable[tuple[TrialResult, Floats]]) -> list[tuple[float, float]]:
    """Return from when to when into the motions trials went, given their results and the times of their tracks."""
    return [
        (result.motion.phase_s, result.motion.phase_s + float(times_s[-1]))
        for result, times_s in driven
        if result.motion is not None
    ]


def motion_handles() -> list[Line2D]:
    """Return the entries of a legend."""
    disc: dict[str, Any] = {"marker": "o", "markersize": 9, "markerfacecolor": MOVER + "55", "linestyle": ""}
    return [
        Line2D([], [], color=MOVER, linewidth=1.0, alpha=0.7, label="way of what moves"),
        Line2D([], [], markeredgecolor=MOVER, label="what was hit", **disc),
    ]


def _ways(tracks: Tracks, times_s: Floats) -> list[Points]:
    """Return where obstacles were over times, pieces (k, 2) between their jumps."""
    positions, velocities = tracks.over(times_s)
    jumped = jumps(positions, velocities, _STEP_S)
    return [
        piece
        for k in range(len(tracks))
        for piece in np.split(positions[:, k], np.flatnonzero(jumped[:, k]) + 1)
        if len(piece) > 1
    ]
