"""Writing worlds as SDF: 1.6 for Gazebo Classic, 1.9 for current Gazebo (gz sim).

Walls are static models. Moving obstacles are actors with a script: an actor of Gazebo goes where its script says,
touches nothing and is seen by cameras and GPU lidars. Current Gazebo shows an actor only by a mesh, which is a file
beside the world; in Gazebo Classic its shape is part of the world.
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
MOVABLE_MASS_KG = 1.0  # of each obstacle in the paper's trials
STEP_S = (
    0.1  # between waypoints where a motion is not one that Gazebo interpolates itself
)
_SIDES = 32  # of the mesh of a cylinder
Waypoints = list[tuple[float, float, float]]


def write_sdf(
    world: World, path: Path, flavour: str = "classic", *, movable: bool = False
) -> None:
    """Write a world as `sdf_text` gives it; gzipped if the name ends in .gz (equal worlds give equal files).

    Beside it, for current Gazebo, the meshes of its moving obstacles.
    """
    content = sdf_text(world, flavour, movable=movable).encode()
    write_bytes(
        path, gzip.compress(content, mtime=0) if path.suffix == ".gz" else content
    )
    if flavour == "gz":
        for name, one in {mesh_name(one): one for one in world.moving}.items():
            write_bytes(path.parent / name, obj_mesh(one).encode())


def sdf_text(world: World, flavour: str = "classic", *, movable: bool = False) -> str:
    """Return a world as SDF for Gazebo Classic (`classic`) or current Gazebo (`gz`).

    The cylinders stand on the ground plane. movable: the obstacles, 1 kg each as in the paper's trials, can be pushed;
    the containment cannot. With `gz` the static cylinders are one model, which is faster to simulate; with `classic`
    each is a model of its own, named as in the original files.
    """
    if flavour not in FLAVORS:
        raise WorldError(
            f"unknown flavour of SDF {flavour!r}{suggest(flavour, FLAVORS)}"
        )
    return _template().render(
        world=world, gz=flavour == "gz", movable=movable, mass_kg=MOVABLE_MASS_KG
    )


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("barn_worlds", "data/formats"),
        autoescape=True,
        keep_trailing_newline=True,
    )
    environment.filters["number"] = "{:.9g}".format
    environment.globals.update(mesh_name=mesh_name, trajectories=trajectories)
    return environment.get_template("world.sdf.jinja")


def trajectories(obstacle: MovingObstacle) -> list[Waypoints]:
    """Return the waypoints (s, m, m) of an actor's trajectories, which follow each other; each starts at 0 s.

    The keys themselves where Gazebo's own spline makes the motion of them. Otherwise waypoints every `STEP_S`, in two
    trajectories if time 0 is in the midst of the motion, so that its jump stays one.
    """
    motion = obstacle.motion
    period_s, start_s = motion.period_s, obstacle.phase_s % motion.period_s
    if (
        motion.kind == "gazebo"
        and start_s == 0.0
        and motion.keys[0][0] == 0.0
        and motion.keys[-1][0] == period_s
    ):
        return [list(motion.keys)]
    spans = [(start_s, period_s), (0.0, start_s)] if start_s else [(0.0, period_s)]
    return [_sampled(obstacle, begin_s, end_s) for begin_s, end_s in spans]


def mesh_name(obstacle: MovingObstacle) -> str:
    """Return the name of the file with an obstacle's mesh, the same for equal shapes."""
    sizes = (
        [obstacle.radius_m]
        if obstacle.shape == "cylinder"
        else [obstacle.size_x_m, obstacle.size_y_m]
    )
    return (
        "_".join(
            [obstacle.shape, *(f"{size:g}" for size in (*sizes, obstacle.height_m))]
        )
        + ".obj"
    )


def obj_mesh(obstacle: MovingObstacle) -> str:
    """Return a closed mesh of an obstacle as Wavefront OBJ, its centre at the origin."""
    if obstacle.shape == "cylinder":
        turns = [2.0 * math.pi * k / _SIDES for k in range(_SIDES)]
        rim = [
            (obstacle.radius_m * math.cos(turn), obstacle.radius_m * math.sin(turn))
            for turn in turns
        ]
    else:
        x, y = obstacle.size_x_m / 2.0, obstacle.size_y_m / 2.0
        rim = [(x, y), (-x, y), (-x, -y), (x, -y)]
    half, sides = obstacle.height_m / 2.0, len(rim)
    around = [(k, k % sides + 1) for k in range(1, sides + 1)]
    faces: list[tuple[int, ...]] = [
        (k, after, after + sides, k + sides) for k, after in around
    ]
    faces += [tuple(range(sides, 0, -1)), tuple(range(sides + 1, 2 * sides + 1))]
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for z in (-half, half) for x, y in rim]
    return (
        "\n".join(lines + [" ".join(("f", *map(str, face))) for face in faces]) + "\n"
    )


def _sampled(obstacle: MovingObstacle, begin_s: float, end_s: float) -> Waypoints:
    """Return waypoints from one time of the motion to a later one, without its jump at the end."""
    times_s = np.linspace(
        begin_s, end_s, max(2, math.ceil((end_s - begin_s) / STEP_S) + 1)
    )
    within_s = (
        np.minimum(times_s, obstacle.motion.period_s * (1.0 - 1e-12)) - obstacle.phase_s
    )
    positions, _ = Tracks([obstacle]).over(within_s)
    return [
        (time_s - begin_s, *at)
        for time_s, at in zip(times_s.tolist(), positions[:, 0].tolist(), strict=True)
    ]
