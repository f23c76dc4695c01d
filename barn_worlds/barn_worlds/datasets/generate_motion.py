"""Generates worlds with moving obstacles from a seed.

They are arenas like those of DynaBARN, or other worlds with obstacles added.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from barn_worlds.base.arrays import Floats, Points, side_lengths
from barn_worlds.base.config import Checked, as_dict, quantity, read_presets
from barn_worlds.base.errors import ConfigError, WorldError, suggest
from barn_worlds.moving.motion import Motion, MovingObstacle, Wall
from barn_worlds.worlds.world import Provenance, World

SIDE_M = 20.0
WALLS = (
    Wall(-10.0, 0.0, 0.5, SIDE_M),
    Wall(0.0, 10.0, SIDE_M, 0.5),
    Wall(0.0, -10.0, SIDE_M, 0.5),
)
START_M = (11.0, 0.0)
GOAL_M = (-9.0, 0.0)
_HALF_M = SIDE_M / 2.0
_CELL_M = 0.5
# Outside of the walls.
_CORNER_M = (-10.25, -10.25)
# Reaches to x = 12.25 m, behind the start.
_SHAPE = (45, 41)

_ATTEMPTS = 1000
_SHORTEST_PROFILE_M = 2.0
# Points of a profile that are closer to the one before are left out.
_CLOSEST_POINTS_M = 0.02

# First entry of the spawn keys of each kind of random numbers: no two share a stream.
_PROFILE_KEY = 0
_ARENA_KEY = 1
_COUNT_KEY = 2
_MOTION_KEY = 3
_CROSSING_KEY = 4


@dataclass(frozen=True)
class MotionParameters(Checked):
    """Parameters that generate the motions of a class; ranges include both ends.

    Speeds are multiples of a step. A profile has a mean speed and a spread, both drawn
    uniformly. The speed of each of its pieces is drawn from the normal distribution
    with these and is at least one step.
    """

    difficulty: str = quantity("easy", "name of the class")
    profiles: int = quantity(200, "number of motions to draw from", "", 1, 10_000)
    obstacles_min: int = quantity(5, "fewest obstacles in a world", "", 1, 500)
    obstacles_max: int = quantity(14, "most obstacles in a world", "", 1, 500)
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
    speed_step_mps: float = quantity(
        0.1, "step of which all speeds are multiples", "m/s", 0.01, 1.0
    )
    spread_min_mps: float = quantity(
        0.0, "smallest standard deviation of a profile's speeds", "m/s", 0.0, 5.0
    )
    spread_max_mps: float = quantity(
        0.08, "largest standard deviation of a profile's speeds", "m/s", 0.0, 5.0
    )
    samples: int = quantity(
        10, "number of x values at which a polynomial is sampled", "", 2, 1000
    )
    radius_m: float = quantity(0.5, "radius of obstacles", "m", 0.01, 10.0)
    height_m: float = quantity(1.0, "height of obstacles", "m", 0.01, 100.0)

    def check_rules(self) -> None:
        """Raise ConfigError for a minimum above its maximum or too few profiles."""
        for low in (
            "obstacles_min",
            "order_min",
            "points_min",
            "speed_min_mps",
            "spread_min_mps",
        ):
            high = low.replace("_min", "_max")
            self.require_order(low, "at most", high)
        self.require_order("obstacles_max", "at most", "profiles")


MOTION_CLASSES = read_presets("barn_worlds", "motion_classes.yaml", MotionParameters())


def motion_class(name: str) -> MotionParameters:
    """Return the parameters of a motion class by name; ConfigError if there is none."""
    if name not in MOTION_CLASSES:
        raise ConfigError(
            f"unknown motion class {name!r:.60}{suggest(name, MOTION_CLASSES)}"
        )
    return MOTION_CLASSES[name]


def build_arena(
    name: str, moving: Sequence[MovingObstacle], provenance: Provenance | None = None
) -> World:
    """Return a DynaBARN arena with moving obstacles and a straight path.

    Args:
        name: Name of the world.
        moving: Its moving obstacles.
        provenance: Source of the obstacles.
    """
    start_row, goal_row = (
        round((x - _CORNER_M[0]) / _CELL_M - 0.5) for x in (START_M[0], GOAL_M[0])
    )
    # DynaBARN's robot drives against x, from the highest row to the lowest.
    rows = np.arange(start_row, goal_row - 1, -1)
    columns = np.full(len(rows), _SHAPE[1] // 2)
    path = np.stack([rows, columns], axis=1)
    return World(
        name,
        np.zeros(_SHAPE, np.bool_),
        path,
        _CELL_M,
        footprint_cells=1,
        provenance=provenance or Provenance(),
        walls=WALLS,
        moving=tuple(moving),
        corner_m=_CORNER_M,
    )


def generate_arenas(
    parameters: MotionParameters, worlds: int, seed: int
) -> list[World]:
    """Return random DynaBARN arenas with moving obstacles of one class.

    Profile k comes from SeedSequence(seed, spawn_key=(0, k)), world k from spawn_key
    (1, k), so neither depends on how many others there are. The obstacles of a world
    are drawn from the profiles without replacement.

    Args:
        parameters: The class.
        worlds: Number of arenas.
        seed: Seed of all randomness.
    """
    # Worlds share profiles, and each is generated when the first world needs it.
    profiles: dict[int, MovingObstacle] = {}
    arenas = []
    for number in range(worlds):
        generator = _generator(seed, _ARENA_KEY, number)
        count = _integer(generator, parameters.obstacles_min, parameters.obstacles_max)
        # Sorting random numbers shuffles; `permutation` may change with NumPy.
        shuffled = np.argsort(generator.random(parameters.profiles), kind="stable")
        moving = []
        for profile in shuffled[:count].tolist():
            if profile not in profiles:
                draws = _generator(seed, _PROFILE_KEY, profile)
                points = _polynomial_points(parameters, draws)
                profiles[profile] = _drive_through(points, parameters, draws, profile)
            # The same object: a data set file stores equal motions once.
            moving.append(profiles[profile])

        provenance = Provenance(
            "generated", parameters=as_dict(parameters), seed=(seed, _ARENA_KEY, number)
        )
        name = f"{parameters.difficulty}_{number}"
        arenas.append(build_arena(name, moving, provenance))
    return arenas


def add_motion(
    world: World, parameters: MotionParameters, seed: int, obstacles: int | None = None
) -> World:
    """Return a copy of a world with added obstacles that move on random polynomials.

    They pass through the obstacles of its grid, as DynaBARN's pass through walls. They
    stay out of the lead-in, so the start stays free.

    Args:
        world: World to copy. It keeps its moving obstacles.
        parameters: The class of motions.
        seed: Seed of all randomness.
        obstacles: Number of obstacles. By default it is drawn from the class.
    """
    left, below, right, above = _field(world)
    center = np.array([left + right, below + above]) / 2.0
    scale = np.array([right - left, above - below]) / SIDE_M
    moving = []
    for number in range(_obstacle_count(parameters, seed, obstacles)):
        generator = _generator(seed, _MOTION_KEY, number)
        points = _polynomial_points(parameters, generator) * scale + center
        moving.append(_drive_through(points, parameters, generator, number))
    return _add_obstacles(world, moving, parameters, (seed, _MOTION_KEY))


def add_crossings(
    world: World, parameters: MotionParameters, seed: int, obstacles: int | None = None
) -> World:
    """Return a copy of a world with added obstacles that cross its path back and forth.

    Each moves straight from one side of the field to the other and back without a rest,
    perpendicular to the direction from start to goal. Its place on the path, speed,
    side and phase are random.

    Args:
        world: World to copy. It keeps its moving obstacles.
        parameters: The class of motions, for the speeds.
        seed: Seed of all randomness.
        obstacles: Number of obstacles. By default it is drawn from the class.
    """
    left, below, right, above = _field(world)
    path = world.path_m()
    extent = np.abs(path[-1] - path[0])
    is_along_x = extent[0] > extent[1]
    moving = []
    for number in range(_obstacle_count(parameters, seed, obstacles)):
        generator = _generator(seed, _CROSSING_KEY, number)
        # The order of draws is part of a world: place, side, speed, phase.
        place = int(generator.random() * len(path))
        x, y = path[place].tolist()
        ends = ((x, below), (x, above)) if is_along_x else ((left, y), (right, y))
        first, last = ends[::-1] if generator.random() < 0.5 else ends
        mean_mps = _uniform(
            generator, parameters.speed_min_mps, parameters.speed_max_mps
        )
        leg_s = math.dist(first, last) / _speed_on_grid(mean_mps, parameters)
        period_s = 2.0 * leg_s
        keys = ((0.0, *first), (leg_s, *last), (period_s, *first))
        phase_s = generator.random() * period_s
        motion = Motion("linear", period_s, keys)
        name = f"crossing_{number}"
        moving.append(_build_obstacle(parameters, name, motion, phase_s))
    return _add_obstacles(world, moving, parameters, (seed, _CROSSING_KEY))


def _field(world: World) -> tuple[float, float, float, float]:
    """Return x_min, y_min, x_max, y_max in m of a world, without lead-in or start area.

    The lead-in is that of BARN worlds, the start area that of DynaBARN's arenas.
    """
    # The square inside of the walls; an arena of DynaBARN also has the start behind it.
    if world.corner_m == _CORNER_M:
        return -_HALF_M, -_HALF_M, _HALF_M, _HALF_M
    left, below, right, above = world.bounds_m
    if world.corner_m is None:
        below = above - world.cols * world.resolution_m
    return left, below, right, above


def _obstacle_count(
    parameters: MotionParameters, seed: int, obstacles: int | None
) -> int:
    """Return `obstacles` or, if None, a random number in the class's range, by seed."""
    if obstacles is not None:
        return obstacles
    generator = _generator(seed, _COUNT_KEY)
    return _integer(generator, parameters.obstacles_min, parameters.obstacles_max)


def _add_obstacles(
    world: World,
    moving: list[MovingObstacle],
    parameters: MotionParameters,
    seed: tuple[int, ...],
) -> World:
    """Return a copy of a world with moving obstacles added, noted in its provenance."""
    provenance = dataclasses.replace(
        world.provenance,
        parameters={**world.provenance.parameters, "motion": as_dict(parameters)},
        seed=(*world.provenance.seed, *seed),
    )
    return dataclasses.replace(
        world, moving=(*world.moving, *moving), provenance=provenance
    )


def _build_obstacle(
    parameters: MotionParameters, name: str, motion: Motion, phase_s: float = 0.0
) -> MovingObstacle:
    """Return a cylinder of the class's size that follows a motion."""
    return MovingObstacle(
        name,
        radius_m=parameters.radius_m,
        height_m=parameters.height_m,
        phase_s=phase_s,
        motion=motion,
    )


def _polynomial_points(
    parameters: MotionParameters, generator: np.random.Generator
) -> Points:
    """Return points (n, 2) in m of a random polynomial, x rising, or raise WorldError.

    That is if 1000 polynomials in a row are undetermined or too short.

    The polynomial is fitted to random points in whole meters (it passes through them if
    there is one more than its order). The motion follows it from its first to its last
    crossing of the border, through the samples at fixed x that lie inside and through
    the random points. It skips the parts where the polynomial leaves the arena.
    """
    for _ in range(_ATTEMPTS):
        order = _integer(generator, parameters.order_min, parameters.order_max)
        count = _integer(generator, parameters.points_min, parameters.points_max)
        shape = (max(order + 1, count), 2)
        random_points = np.floor(generator.random(shape) * (SIDE_M + 1.0)) - _HALF_M
        # A polynomial needs as many different x as it has coefficients.
        if len(set(random_points[:, 0].tolist())) <= order:
            continue

        # Least squares; with one point more than the order it goes through all of them.
        powers = np.vander(random_points[:, 0], order + 1)
        solution, *_ = np.linalg.lstsq(powers, random_points[:, 1], rcond=None)
        coefficients: Floats = solution.astype(np.float64)

        samples = np.linspace(-_HALF_M, _HALF_M, parameters.samples)
        inside = samples[np.abs(np.polyval(coefficients, samples)) <= _HALF_M]
        x = np.concatenate([inside, _border_crossings(coefficients)])
        # Rounding may put a crossing a little outside of the border.
        y = np.clip(np.polyval(coefficients, x), -_HALF_M, _HALF_M)

        points: Points = np.concatenate([np.stack([x, y], axis=1), random_points])
        points = points[np.argsort(points[:, 0], kind="stable")]
        points = points[np.append(True, side_lengths(points) > _CLOSEST_POINTS_M)]
        if len(points) > 1 and side_lengths(points).sum() >= _SHORTEST_PROFILE_M:
            return points

    raise WorldError(
        f"no motion in {_ATTEMPTS} attempts for class {parameters.difficulty!r:.60}"
    )


def _border_crossings(coefficients: Floats) -> Floats:
    """Return least and greatest x in m where a polynomial meets the border, or (0,)."""
    crossings = [
        x for x in (-_HALF_M, _HALF_M) if abs(np.polyval(coefficients, x)) <= _HALF_M
    ]
    for border in (-_HALF_M, _HALF_M):
        # Where the polynomial is at the border, the shifted one has a root.
        shifted = coefficients.copy()
        shifted[-1] -= border
        crossings += [
            float(root.real)
            for root in np.roots(shifted)
            # Real roots come out with an imaginary part by rounding.
            if abs(root.imag) < 1e-9 and abs(root.real) <= _HALF_M
        ]
    return np.array([min(crossings), max(crossings)] if crossings else [])


def _drive_through(
    points: Points,
    parameters: MotionParameters,
    generator: np.random.Generator,
    number: int,
) -> MovingObstacle:
    """Return a cylinder that moves through points (n, 2) in m, from a random end.

    Speeds are random. Times and places are rounded to 0.01, as in DynaBARN's files.
    """
    if generator.random() < 0.5:
        points = points[::-1]
    mean = _uniform(generator, parameters.speed_min_mps, parameters.speed_max_mps)
    spread = _uniform(generator, parameters.spread_min_mps, parameters.spread_max_mps)

    keys = [(0.0, *_round_point(points[0]))]
    time_s = 0.0
    previous_key_s = 0.0
    for before, point in itertools.pairwise(points):
        speed = _speed_on_grid(mean + spread * _normal(generator), parameters)
        distance_m = float(np.hypot(*(point - before)))
        # At least one step of the times in DynaBARN's files.
        time_s += max(distance_m / speed, 0.01)
        key_s = round(time_s, 2)
        # Two keys must not have the same rounded time.
        if key_s > previous_key_s:
            keys.append((key_s, *_round_point(point)))
        previous_key_s = key_s
    motion = Motion("gazebo", keys[-1][0], tuple(keys))
    return _build_obstacle(parameters, f"{parameters.difficulty}_{number}", motion)


def _round_point(point: Floats) -> tuple[float, float]:
    """Return x and y rounded to 0.01 m."""
    return round(float(point[0]), 2), round(float(point[1]), 2)


def _speed_on_grid(speed: float, parameters: MotionParameters) -> float:
    """Return a speed in m/s as a multiple of the class's step, at least one step."""
    step = parameters.speed_step_mps
    return max(round(speed / step), 1) * step


# The functions below use `random` alone, whose stream NumPy is least likely to change.


def _integer(generator: np.random.Generator, low: int, high: int) -> int:
    """Draw and return a random integer from low to high, both included."""
    return low + int(generator.random() * (high - low + 1))


def _uniform(generator: np.random.Generator, low: float, high: float) -> float:
    """Draw and return a random number from low (included) to high (excluded)."""
    return low + (high - low) * float(generator.random())


def _normal(generator: np.random.Generator) -> float:
    """Draw and return a number from the standard normal distribution (Box-Muller)."""
    first, second = generator.random(2).tolist()
    radius = math.sqrt(-2.0 * math.log(1.0 - first))
    return radius * math.cos(2.0 * math.pi * second)


def _generator(seed: int, *key: int) -> np.random.Generator:
    """Return a new generator of random numbers for a seed and a spawn key."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
