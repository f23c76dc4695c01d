"""How far into their motions the moving obstacles of a trial are at its start."""

import numpy as np

from barn_worlds.worlds.world import World

_CHILD = 3  # of the seed; those before are the simulator's


def phase_s(world: World, random: bool, seed: int) -> float:
    """Return the time into the motions of a world at the start of a simulator with this seed, s.

    Uniform over the longest period if it is random, else 0.
    """
    if not world.moving or not random:
        return 0.0
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(_CHILD + 1)[_CHILD])
    return float(rng.uniform(0.0, max(one.motion.period_s for one in world.moving)))
