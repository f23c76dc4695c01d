"""Random generators of a simulator, each from a child of its seed.

Since every user of randomness has its own child, none affects the draws of another.
"""

import math

import numpy as np

from barn_sim.config import SimulatorConfig
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import Pose2D
from barn_worlds.geometry.bodies import moving_bodies
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.worlds.world import World

# New children come last: numbers of the others decide their draws.
LIDAR, ODOMETRY, LOCALIZATION, PHASE, BIAS, UNSEEN = range(6)

# Phases that are drawn until one leaves the start alone.
_PHASES = 1000
_LOOK_PERIOD_S = 0.1


def generator(seed: int, child: int) -> np.random.Generator:
    """Return a new generator for one user of a simulator's seed, such as the lidar.

    It is that of the child in `SeedSequence(seed).spawn`.

    Args:
        seed: Seed of the simulator.
        child: One of `LIDAR`, `ODOMETRY`, `LOCALIZATION`, `PHASE`, `BIAS` and `UNSEEN`.
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(child,))
    return np.random.Generator(np.random.PCG64(sequence))


def phase_s(world: World, config: SimulatorConfig, start: Pose2D, seed: int) -> float:
    """Return moving obstacles' start time (s), random or 0; ConfigError if none fits.

    Args:
        world: World that may have moving obstacles.
        config: Says whether the time is drawn, uniform over the longest period, or 0,
            and for how long no obstacle may then reach a robot at rest.
        start: Pose of the robot in the map frame.
        seed: Seed of the simulator.

    Raises:
        ConfigError: If an obstacle reaches the robot too soon in 1000 drawn phases.
    """
    obstacles = config.obstacles
    if not world.moving or not obstacles.random_phase:
        return 0.0
    longest_s = max(obstacle.motion.period_s for obstacle in world.moving)
    rng = generator(seed, PHASE)
    outline = contact_footprint(config.chassis)
    for _ in range(_PHASES):
        phase = float(rng.uniform(0.0, longest_s))
        hit_s = time_until_hit(world, outline, start, phase, obstacles.clear_start_s)
        if math.isinf(hit_s):
            return phase
    raise ConfigError(
        f"world {world.name}: an obstacle reaches the start within"
        f" {obstacles.clear_start_s:g} s (clear_start_s) in each of {_PHASES} phases"
    )


def time_until_hit(
    world: World, outline: Footprint, start: Pose2D, phase_s: float, limit_s: float
) -> float:
    """Return when (s) a moving obstacle first hits a still robot; inf after limit_s.

    Args:
        world: World with moving obstacles.
        outline: What can touch of the robot, in base_link.
        start: Pose of the robot in the map frame.
        phase_s: Time into the motions at the start.
        limit_s: Time from the start to search, in steps of 0.1 s.

    Returns:
        Time from the start, infinite without a touch within the limit.
    """
    shapes = moving_bodies(world.tracks, phase_s).shapes()
    times_s = np.arange(0.0, limit_s, _LOOK_PERIOD_S)
    positions, _ = world.tracks.over(phase_s + times_s)
    for k, time_s in enumerate(times_s.tolist()):
        shapes[:, :2] = positions[k]
        if outline.gaps(shapes, *start.numbers).min() <= 0.0:
            return float(time_s)
    return math.inf
