"""Pictures and animations of worlds in which obstacles move, in metres in the Gazebo world frame."""

import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from barn_worlds.base.arrays import Points
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import write_bytes
from barn_worlds.drawing.files import figure_bytes, gif_bytes
from barn_worlds.drawing.palette import MOVER, MOVER_ON_TRACK, WALL
from barn_worlds.drawing.scene import draw_arrow, draw_bodies, draw_ways, ways
from barn_worlds.drawing.worlds import draw_world
from barn_worlds.geometry.bodies import moving_bodies, wall_bodies
from barn_worlds.moving.tracks import Tracks, jumps
from barn_worlds.worlds.world import World

MOST_FRAMES = 2000
MOST_ON_A_SHEET = 100
_TRACK_STEP_S = 0.05
_ARROWS = 4  # along a track
_LONGEST_TRACK_S = 200.0
_FINER = 2  # frames are drawn so many times larger, and made smaller with smooth edges
_TRAIL_S, _TRAIL_STEP_S = 2.0, 0.1


def motion_figure(world: World) -> Figure:
    """Return a picture of a world: where its obstacles are at time 0, their tracks, and arrows that say which way."""
    figure, axes = _figure(world)
    draw_motion(axes, world)
    axes.set_title(f"{world.name}: {len(world.moving)} moving obstacles, at time 0", parse_math=False)
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0, frameon=False)
    return figure


def motion_sheet(worlds: Sequence[World], titles: Sequence[str]) -> Figure:
    """Return one picture of many worlds with their tracks."""
    if not 1 <= len(worlds) <= MOST_ON_A_SHEET:
        raise WorldError(f"a sheet with motion shows 1 to {MOST_ON_A_SHEET} worlds, got {len(worlds)}")
    across = math.ceil(math.sqrt(len(worlds) * 1.5))
    down = math.ceil(len(worlds) / across)
    figure = Figure(figsize=(1.9 * across, 1.9 * down), layout="constrained")
    for k, world in enumerate(worlds):
        axes = figure.add_subplot(down, across, k + 1)
        draw_motion(axes, world, arrows=1)
        axes.set_title(titles[k], fontsize=7, parse_math=False, pad=2)
        axes.set_axis_off()
    return figure


def draw_motion(axes: Axes, world: World, *, arrows: int = _ARROWS, obstacles: bool = True) -> None:
    """Draw a world, its walls, the tracks of its obstacles with some arrows, and the obstacles at time 0."""
    draw_world(axes, world, cspace=False, containment=world.corner_m is None)
    draw_bodies(axes, wall_bodies(world.walls))
    axes.plot([], [], color=WALL, linewidth=4, label="wall" if world.walls else "")
    for one in world.moving:
        length_s = min(one.motion.period_s, _LONGEST_TRACK_S)
        times_s = np.linspace(0.0, length_s, max(2, math.ceil(length_s / _TRACK_STEP_S)), endpoint=False)
        draw_ways(axes, ways(Tracks([one]), times_s), alpha=0.6)
        for time_s in times_s[np.linspace(0, len(times_s) - 1, arrows + 2)[1:-1].astype(int)].tolist():
            place, velocity = (part[0] for part in Tracks([one]).at(time_s))
            draw_arrow(axes, place, velocity, mutation_scale=9.0)
    if obstacles and world.moving:
        look: dict[str, Any] = {
            "facecolor": MOVER_ON_TRACK,
            "edgecolor": MOVER,
            "alpha": 0.85,
            "label": "moving obstacle",
        }
        axes.add_collection(PolyCollection(moving_bodies(world.tracks, 0.0).outlines(), zorder=3, **look))
    axes.plot([], [], color=MOVER, linewidth=0.8, label="its track")


def write_animation(
    world: World, path: Path, duration_s: float = 15.0, frames_per_s: float = 8.0, speed: float = 1.0
) -> None:
    """Write an animation (GIF) of a world's obstacles with the trail of their last 2 s, from time 0, atomically.

    speed: multiples of the world's own time.
    """
    if not world.moving:
        raise WorldError(f"{world.name}: nothing moves in it; draw a picture (.png) of it")
    frames = math.ceil(duration_s * frames_per_s / speed)
    if not 1 <= frames <= MOST_FRAMES:
        raise WorldError(f"an animation must have 1 to {MOST_FRAMES} frames, got {frames}")
    images = _frames(world, [frame * speed / frames_per_s for frame in range(frames)])
    write_bytes(path, gif_bytes(images, frames_per_s))


def _frames(world: World, times_s: Sequence[float]) -> Iterator[Image.Image]:
    """Yield a picture for each time; the ground, walls and tracks are drawn once."""
    figure, axes = _figure(world)
    figure.set_layout_engine(None)
    axes.set_position((0.1, 0.11, 0.61, 0.8))
    draw_motion(axes, world, obstacles=False)
    axes.plot([], [], "o", color=MOVER_ON_TRACK, label="moving obstacle")
    title = f"{world.name}: {len(world.moving)} moving obstacles"
    axes.set_title(title, parse_math=False, loc="left")
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0, frameon=False)
    ground = Image.open(io.BytesIO(figure_bytes(figure, dots_per_inch=figure.dpi))).convert("RGB")
    height, to_pixels = ground.height, axes.transData
    large = ground.resize((ground.width * _FINER, ground.height * _FINER), Image.Resampling.NEAREST)
    palette = None

    def pixels(points: Points) -> list[tuple[float, float]]:
        found = to_pixels.transform(points)
        return [(float(x) * _FINER, (height - float(y)) * _FINER) for x, y in found]

    for time_s in times_s:
        picture = large.copy()
        draw = ImageDraw.Draw(picture)
        for outline in moving_bodies(world.tracks, time_s).outlines():
            draw.polygon(pixels(outline), fill=MOVER_ON_TRACK, outline=MOVER)
        for trail in _trails(world, time_s):
            draw.line(pixels(trail), fill=MOVER, width=2 * _FINER)
        small = picture.resize(ground.size, Image.Resampling.BOX)
        left, bottom = axes.transAxes.transform((1.04, 0.02))
        ImageDraw.Draw(small).text((left, height - bottom - 16), f"{time_s:5.1f} s", fill="black", font_size=15)
        palette = palette or small.quantize(64)
        yield small.quantize(palette=palette, dither=Image.Dither.NONE)


def _trails(world: World, time_s: float) -> Iterator[Points]:
    """Yield where every obstacle was in the last seconds, (k, 2) m, since it last jumped."""
    positions, velocities = world.tracks.over(np.arange(max(0.0, time_s - _TRAIL_S), time_s + 1e-9, _TRAIL_STEP_S))
    jumped = jumps(positions, velocities, _TRAIL_STEP_S)
    for k in range(len(world.moving)):
        last = np.flatnonzero(jumped[:, k])[-1:]
        trail = positions[last[0] + 1 if len(last) else 0 :, k]
        if len(trail) > 1:
            yield trail


def _figure(world: World) -> tuple[Figure, Axes]:
    left, below, right, above = world.bounds_m
    width = 8.0
    figure = Figure(figsize=(width, min(30.0, 0.8 + 6.0 * (above - below) / (right - left))), layout="constrained")
    return figure, figure.add_subplot()
