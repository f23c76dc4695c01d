"""How far into their motions the moving obstacles of a trial are at its start."""

from barn_sim.generators import generator_of
from barn_worlds.world import World

_CHILD = 3  # of the seed; those before are the simulator's


def phase_s(world: World, random: bool, seed: int) -> float:
    """Return the time into the motions of a world at the start of a simulator with this seed, s.

    Uniform over the longest period if it is random, else 0.
    """
    if not world.moving or not random:
        return 0.0
    rng = generator_of(seed, _CHILD)
    return float(rng.uniform(0.0, max(one.motion.period_s for one in world.moving)))
