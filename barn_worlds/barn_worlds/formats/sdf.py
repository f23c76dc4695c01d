"""Writes worlds as SDF: 1.6 for Gazebo Classic, 1.9 for current Gazebo (gz sim).

Walls are static models. Moving obstacles are actors with a script: an actor in Gazebo
moves as its script says, touches nothing and is visible to cameras and GPU lidars. For
current Gazebo an actor needs a mesh, in a file beside the world. For Gazebo Classic its
shape is part of the world.
"""

import gzip
import math
from functools import cache
from pathlib import Path

import jinja2
import numpy as np

from barn_worlds.base.errors import WorldError, suggest
from barn_worlds.base.files import write_bytes
from barn_worlds.moving.motion import MovingObstacle
from barn_worlds.moving.tracks import Tracks
from barn_worlds.worlds.world import World

FLAVORS = ("classic", "gz")
MOVABLE_MASS_KG = 1.0  # of each obstacle in the trials of the paper
# Time between waypoints of a motion that Gazebo does not interpolate itself.
STEP_S = 0.1
_MESH_SIDES = 32  # of a cylinder
Waypoints = list[tuple[float, float, float]]


def write_sdf(
    world: World, path: Path, flavor: str = "classic", *, movable: bool = False
) -> None:
    """Write a world as SDF; for flavor gz, write .obj meshes of moving obstacles, too.

    Equal worlds give equal files.

    Args:
        world: World to write.
        path: File to write, gzipped if its name ends in .gz.
        flavor: One of `FLAVORS`.
        movable: Whether obstacles can be pushed, as `sdf_text` describes.

    Raises:
        WorldError: If the flavor is unknown or a file cannot be written.
    """
    content = sdf_text(world, flavor, movable=movable).encode()
    if path.suffix == ".gz":
        # Without a time of modification, equal worlds give equal files.
        content = gzip.compress(content, mtime=0)
    write_bytes(path, content)
    if flavor == "gz":
        for obstacle in world.moving:
            mesh_file = path.parent / mesh_name(obstacle)
            write_bytes(mesh_file, obj_mesh(obstacle).encode())


def sdf_text(world: World, flavor: str = "classic", *, movable: bool = False) -> str:
    """Return a world as SDF text, on a ground plane; WorldError for an unknown flavor.

    Args:
        world: World to write.
        flavor: "classic" makes each cylinder a model, named as in the original files.
            "gz" makes all static cylinders one model, which is faster to simulate.
        movable: Whether the obstacles, 1 kg each as in the trials of the paper, can be
            pushed. The containment cannot.

    Raises:
        WorldError: If the flavor is unknown.
    """
    if flavor not in FLAVORS:
        raise WorldError(f"unknown SDF flavor {flavor!r}{suggest(flavor, FLAVORS)}")
    return _template().render(
        world=world, gz=flavor == "gz", movable=movable, mass_kg=MOVABLE_MASS_KG
    )


@cache
def _template() -> jinja2.Template:
    """Load the Jinja template for SDF, once; it escapes all text."""
    # Users choose the names of worlds and obstacles, so names are escaped.
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("barn_worlds", "data/formats"),
        autoescape=True,
        keep_trailing_newline=True,
    )
    environment.filters["number"] = "{:.9g}".format
    environment.globals.update(mesh_name=mesh_name, trajectories=trajectories)
    return environment.get_template("world.sdf.jinja")


def trajectories(obstacle: MovingObstacle) -> list[Waypoints]:
    """Return an actor's motion as a list of waypoints (s, x, y), or two with a phase.

    Each list begins at time 0; the second is played after the first. If Gazebo's own
    spline reproduces the motion, the waypoints are its keys. Else they are `STEP_S`
    apart.
    """
    motion = obstacle.motion
    period_s = motion.period_s
    start_s = obstacle.phase_s % period_s
    if start_s:
        # The motion may jump when it repeats. Gazebo would interpolate in a trajectory.
        return [_sample(obstacle, start_s, period_s), _sample(obstacle, 0.0, start_s)]
    if motion.kind == "gazebo":
        first_s = motion.keys[0][0]
        last_s = motion.keys[-1][0]
        if first_s == 0.0 and last_s == period_s:
            return [list(motion.keys)]
    return [_sample(obstacle, 0.0, period_s)]


def mesh_name(obstacle: MovingObstacle) -> str:
    """Return the name (.obj) of an obstacle's mesh file, the same for equal shapes."""
    sizes = [obstacle.size_x_m, obstacle.size_y_m, obstacle.height_m]
    if obstacle.shape == "cylinder":
        sizes = [obstacle.radius_m, obstacle.height_m]
    return "_".join([obstacle.shape, *(f"{size:g}" for size in sizes)]) + ".obj"


def obj_mesh(obstacle: MovingObstacle) -> str:
    """Return an obstacle's closed mesh, about the origin, as Wavefront OBJ text."""
    if obstacle.shape == "cylinder":
        radius_m = obstacle.radius_m
        angles = [2.0 * math.pi * k / _MESH_SIDES for k in range(_MESH_SIDES)]
        rim = [(radius_m * math.cos(a), radius_m * math.sin(a)) for a in angles]
    else:
        x = obstacle.size_x_m / 2.0
        y = obstacle.size_y_m / 2.0
        rim = [(x, y), (-x, y), (-x, -y), (x, -y)]

    lines = []
    for z in (-obstacle.height_m / 2.0, obstacle.height_m / 2.0):
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y in rim]

    # Corners count from 1: those of the bottom, then those of the top. Faces list them
    # counter-clockwise as seen from outside.
    sides = len(rim)
    for k in range(1, sides + 1):
        following = k % sides + 1
        lines.append(f"f {k} {following} {following + sides} {k + sides}")
    for corners in (range(sides, 0, -1), range(sides + 1, 2 * sides + 1)):
        lines.append(" ".join(["f", *map(str, corners)]))
    return "\n".join(lines) + "\n"


def _sample(obstacle: MovingObstacle, begin_s: float, end_s: float) -> Waypoints:
    """Return waypoints (time from `begin_s`, x, y) of a motion from begin_s to end_s.

    The last one is before any jump at the end of the period.
    """
    steps = max(1, math.ceil((end_s - begin_s) / STEP_S))
    times_s = np.linspace(begin_s, end_s, steps + 1)
    # At the end of its period a motion is back at its beginning.
    before_jump_s = obstacle.motion.period_s * (1.0 - 1e-12)
    motion_s = np.minimum(times_s, before_jump_s) - obstacle.phase_s
    positions, _ = Tracks([obstacle]).over(motion_s)
    rows = zip(times_s.tolist(), positions[:, 0].tolist(), strict=True)
    return [(time_s - begin_s, x, y) for time_s, (x, y) in rows]
