"""Pictures and animations of worlds, in metres in the Gazebo world frame. The robot drives from bottom to top."""

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.figure import Figure
from PIL import Image

from barn_worlds.base.arrays import Points
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import write_bytes
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing import palette
from barn_worlds.drawing.files import gif_bytes
from barn_worlds.drawing.scene import (
    draw_arrow,
    draw_discs,
    draw_motion_paths,
    draw_scene,
    motion_paths,
)
from barn_worlds.geometry.bodies import moving_bodies, wall_bodies
from barn_worlds.moving.tracks import Tracks
from barn_worlds.worlds import cells as geometry
from barn_worlds.worlds.scene import scene_of
from barn_worlds.worlds.world import World

MOST_ON_A_SHEET = 1000
_CELL_PIXELS = 4
_FRAMES, _FRAMES_PER_S = 120, 8.0
_TRACK_STEP_S = 0.05
_ARROWS = 4  # along a track
_LONGEST_TRACK_S = 200.0


def world_figure(
    world: World,
    start: Pose2D | None = None,
    goal: Pose2D | None = None,
    near_m: float = 0.0,
) -> Figure:
    """Return a picture of one world; moving obstacles with their tracks, where they are at time 0.

    start, goal: what is driven, with how near to the goal counts as arrival; without, the ends of the path.
    """
    figure, axes = _figure(world, start, goal, near_m)
    _draw_moving(axes, world, arrows=_ARROWS)
    axes.legend(
        loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0, frameon=False
    )
    return figure


def write_animation(world: World, path: Path) -> None:
    """Write an animation (GIF) of the first 15 s of a world's moving obstacles, atomically."""
    if not world.moving:
        raise WorldError(
            f"{world.name}: nothing moves in it; draw a picture (.png) of it"
        )
    write_bytes(path, gif_bytes(_frames(world), _FRAMES_PER_S))


def sheet_figure(worlds: Mapping[int, World]) -> Figure:
    """Return one picture of many worlds by number, without containment."""
    if not 1 <= len(worlds) <= MOST_ON_A_SHEET:
        raise WorldError(
            f"a sheet shows 1 to {MOST_ON_A_SHEET} worlds, got {len(worlds)}"
        )
    across = math.ceil(math.sqrt(len(worlds) * 1.5))
    down = math.ceil(len(worlds) / across)
    high, wide = (
        max(world.cols for world in worlds.values()),
        max(world.rows for world in worlds.values()),
    )
    gap = max(2, high // 6)
    if across * (wide + gap) * down * (high + gap) > 20_000_000 // _CELL_PIXELS**2:
        raise WorldError(
            f"{len(worlds)} worlds of up to {wide} x {high} cells are too large for one sheet; show fewer"
        )
    sheet = np.ones((down * (high + gap), across * (wide + gap), 3), np.float32)
    inches = (side * _CELL_PIXELS / 120.0 for side in (sheet.shape[1], sheet.shape[0]))
    figure = Figure(
        figsize=(max(3.0, next(inches)), max(2.0, next(inches) + 0.4)),
        layout="constrained",
    )
    axes = figure.add_subplot()
    for k, (number, world) in enumerate(worlds.items()):
        top, left = (k // across) * (high + gap) + gap, (k % across) * (wide + gap)
        sheet[top : top + world.cols, left : left + world.rows] = _tile(world)
        axes.text(left, top - 0.8, str(number), fontsize=6, va="bottom", clip_on=True)
        if world.walls or world.moving:
            _draw_moving(axes, world, partial(_onto_tile, world, left, top))
    axes.imshow(sheet, interpolation="nearest", aspect="equal")
    axes.set_axis_off()
    figure.suptitle(
        f"{len(worlds)} worlds of up to {wide} x {high} cells, start blue, goal green",
        fontsize=9,
    )
    return figure


def _figure(
    world: World,
    start: Pose2D | None = None,
    goal: Pose2D | None = None,
    near_m: float = 0.0,
) -> tuple[Figure, Axes]:
    """Return a figure of what stands in a world, and its axes in metres."""
    left, below, right, above = world.bounds_m
    extent = (left, right, above - world.cols * world.resolution_m, above)
    first, last = (Pose2D(x, y, 0.0) for x, y in world.path_m()[[0, -1]].tolist())
    scene = scene_of(world, start or first, goal or last, near_m)
    (left, below), (right, above) = scene.view_m(
        np.array([left, below]), np.array([right, above])
    )
    size = (6.4, min(30.0, 1.2 + 4.2 * (above - below) / (right - left)))
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    near = np.ma.masked_where(~world.cspace.T, world.cspace.T)
    axes.imshow(
        near,
        cmap=ListedColormap([palette.INFLATED]),
        extent=extent,
        origin="lower",
        interpolation="nearest",
    )
    hollow = world.cell_centers_m(np.argwhere(geometry.hollow_cells(world.grid)))
    draw_discs(axes, hollow, world.cylinder_radius_m, color=palette.HOLLOW)
    draw_scene(axes, scene)
    if world.grid.any():
        axes.scatter(
            [], [], marker="s", color=palette.INFLATED, label="C-space obstacle"
        )
        axes.scatter([], [], color=palette.OBSTACLE, label="obstacle")
    above = max(above, goal.y + near_m + 0.2) if goal else above
    axes.set(
        xlim=(left, right),
        ylim=(below, above),
        aspect="equal",
        xlabel="x [m]",
        ylabel="y [m]",
    )
    moving = f", {len(world.moving)} moving obstacles" if world.moving else ""
    axes.set_title(
        f"{world.name}: path {world.path_length_m:.2f} m{moving}", parse_math=False
    )
    return figure, axes


def _draw_moving(
    axes: Axes,
    world: World,
    onto: Callable[[Points], Points] = lambda points: points,
    arrows: int = 0,
) -> PolyCollection:
    """Draw walls, tracks with some arrows, and obstacles at time 0, which it returns; onto: from metres to the axes."""
    axes.add_collection(
        PolyCollection(
            list(map(onto, wall_bodies(world.walls).outlines())), facecolor=palette.WALL
        )
    )
    for one in world.moving:
        length_s, tracks = min(one.motion.period_s, _LONGEST_TRACK_S), Tracks([one])
        times_s = np.linspace(
            0.0, length_s, max(2, math.ceil(length_s / _TRACK_STEP_S)), endpoint=False
        )
        draw_motion_paths(
            axes, list(map(onto, motion_paths(tracks, times_s))), alpha=0.6
        )
        for time_s in times_s[
            np.linspace(0, len(times_s) - 1, arrows + 2)[1:-1].astype(int)
        ].tolist():
            place, velocity = (part[0] for part in tracks.at(time_s))
            draw_arrow(axes, place, velocity, mutation_scale=9.0)
    label = "moving obstacle" if world.moving else ""
    outlines = list(map(onto, moving_bodies(world.tracks, 0.0).outlines()))
    obstacles = PolyCollection(
        outlines,
        facecolor=palette.MOVER_ON_TRACK,
        edgecolor=palette.MOVER,
        alpha=0.85,
        zorder=3,
        label=label,
    )
    axes.add_collection(obstacles)
    return obstacles


def _onto_tile(world: World, left: int, top: int, points: Points) -> Points:
    """Return where points (n, 2) in metres are on a sheet, in cells."""
    corner = np.array([world.bounds_m[0], world.bounds_m[3]])
    cells: Points = (points - corner) / world.resolution_m * [1.0, -1.0] + [
        left - 0.5,
        top - 0.5,
    ]
    return cells


def _frames(world: World) -> Iterator[Image.Image]:
    """Yield the pictures of an animation; what stands and the tracks are drawn once."""
    figure, axes = _figure(world)
    canvas: Any = FigureCanvasAgg(figure)
    obstacles = _draw_moving(axes, world)
    clock = axes.text(0.02, 0.02, "", transform=axes.transAxes, fontsize=12)
    for one in (obstacles, clock):
        one.set_animated(True)
    canvas.draw()
    ground, palette = canvas.copy_from_bbox(figure.bbox), None
    for time_s in (np.arange(_FRAMES) / _FRAMES_PER_S).tolist():
        canvas.restore_region(ground)
        obstacles.set_verts(moving_bodies(world.tracks, time_s).outlines())
        clock.set_text(f"{time_s:5.1f} s")
        for one in (obstacles, clock):
            axes.draw_artist(one)
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        palette = palette or picture.quantize(64)
        yield picture.quantize(palette=palette, dither=Image.Dither.NONE)


def _tile(world: World) -> npt.NDArray[np.float32]:
    """Return one world as colours (cols, rows, 3), the last column on top."""
    tile = np.empty((world.cols, world.rows, 3), np.float32)
    tile[:] = to_rgb(palette.WHITE)
    tile[world.cspace.T] = to_rgb(palette.INFLATED)
    tile[world.grid.T] = to_rgb(palette.OBSTACLE)
    tile[world.path[:, 1], world.path[:, 0]] = to_rgb(palette.ROUTE)
    for cell, colour in (
        (world.start_cell, palette.START),
        (world.goal_cell, palette.GOAL),
    ):
        tile[cell[1], cell[0]] = to_rgb(colour)
    return tile[::-1]
