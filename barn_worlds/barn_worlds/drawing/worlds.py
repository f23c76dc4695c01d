"""Pictures of worlds, in metres in the Gazebo world frame. The robot drives from the bottom to the top."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.figure import Figure

from barn_worlds.base.arrays import BoolGrid
from barn_worlds.base.errors import WorldError
from barn_worlds.drawing.palette import GOAL, HOLLOW, INFLATED, OBSTACLE, ROUTE, START, WALL, WHITE
from barn_worlds.drawing.scene import discs
from barn_worlds.worlds import cells as geometry
from barn_worlds.worlds.world import World

MOST_ON_A_SHEET = 1000
_CELL_PIXELS = 4


def draw_world(axes: Axes, world: World, *, cspace: bool = True, path: bool = True, containment: bool = True) -> None:
    """Draw a world: C-space, cylinders, containment, path, start and goal, with a legend and axes in metres."""
    if cspace:
        _mask(axes, world, world.cspace, INFLATED)
        axes.scatter([], [], marker="s", color=INFLATED, label="C-space obstacle")
    hollow = geometry.cell_centres(np.argwhere(geometry.hollow(world.grid)), world.rows, world.resolution_m)
    discs(axes, hollow, world.cylinder_radius_m, color=HOLLOW)
    discs(axes, world.obstacles_m, world.cylinder_radius_m, color=OBSTACLE)
    if world.grid.any() or world.corner_m is None:
        axes.scatter([], [], color=OBSTACLE, label="obstacle")
    if containment:
        discs(axes, world.containment_m, world.cylinder_radius_m, color=WALL)
        axes.scatter([], [], color=WALL, label="containment")
    if path:
        way = world.path_m()
        axes.plot(way[:, 0], way[:, 1], color=ROUTE, linewidth=2, label="path")
        axes.scatter(way[:1, 0], way[:1, 1], s=70, color=START, edgecolors=WHITE, zorder=4, label="start")
        axes.scatter(way[-1:, 0], way[-1:, 1], s=120, marker="*", color=GOAL, edgecolors=WHITE, zorder=4, label="goal")
    left, below, right, above = world.bounds_m
    bottom = below if containment else above - world.cols * world.resolution_m
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, above)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def world_figure(world: World) -> Figure:
    """Return a picture of one world."""
    left, below, right, above = world.bounds_m
    figure = Figure(figsize=(6.4, min(30.0, 1.2 + 4.2 * (above - below) / (right - left))), layout="constrained")
    axes = figure.add_subplot()
    draw_world(axes, world)
    axes.set_title(f"{world.name}: path {world.path_length_m:.2f} m", parse_math=False)
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0, frameon=False)
    return figure


def sheet_figure(worlds: Sequence[World], titles: Sequence[str] | None = None, columns: int | None = None) -> Figure:
    """Return one picture of many worlds, without containment; titles default to their names."""
    if not 1 <= len(worlds) <= MOST_ON_A_SHEET:
        raise WorldError(f"a sheet shows 1 to {MOST_ON_A_SHEET} worlds, got {len(worlds)}")
    across = columns or math.ceil(math.sqrt(len(worlds) * 1.5))
    if across < 1:
        raise WorldError(f"a sheet must have at least 1 column, got {columns}")
    down = math.ceil(len(worlds) / across)
    high, wide = max(world.cols for world in worlds), max(world.rows for world in worlds)
    gap = max(2, high // 6)
    if across * (wide + gap) * down * (high + gap) > 20_000_000 // _CELL_PIXELS**2:
        raise WorldError(f"{len(worlds)} worlds of up to {wide} x {high} cells are too large for one sheet; show fewer")
    sheet = np.ones((down * (high + gap), across * (wide + gap), 3), np.float32)
    figure = Figure(figsize=_sheet_size(sheet.shape[1], sheet.shape[0]), layout="constrained")
    axes = figure.add_subplot()
    for k, world in enumerate(worlds):
        top, left = (k // across) * (high + gap) + gap, (k % across) * (wide + gap)
        sheet[top : top + world.cols, left : left + world.rows] = _tile(world)
        title = titles[k] if titles is not None else world.name
        axes.text(left, top - 0.8, title, fontsize=6, va="bottom", clip_on=True, parse_math=False)
    axes.imshow(sheet, interpolation="nearest", aspect="equal")
    axes.set_axis_off()
    size = f"{wide * worlds[0].resolution_m:.2f} m x {high * worlds[0].resolution_m:.2f} m"
    figure.suptitle(
        f"{len(worlds)} worlds of {size}, start at the bottom, goal at the top: obstacles, C-space and path", fontsize=9
    )
    return figure


def _mask(axes: Axes, world: World, mask: BoolGrid, colour: str) -> None:
    left, _, right, above = world.bounds_m
    extent = (left, right, above - world.cols * world.resolution_m, above)
    shown = np.ma.masked_where(~mask.T, mask.T)
    axes.imshow(shown, cmap=ListedColormap([colour]), extent=extent, origin="lower", interpolation="nearest")


def _tile(world: World) -> npt.NDArray[np.float32]:
    """Return one world as colours (cols, rows, 3), the last column on top."""
    tile = np.empty((world.cols, world.rows, 3), np.float32)
    tile[:] = to_rgb(WHITE)
    tile[world.cspace.T] = to_rgb(INFLATED)
    tile[world.grid.T] = to_rgb(OBSTACLE)
    tile[world.path[:, 1], world.path[:, 0]] = to_rgb(ROUTE)
    for cell, colour in ((world.start_cell, START), (world.goal_cell, GOAL)):
        tile[cell[1], cell[0]] = to_rgb(colour)
    return tile[::-1]


def _sheet_size(wide: int, high: int) -> tuple[float, float]:
    """Return the size in inches at which a cell takes some pixels at 120 dots per inch."""
    return max(3.0, wide * _CELL_PIXELS / 120.0), max(2.0, high * _CELL_PIXELS / 120.0 + 0.4)
