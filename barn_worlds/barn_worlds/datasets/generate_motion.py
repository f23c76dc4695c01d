"""Generating worlds in which obstacles move, from a seed: arenas like those of DynaBARN, and motion in other worlds."""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.config import Checked, as_dict, quantity
from barn_worlds.base.errors import ConfigError, WorldError, suggest
from barn_worlds.moving.motion import Motion, MovingObstacle, Wall
from barn_worlds.worlds.world import Provenance, World

SIDE_M = 20.0
WALLS = (
    Wall(-10.0, 0.0, 0.5, SIDE_M),
    Wall(0.0, 10.0, SIDE_M, 0.5),
    Wall(0.0, -10.0, SIDE_M, 0.5),
)
START_M, GOAL_M = (11.0, 0.0), (-9.0, 0.0)

_CELL_M = 0.5
_CORNER_M = (-10.25, -10.25)  # outside of the walls
_SHAPE = (45, 41)  # up to x = 12.25 m, behind the start


def build_arena(
    name: str, moving: Sequence[MovingObstacle], provenance: Provenance | None = None
) -> World:
    """Return a world of the arena with these obstacles; its path is the straight line from start to goal, 20 m."""
    first, last = (
        round((point[0] - _CORNER_M[0]) / _CELL_M - 0.5) for point in (START_M, GOAL_M)
    )
    rows = np.arange(first, last - 1, -1)
    path = np.stack([rows, np.full(len(rows), _SHAPE[1] // 2)], axis=1)
    grid, given = np.zeros(_SHAPE, np.bool_), provenance or Provenance()
    return World(name, grid, path, _CELL_M, 1, given, WALLS, tuple(moving), _CORNER_M)


_HALF_M = SIDE_M / 2.0
_ATTEMPTS = 1000
_SHORTEST_M = 2.0  # of a profile
_NEAREST_M = 0.02  # points of a profile


@dataclass(frozen=True)
class MotionParameters(Checked):
    """What the motions of a class are generated with; both ends of a range are included.

    Speeds are on a grid. A profile has a mean speed and a spread, both drawn uniformly; each piece of it has a speed
    from the normal distribution with these, at least one step of the grid.
    """

    difficulty: str = quantity("easy", "name of the class")
    profiles: int = quantity(200, "motions to draw from", "", 1, 10_000)
    obstacles_min: int = quantity(5, "fewest obstacles of a world", "", 1, 500)
    obstacles_max: int = quantity(14, "most obstacles of a world", "", 1, 500)
    order_min: int = quantity(1, "lowest order of a polynomial", "", 1, 5)
    order_max: int = quantity(2, "highest order of a polynomial", "", 1, 5)
    points_min: int = quantity(
        2,
        "fewest random points of a profile, at least one more than its order",
        minimum=2,
    )
    points_max: int = quantity(3, "most random points of a profile", "", 2, 50)
    speed_min_mps: float = quantity(
        0.5, "lowest mean speed of a profile", "m/s", 0.05, 10.0
    )
    speed_max_mps: float = quantity(
        0.9, "highest mean speed of a profile", "m/s", 0.05, 10.0
    )
    speed_step_mps: float = quantity(0.1, "grid of speeds", "m/s", 0.01, 1.0)
    spread_min_mps: float = quantity(
        0.0, "smallest standard deviation of a profile", "m/s", 0.0, 5.0
    )
    spread_max_mps: float = quantity(
        0.08, "largest standard deviation of a profile", "m/s", 0.0, 5.0
    )
    samples: int = quantity(
        10, "values of x at which a polynomial is sampled", "", 2, 1000
    )
    radius_m: float = quantity(0.5, "radius of obstacles", "m", 0.01, 10.0)
    height_m: float = quantity(1.0, "height of obstacles", "m", 0.01, 100.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in (
            "obstacles_min",
            "order_min",
            "points_min",
            "speed_min_mps",
            "spread_min_mps",
        ):
            most = name.replace("min", "max")
            self.require(
                getattr(self, name) <= getattr(self, most),
                name,
                f"must be at most {most}",
            )
        pool = f"must be at most profiles = {self.profiles}"
        self.require(self.obstacles_max <= self.profiles, "obstacles_max", pool)


MOTION_CLASSES = {
    "easy": MotionParameters(),
    "medium": MotionParameters(
        "medium", 200, 15, 19, 2, 3, 3, 5, 1.0, 1.4, 0.1, 0.05, 0.14
    ),
    "hard": MotionParameters(
        "hard", 200, 20, 24, 3, 3, 4, 6, 1.5, 1.9, 0.1, 0.05, 0.15
    ),
}


def motion_class(name: str) -> MotionParameters:
    """Return the parameters of a class; ConfigError names the near one."""
    if name not in MOTION_CLASSES:
        raise ConfigError(f"unknown class {name!r:.60}{suggest(name, MOTION_CLASSES)}")
    return MOTION_CLASSES[name]


def generate_arenas(
    parameters: MotionParameters, worlds: int, seed: int
) -> list[World]:
    """Return random arenas of one class.

    Profile k is drawn from SeedSequence(seed, spawn_key=(0, k)), world k from spawn_key (1, k), so neither depends on
    how many others there are. Obstacles of a world are drawn from the profiles without replacement.
    """
    profile = cache(partial(_profile, parameters, seed))
    made = []
    for k in range(worlds):
        generator = _generator(seed, 1, k)
        count = _whole(generator, parameters.obstacles_min, parameters.obstacles_max)
        chosen = np.argsort(generator.random(parameters.profiles), kind="stable")[
            :count
        ].tolist()
        about = Provenance(
            "generated", parameters=as_dict(parameters), seed=(seed, 1, k)
        )
        made.append(
            build_arena(
                f"{parameters.difficulty}_{k}",
                [profile(number) for number in chosen],
                about,
            )
        )
    return made


def add_motion(
    world: World, parameters: MotionParameters, seed: int, obstacles: int | None = None
) -> World:
    """Return a world with moving obstacles added: polynomials across its field, as in the arena.

    They pass through the obstacles of its grid, as DynaBARN's pass through walls. obstacles: how many; None draws from
    the class. The field, not the lead-in, is theirs, so that the start stays free.
    """
    left, below, right, above = _field(world)
    centre, scale = (
        np.array([left + right, below + above]) / 2.0,
        np.array([right - left, above - below]) / SIDE_M,
    )
    moving = []
    for k in range(_count(parameters, seed, obstacles)):
        generator = _generator(seed, 3, k)
        motion = _timed(
            _polyline(parameters, generator) * scale + centre, parameters, generator
        )
        moving.append(_obstacle(parameters, f"{parameters.difficulty}_{k}", motion))
    return _with(world, moving, parameters, (seed, 3))


def add_crossings(
    world: World, parameters: MotionParameters, seed: int, obstacles: int | None = None
) -> World:
    """Return a world with obstacles that go to and fro across its path, as pedestrians cross a corridor.

    Each goes straight from one side of the field to the other and back without a rest, square to the way from start to
    goal, at a place of the path, with a speed of the class and a phase, all at random. obstacles: as in `add_motion`.
    """
    left, below, right, above = _field(world)
    path = world.path_m()
    along_x = abs(path[-1, 0] - path[0, 0]) > abs(path[-1, 1] - path[0, 1])
    moving = []
    for k in range(_count(parameters, seed, obstacles)):
        generator = _generator(seed, 4, k)
        x, y = path[int(generator.random() * len(path))].tolist()
        first, last = ((x, below), (x, above)) if along_x else ((left, y), (right, y))
        if generator.random() < 0.5:
            first, last = last, first
        speed = _grid_speed(
            _uniform(generator, parameters.speed_min_mps, parameters.speed_max_mps),
            parameters,
        )
        leg_s = math.dist(first, last) / speed
        motion = Motion(
            "linear",
            2.0 * leg_s,
            ((0.0, *first), (leg_s, *last), (2.0 * leg_s, *first)),
        )
        phase_s = generator.random() * motion.period_s
        moving.append(_obstacle(parameters, f"crossing_{k}", motion, phase_s))
    return _with(world, moving, parameters, (seed, 4))


def _field(world: World) -> tuple[float, float, float, float]:
    """Return x_min, y_min, x_max, y_max of the field in which obstacles move, without the lead-in."""
    if world.corner_m is not None:
        return -_HALF_M, -_HALF_M, _HALF_M, _HALF_M
    left, _, right, above = world.bounds_m
    return left, above - world.cols * world.resolution_m, right, above


def _count(parameters: MotionParameters, seed: int, obstacles: int | None) -> int:
    if obstacles is not None:
        return obstacles
    return _whole(
        _generator(seed, 2), parameters.obstacles_min, parameters.obstacles_max
    )


def _with(
    world: World,
    moving: list[MovingObstacle],
    parameters: MotionParameters,
    seed: tuple[int, ...],
) -> World:
    told = {**dict(world.provenance.parameters), "motion": as_dict(parameters)}
    about = dataclasses.replace(
        world.provenance, parameters=told, seed=(*world.provenance.seed, *seed)
    )
    return dataclasses.replace(world, moving=(*world.moving, *moving), provenance=about)


def _profile(parameters: MotionParameters, seed: int, number: int) -> MovingObstacle:
    generator = _generator(seed, 0, number)
    points = _polyline(parameters, generator)
    return _obstacle(
        parameters,
        f"{parameters.difficulty}_{number}",
        _timed(points, parameters, generator),
    )


def _obstacle(
    parameters: MotionParameters, name: str, motion: Motion, phase_s: float = 0.0
) -> MovingObstacle:
    radius_m, height_m = parameters.radius_m, parameters.height_m
    return MovingObstacle(
        name, radius_m=radius_m, height_m=height_m, phase_s=phase_s, motion=motion
    )


def _polyline(parameters: MotionParameters, generator: np.random.Generator) -> Points:
    """Return points (n, 2) in m in order of x, from border to border of the arena, along a random polynomial.

    The polynomial is fitted to random points with whole numbers of metres (through them, if they are one more than its
    order). The motion goes along it from its first to its last crossing of the border, by way of samples at fixed x,
    where these are inside, and of the random points themselves. Where it leaves the arena, the motion cuts short.
    """
    for _ in range(_ATTEMPTS):
        order = _whole(generator, parameters.order_min, parameters.order_max)
        count = max(
            order + 1, _whole(generator, parameters.points_min, parameters.points_max)
        )
        given: Points = (
            np.floor(generator.random((count, 2)) * (SIDE_M + 1.0)) - _HALF_M
        )
        if len(set(given[:, 0].tolist())) <= order:
            continue
        powers = np.vander(given[:, 0], order + 1)
        coefficients: Floats = np.linalg.lstsq(powers, given[:, 1], rcond=None)[
            0
        ].astype(np.float64)
        x = np.linspace(-_HALF_M, _HALF_M, parameters.samples)
        inside = x[np.abs(np.polyval(coefficients, x)) <= _HALF_M]
        on_it = np.concatenate([inside, _borders(coefficients)])
        along = np.stack(
            [on_it, np.clip(np.polyval(coefficients, on_it), -_HALF_M, _HALF_M)], axis=1
        )
        points: Points = np.concatenate([along, given])
        points = points[np.argsort(points[:, 0], kind="stable")]
        points = points[
            np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > _NEAREST_M])
        ]
        if (
            len(points) > 1
            and np.hypot(*np.diff(points, axis=0).T).sum() >= _SHORTEST_M
        ):
            return points
    raise WorldError(
        f"no motion in {_ATTEMPTS} attempts for class {parameters.difficulty!r:.60}"
    )


def _borders(coefficients: Floats) -> Floats:
    """Return the least and the greatest x (2,) at which a polynomial is on the arena's border; (0,) if it never is."""
    found = [
        x for x in (-_HALF_M, _HALF_M) if abs(np.polyval(coefficients, x)) <= _HALF_M
    ]
    for border in (-_HALF_M, _HALF_M):
        shifted = coefficients.copy()
        shifted[-1] -= border
        roots = np.roots(shifted)
        found += [
            float(root.real)
            for root in roots
            if abs(root.imag) < 1e-9 and abs(root.real) <= _HALF_M
        ]
    return np.array([min(found), max(found)] if found else [])


def _timed(
    points: Points, parameters: MotionParameters, generator: np.random.Generator
) -> Motion:
    """Return the motion through points (n, 2), in this or the reverse direction, at random speeds."""
    ordered = points[::-1] if generator.random() < 0.5 else points
    mean = _uniform(generator, parameters.speed_min_mps, parameters.speed_max_mps)
    spread = _uniform(generator, parameters.spread_min_mps, parameters.spread_max_mps)
    time_s, keys = 0.0, [(0.0, *map(float, ordered[0]))]
    for before, at in itertools.pairwise(ordered):
        speed = _grid_speed(mean + spread * _normal(generator), parameters)
        time_s += max(float(np.hypot(*(at - before))) / speed, 0.01)
        keys.append((round(time_s, 2), float(at[0]), float(at[1])))
    kept = [
        keys[0],
        *(key for last, key in itertools.pairwise(keys) if key[0] > last[0]),
    ]
    return Motion(
        "gazebo",
        kept[-1][0],
        tuple((key[0], round(key[1], 2), round(key[2], 2)) for key in kept),
    )


def _grid_speed(speed: float, parameters: MotionParameters) -> float:
    step = parameters.speed_step_mps
    return max(round(speed / step), 1) * step


def _whole(generator: np.random.Generator, low: int, high: int) -> int:
    return low + int(generator.random() * (high - low + 1))


def _uniform(generator: np.random.Generator, low: float, high: float) -> float:
    return low + (high - low) * float(generator.random())


def _normal(generator: np.random.Generator) -> float:
    """Return a number from the standard normal distribution; uses `random` alone, which NumPy hardly ever changes."""
    first, second = generator.random(2).tolist()
    return math.sqrt(-2.0 * math.log(1.0 - first)) * math.cos(2.0 * math.pi * second)


def _generator(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
