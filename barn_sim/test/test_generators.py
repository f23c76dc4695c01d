"""Generators of the children of a seed against those that numpy spawns."""

import numpy as np
import pytest

from barn_sim.generators import generator_of

SEEDS = [0, 1, 2**31, 2**32 - 1, 2**32, 2**62 + 5, *np.random.default_rng(0).integers(0, 2**32, 200).tolist()]


def test_a_child_begins_in_the_state_in_which_numpy_spawns_it():
    for seed in SEEDS:
        for child, sequence in enumerate(np.random.SeedSequence(seed).spawn(4)):
            assert generator_of(seed, child).bit_generator.state == np.random.PCG64(sequence).state


def test_a_negative_seed_is_refused_as_numpy_does():
    with pytest.raises(ValueError, match="non-negative"):
        generator_of(-1, 0)
