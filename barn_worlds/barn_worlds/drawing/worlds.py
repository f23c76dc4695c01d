"""Pictures and animations of worlds, in meters in the Gazebo world frame.

The robot drives from bottom to top.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D
from PIL import Image

from barn_worlds.base.arrays import Points, Singles
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import write_bytes
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing import palette
from barn_worlds.drawing.files import gif_bytes
from barn_worlds.drawing.scene import (
    START_MARK,
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
_LARGEST_SHEET_PIXELS = 20_000_000
_CELL_PIXELS = 4
_FRAMES = 120
_FRAMES_PER_S = 8.0
_TRACK_STEP_S = 0.05
_LONGEST_TRACK_S = 200.0
_ARROWS_PER_TRACK = 4


def world_figure(
    world: World,
    start: Pose2D | None = None,
    goal: Pose2D | None = None,
    goal_distance_m: float = 0.0,
) -> Figure:
    """Return a matplotlib figure of one world, with moving obstacles at time 0.

    Args:
        world: World to show with its C-space, path and containment.
        start: Start of a robot. By default the first cell of the path.
        goal: Goal of a robot. By default the last cell of the path.
        goal_distance_m: Distance from the goal that counts as arrival.
    """
    figure, axes = _draw_world(world, start, goal, goal_distance_m)
    _draw_motion(axes, world, arrows=_ARROWS_PER_TRACK)
    axes.legend(
        loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0, frameon=False
    )
    return figure


def routes_figure(worlds: Mapping[int, World]) -> Figure:
    """Return one figure of a map with its routes, each with its number near its start.

    Args:
        worlds: Worlds by number, which differ only in their course.
    """
    paths_m = {number: world.path_m() for number, world in worlds.items()}
    first = next(iter(worlds.values()))
    figure, axes = _draw_world(first, further_m=tuple(paths_m.values()))
    for number, points in paths_m.items():
        color = palette.PLANNERS[number % len(palette.PLANNERS)]
        axes.plot(*points.T, color=color, linewidth=1.5)
        axes.plot(*points[0], **START_MARK)
        axes.plot(*points[-1], "*", color=palette.GOAL, markersize=9)
        label_x, label_y = points[len(points) // 8].tolist()
        axes.text(
            label_x,
            label_y,
            str(number),
            color=palette.WHITE,
            fontsize=7,
            ha="center",
            va="center",
            bbox={"boxstyle": "circle", "facecolor": color, "edgecolor": "none"},
        )
    lengths_m = [world.path_length_m for world in worlds.values()]
    axes.set_title(
        f"{len(worlds)} routes of {min(lengths_m):.1f} to {max(lengths_m):.1f} m, "
        "numbers near their starts, stars at their goals",
        fontsize=9,
    )
    return figure


def write_animation(world: World, path: Path) -> None:
    """Write a GIF of a world's first 15 s of motion; WorldError if nothing moves.

    Args:
        world: World with moving obstacles.
        path: File to write, a GIF.

    Raises:
        WorldError: If nothing moves in the world.
    """
    if not world.moving:
        raise WorldError(
            f"{world.name}: nothing moves in it; write a picture (.png) instead"
        )
    write_bytes(path, gif_bytes(_frames(world), _FRAMES_PER_S))


def sheet_figure(worlds: Mapping[int, World]) -> Figure:
    """Return a figure with a tile per world; WorldError for none, too many, too large.

    Raises:
        WorldError: If there are no worlds, or too many or too large ones.
    """
    if not 1 <= len(worlds) <= MOST_ON_A_SHEET:
        raise WorldError(
            f"a sheet shows 1 to {MOST_ON_A_SHEET} worlds, got {len(worlds)}"
        )
    # Screens are wider than high.
    across = math.ceil(math.sqrt(len(worlds) * 1.5))
    down = math.ceil(len(worlds) / across)
    largest_cols = max(world.cols for world in worlds.values())
    largest_rows = max(world.rows for world in worlds.values())
    size = f"{len(worlds)} worlds of up to {largest_rows} x {largest_cols} cells"
    gap = max(2, largest_cols // 6)
    tile_height = largest_cols + gap
    tile_width = largest_rows + gap
    height = down * tile_height
    width = across * tile_width
    if width * height > _LARGEST_SHEET_PIXELS // _CELL_PIXELS**2:
        raise WorldError(f"{size} are too large for one sheet; show fewer")

    figure = Figure(
        figsize=(
            max(3.0, width * _CELL_PIXELS / 120.0),
            max(2.0, height * _CELL_PIXELS / 120.0 + 0.4),
        ),
        layout="constrained",
    )
    axes = figure.add_subplot()
    sheet = np.ones((height, width, 3), np.float32)
    for place, (number, world) in enumerate(worlds.items()):
        top = (place // across) * tile_height + gap
        left = (place % across) * tile_width
        sheet[top : top + world.cols, left : left + world.rows] = _tile(world)
        axes.text(left, top - 0.8, str(number), fontsize=6, va="bottom", clip_on=True)
        if world.walls or world.moving:
            _draw_motion(axes, world, tile=(left, top))

    axes.imshow(sheet, interpolation="nearest", aspect="equal")
    axes.set_axis_off()
    figure.suptitle(f"{size}, start blue, goal green", fontsize=9)
    return figure


def _draw_world(
    world: World,
    start: Pose2D | None = None,
    goal: Pose2D | None = None,
    goal_distance_m: float = 0.0,
    further_m: tuple[Points, ...] = (),
) -> tuple[Figure, Axes]:
    """Return a new figure of a world without moving obstacles, and its axes in meters.

    `further_m` are further points (n, 2) that the figure must contain.
    """
    left, below, right, above = world.bounds_m
    # The grid, without the containment in front of it.
    field = (left, right, above - world.cols * world.resolution_m, above)
    first, last = (Pose2D(x, y, 0.0) for x, y in world.path_m()[[0, -1]].tolist())
    scene = scene_of(world, start or first, goal or last, goal_distance_m)
    (left, below), (right, above) = scene.view_m(
        np.array([left, below]), np.array([right, above]), *further_m
    )

    # Axes of 4.2 inches across, and 1.2 inches for title and labels.
    height = 1.2 + 4.2 * (above - below) / (right - left)
    figure = Figure(figsize=(6.4, min(30.0, height)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.imshow(
        # Rows lie along x, so an image shows the transpose.
        np.ma.masked_where(~world.cspace.T, world.cspace.T),
        cmap=ListedColormap([palette.INFLATED]),
        extent=field,
        origin="lower",
        interpolation="nearest",
    )
    hollow = world.cell_centers_m(np.argwhere(geometry.hollow_cells(world.grid)))
    draw_discs(axes, hollow, world.cylinder_radius_m, color=palette.HOLLOW)
    draw_scene(axes, scene)
    if world.grid.any():
        # Drawn for the legend alone.
        axes.scatter(
            [], [], marker="s", color=palette.INFLATED, label="C-space obstacle"
        )
        axes.scatter([], [], color=palette.OBSTACLE, label="obstacle")

    if goal is not None:
        # The protocol may place the goal beyond the grid.
        above = max(above, goal.y + goal_distance_m + 0.2)
    axes.set(
        xlim=(left, right),
        ylim=(below, above),
        aspect="equal",
        xlabel="x [m]",
        ylabel="y [m]",
    )
    title = f"{world.name}: path {world.path_length_m:.2f} m"
    if world.moving:
        title += f", {len(world.moving)} moving obstacles"
    axes.set_title(title, parse_math=False)
    return figure, axes


def _draw_motion(
    axes: Axes, world: World, tile: tuple[int, int] | None = None, arrows: int = 0
) -> PolyCollection:
    """Draw walls, tracks and moving obstacles at time 0; return the obstacles drawn.

    Args:
        axes: Axes in meters, or in cells of a sheet.
        world: The world.
        tile: Left column and top row of the world on a sheet.
        arrows: Number of arrows on each track.
    """
    style: dict[str, Any] = {}
    if tile is not None:
        # From meters to cells of the sheet, whose rows run downward.
        scale = 1.0 / world.resolution_m
        to_tile = Affine2D().translate(-world.bounds_m[0], -world.bounds_m[3])
        to_tile = to_tile.scale(scale, -scale).translate(tile[0] - 0.5, tile[1] - 0.5)
        style["transform"] = to_tile + axes.transData
    walls = wall_bodies(world.walls).outlines()
    axes.add_collection(PolyCollection(walls, facecolor=palette.WALL, **style))

    for obstacle in world.moving:
        tracks = Tracks([obstacle])
        length_s = min(obstacle.motion.period_s, _LONGEST_TRACK_S)
        count = max(2, math.ceil(length_s / _TRACK_STEP_S))
        times_s = np.linspace(0.0, length_s, count, endpoint=False)
        draw_motion_paths(axes, motion_paths(tracks, times_s), alpha=0.6, **style)
        # Evenly spread, but not at the very ends.
        places = np.linspace(0, len(times_s) - 1, arrows + 2).astype(int)
        for time_s in times_s[places[1:-1]].tolist():
            positions, velocities = tracks.at(time_s)
            draw_arrow(axes, positions[0], velocities[0], mutation_scale=9.0)

    obstacles = PolyCollection(
        moving_bodies(world.tracks, 0.0).outlines(),
        facecolor=palette.MOVER_ON_TRACK,
        edgecolor=palette.MOVER,
        alpha=0.85,
        zorder=3,
        label="moving obstacle" if world.moving else "",
        **style,
    )
    axes.add_collection(obstacles)
    return obstacles


def _frames(world: World) -> Iterator[Image.Image]:
    """Yield 120 images, 8 for each second, of a world's moving obstacles.

    Everything else is drawn once.
    """
    figure, axes = _draw_world(world)
    canvas: Any = FigureCanvasAgg(figure)
    obstacles = _draw_motion(axes, world)
    clock = axes.text(0.02, 0.02, "", transform=axes.transAxes, fontsize=12)
    obstacles.set_animated(True)
    clock.set_animated(True)
    # This leaves out animated parts.
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)

    # All images share the colors of the first, so that the GIF does not flicker.
    colors = None
    for time_s in (np.arange(_FRAMES) / _FRAMES_PER_S).tolist():
        canvas.restore_region(background)
        obstacles.set_verts(moving_bodies(world.tracks, time_s).outlines())
        clock.set_text(f"{time_s:5.1f} s")
        axes.draw_artist(obstacles)
        axes.draw_artist(clock)
        # The GIF needs no transparency.
        image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        colors = colors or image.quantize(64)
        yield image.quantize(palette=colors, dither=Image.Dither.NONE)


def _tile(world: World) -> Singles:
    """Return one world as RGB (cols, rows, 3), 0 to 1: x across, last column on top."""
    tile = np.empty((world.cols, world.rows, 3), np.float32)
    tile[:] = to_rgb(palette.WHITE)
    tile[world.cspace.T] = to_rgb(palette.INFLATED)
    tile[world.grid.T] = to_rgb(palette.OBSTACLE)
    rows, columns = world.path.T
    tile[columns, rows] = to_rgb(palette.ROUTE)
    tile[columns[0], rows[0]] = to_rgb(palette.START)
    tile[columns[-1], rows[-1]] = to_rgb(palette.GOAL)
    # Images begin with the top row.
    return tile[::-1]
