"""What the moving obstacles of worlds do.

How many, how fast, and how often they are in the way, by class of motion.

    python qa/studies/motion_statistics.py dynabarn60
    python qa/studies/motion_statistics.py out/moving.npz

Means over the first 100 s of the worlds of a data set, as docs/dynamic.md has them.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from barn_worlds.base.arrays import BoolGrid, Floats
from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.moving.motion import MovingObstacle
from barn_worlds.moving.tracks import Tracks, jumps
from barn_worlds.worlds.world import World

DURATION_S = 100.0  # the challenge's limit
_STEP_S = 0.05
_PLACE_M = 0.1


@dataclass(frozen=True)
class MotionStatistics:
    """Figures of one world over its first 100 s.

    mean_speed_mps: of an obstacle over its period, jumps left out; the mean over the
    obstacles. slowest_mps, fastest_mps: the extremes of these. period_s: mean of the
    periods. crossings_per_min: how often the center of an obstacle goes over the
    straight line from the start of the path to its end. occupied_share: of that line,
    the mean over time.
    """

    obstacles: float
    mean_speed_mps: float
    slowest_mps: float
    fastest_mps: float
    period_s: float
    crossings_per_min: float
    occupied_share: float


def motion_statistics(world: World) -> MotionStatistics:
    """Return the figures of a world; WorldError where nothing moves."""
    if not world.moving:
        raise WorldError(f"{world.name}: nothing moves in it")
    speeds = [mean_speed(motion) for motion in world.moving]
    positions, velocities = world.tracks.over(np.arange(0.0, DURATION_S, _STEP_S))
    path = world.path_m()
    length_m = math.dist(path[0], path[-1])
    if length_m == 0.0:
        raise WorldError(
            f"{world.name}: its path ends where it begins, so no straight line can be crossed"
        )
    along_x, along_y = (path[-1] - path[0]) / length_m
    from_start = positions - path[0]
    on_line = from_start @ np.array([along_x, along_y])
    beside = from_start @ np.array([-along_y, along_x])
    reach_m = np.maximum(world.tracks.radius_m, np.hypot(*world.tracks.size_m.T) / 2.0)
    return MotionStatistics(
        len(speeds),
        float(np.mean(speeds)),
        min(speeds),
        max(speeds),
        float(np.mean([motion.motion.period_s for motion in world.moving])),
        crossings(on_line, beside, jumps(positions, velocities, _STEP_S), length_m)
        * 60.0
        / DURATION_S,
        occupied_share(on_line[::4], beside[::4], reach_m, length_m),
    )


def mean_statistics(worlds: Iterable[World]) -> MotionStatistics:
    """Return the means over worlds, but the slowest and the fastest obstacle of all."""
    each = [motion_statistics(world) for world in worlds]
    means = {}
    for item in fields(MotionStatistics):
        values = [getattr(statistics, item.name) for statistics in each]
        means[item.name] = float(np.mean(values))
    means["slowest_mps"] = min(statistics.slowest_mps for statistics in each)
    means["fastest_mps"] = max(statistics.fastest_mps for statistics in each)
    return MotionStatistics(**means)


def mean_speed(obstacle: MovingObstacle) -> float:
    """Return the length of a motion by its period, without the jump at its end."""
    times_s = np.linspace(0.0, obstacle.motion.period_s, 1001)[:-1] - obstacle.phase_s
    positions, _ = Tracks([obstacle]).over(times_s)
    return float(np.hypot(*np.diff(positions[:, 0], axis=0).T).sum()) / (
        obstacle.motion.period_s * 0.999
    )


def crossings(
    on_line: Floats, beside: Floats, jumped: BoolGrid, length_m: float
) -> int:
    """Count the changes of side within a line, jumps left out.

    on_line, beside: (t, n) m along it, left of it.
    """
    within = (on_line[1:] >= 0.0) & (on_line[1:] <= length_m)
    other_side = (beside[1:] > 0.0) != (beside[:-1] > 0.0)
    return int((other_side & within & ~jumped).sum())


def occupied_share(
    on_line: Floats, beside: Floats, reach: Floats, length_m: float
) -> float:
    """Return the share of the line's places that obstacles of a reach (n,) cover."""
    places = np.arange(_PLACE_M / 2.0, length_m, _PLACE_M)
    covered = np.zeros((len(on_line), len(places)), np.bool_)
    half = np.sqrt(np.maximum(reach**2 - beside**2, 0.0))
    for k in range(len(reach)):
        near = np.flatnonzero(half[:, k] > 0.0)
        covered[near] |= np.abs(places - on_line[near, k, None]) < half[near, k, None]
    return float(covered.mean())


def by_class(source: str) -> dict[str, list[World]]:
    """Return the worlds of a data set by their class of motion."""
    worlds_by_class: dict[str, list[World]] = {}
    dataset = open_dataset(source)
    for world in map(dataset.load, dataset.world_numbers):
        parameters = world.provenance.parameters
        motion = parameters.get("motion", parameters)
        difficulty = str(motion.get("difficulty", "all"))
        worlds_by_class.setdefault(difficulty, []).append(world)
    return worlds_by_class


@click.command()
@click.argument("source")
def main(source: str) -> None:
    """Count."""
    table = Table("class", "worlds", *(item.name for item in fields(MotionStatistics)))
    for name, worlds in by_class(source).items():
        figures = mean_statistics(worlds)
        values = [f"{value:.3f}" for value in vars(figures).values()]
        table.add_row(name, str(len(worlds)), *values)
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
