"""What a reproduction of the paper consists of, in full and as a quick one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.studies.reproduction.paper import REPETITIONS
from barn_worlds.base.config import Checked, quantity


@dataclass(frozen=True)
class ReproduceConfig(Checked):
    """What decides the outcome.

    strata: the worlds, in the order of the data set, are cut into so many parts, one drawn from each; 0 takes all.
    transfer_per_set: new worlds made with each parameter set of Table I, among which those of Fig. 8 are chosen.
    """

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    strata: int = quantity(
        0, "parts of the order of which one world each is taken, 0 for all", minimum=0, maximum=10_000
    )
    repetitions: int = quantity(REPETITIONS, "trials per world and planner", minimum=2, maximum=99)
    seed: int = quantity(0, "all randomness comes from it", minimum=0, maximum=2**31)
    folds: int = quantity(10, "parts that held-out worlds are taken in", minimum=2, maximum=100)
    repeats: int = quantity(5, "how often they are drawn anew", minimum=1, maximum=100)
    transfer_seed: int = quantity(2021, "seed of the new worlds", minimum=0, maximum=2**31)
    transfer_per_set: int = quantity(5, "new worlds per parameter set", minimum=1, maximum=1000)
    transfer_worlds: int = quantity(5, "how many of them Fig. 8 shows", minimum=3, maximum=1000)
    transfer_all: bool = quantity(True, "the others are driven as well, for narrower intervals")


QUICK = ReproduceConfig(strata=40, folds=5, repeats=1, transfer_all=False)


def chosen_worlds(indices: Sequence[int], strata: int, seed: int) -> tuple[int, ...]:
    """Return one number from each of `strata` parts of equal size of numbers in order, drawn from the seed.

    All of them if `strata` is 0 or there are not more.
    """
    if strata == 0 or strata >= len(indices):
        return tuple(indices)
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    parts = np.array_split(np.asarray(indices, np.int64), strata)
    return tuple(int(part[int(generator.random() * len(part))]) for part in parts)
