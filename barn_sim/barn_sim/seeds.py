"""Random generators of a simulator, each from a child of its seed.

Since every user of randomness has its own child, none affects the draws of another.
"""

import numpy as np

from barn_worlds.worlds.world import World

# New children come last: numbers of the others decide their draws.
LIDAR, ODOMETRY, LOCALIZATION, PHASE, BIAS = range(5)


def generator(seed: int, child: int) -> np.random.Generator:
    """Return a new generator for one user of a simulator's seed, such as the lidar.

    It is that of the child in `SeedSequence(seed).spawn`.

    Args:
        seed: Seed of the simulator.
        child: One of `LIDAR`, `ODOMETRY`, `LOCALIZATION`, `PHASE` and `BIAS`.
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(child,))
    return np.random.Generator(np.random.PCG64(sequence))


def phase_s(world: World, random: bool, seed: int) -> float:
    """Return how far (s) into their motions moving obstacles start; 0 unless `random`.

    Args:
        world: World that may have moving obstacles.
        random: Whether the time is uniform over the longest period, else it is 0.
        seed: Seed of the simulator.
    """
    if not world.moving or not random:
        return 0.0
    longest_s = max(obstacle.motion.period_s for obstacle in world.moving)
    return float(generator(seed, PHASE).uniform(0.0, longest_s))
