"""What is random in a simulator, each of a child of its seed, so that one does not affect another."""

import numpy as np

from barn_worlds.worlds.world import World

LIDAR, ODOMETRY, LOCALISATION, PHASE, BIAS = range(5)


def generator(seed: int, child: int) -> np.random.Generator:
    """Return a generator of a child of a seed, as `SeedSequence(seed).spawn` has it."""
    return np.random.Generator(
        np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(child,)))
    )


def phase_s(world: World, random: bool, seed: int) -> float:
    """Return the time into the motions of a world at the start of a simulator with this seed, s.

    Uniform over the longest period if it is random, else 0.
    """
    if not world.moving or not random:
        return 0.0
    return float(
        generator(seed, PHASE).uniform(
            0.0, max(one.motion.period_s for one in world.moving)
        )
    )
