"""Worlds of a wanted difficulty, drawn and generated."""

import numpy as np
import pytest

from barn_eval.learning.curriculum import Curriculum, CurriculumConfig, sample
from barn_worlds.base.errors import ConfigError, WorldError
from barn_worlds.worlds.dataset import Dataset
from barn_worlds.worlds.generate import TABLE_I
from barn_worlds.worlds.world import World

COUNT = 11


def filled_share(world):
    """A stand-in for difficulty."""
    return float(world.grid.mean())


@pytest.fixture
def dataset():
    """Eleven worlds; world k has ten minus k rows filled, so that the last is the easiest by `filled_share`."""

    def world(index):
        grid = np.zeros((30, 30), np.bool_)
        grid[1 : COUNT - index] = True
        return World(f"world_{index}", grid, np.stack([np.full(30, 25), np.arange(30)], axis=1))

    return Dataset("made", {index: (lambda index=index: world(index)) for index in range(COUNT)})


def test_worlds_are_drawn_up_to_the_level_and_repeat_from_the_seed(dataset):
    curriculum = Curriculum(dataset, CurriculumConfig(first_level=0.3))
    assert curriculum.between(0.0, 0.0) == (0,) and curriculum.between(1.0, 1.0) == (10,)
    assert curriculum.between(0.5, 0.5) == (5,) and curriculum.between(0.2, 0.4) == (2, 3, 4)
    first, second = np.random.default_rng(4), np.random.default_rng(4)
    drawn = [curriculum.draw(first) for _ in range(200)]
    assert [index for index, _ in drawn] == [curriculum.draw(second)[0] for _ in range(200)]
    assert {index for index, _ in drawn} == {0, 1, 2, 3}
    assert all(world.checksum == dataset.load(index).checksum for index, world in drawn[:5])
    assert {curriculum.draw(first, 0.9, 1.0)[0] for _ in range(50)} == {9, 10}


def test_the_level_rises_with_success_only(dataset):
    curriculum = Curriculum(dataset, CurriculumConfig(first_level=0.2, step=0.5, promotion_rate=0.75, window=4))
    assert [curriculum.record(success) for success in (True, False, True)] == [False] * 3
    assert not curriculum.record(False) and curriculum.level == 0.2
    assert not curriculum.record(True)  # of the last four, two
    assert curriculum.record(True) and curriculum.level == 0.7
    assert not any(curriculum.record(True) for _ in range(3))  # counted anew
    assert curriculum.record(True) and curriculum.level == 1.0
    assert not any(curriculum.record(True) for _ in range(8)) and curriculum.level == 1.0


def test_a_range_without_worlds_is_told(dataset):
    with pytest.raises(WorldError, match=r"made: none of 11 worlds has a level of 0\.31 to 0\.39"):
        Curriculum(dataset).draw(np.random.default_rng(0), 0.31, 0.39)


def test_generated_worlds_have_the_wanted_difficulty():
    easy_sets = TABLE_I[3:6]
    low, high = 0.16, 0.2

    def made(seed):
        return sample(filled_share, (low, high), None, 1, seed, sets=easy_sets)[0]

    world, found = made(1)
    assert low <= found <= high and found == filled_share(world)
    assert world.provenance.source == "generated" and len(world.path) >= 30
    assert made(1)[0].checksum == world.checksum != made(2)[0].checksum


def test_a_difficulty_out_of_reach_is_told(dataset):
    with pytest.raises(WorldError, match=r"none of 5 generated worlds has a difficulty of 2 to 3; they have 0\.\d+ to"):
        sample(filled_share, (2.0, 3.0), None, 1, 0, sets=TABLE_I[3:6], attempts=5)
    with pytest.raises(ConfigError, match="LOW at most HIGH, got 3:2"):
        sample(filled_share, (3.0, 2.0), dataset, 1, 0)


def test_different_worlds_of_a_data_set_are_drawn_by_difficulty(dataset):
    def drawn(seed, count=3):
        found = sample(filled_share, (0.1, 0.25), dataset, count, seed)
        return [(world.name, value) for world, value in found]

    assert drawn(0) == drawn(0) and len({name for name, _ in drawn(0)}) == 3
    assert len({tuple(drawn(seed)) for seed in range(10)}) > 1
    shares = {f"world_{index}": filled_share(dataset.load(index)) for index in range(COUNT)}
    assert all(value == shares[name] and 0.1 <= value <= 0.25 for name, value in drawn(3))
    with pytest.raises(WorldError, match=r"made: 5 of 11 worlds have a difficulty of 0\.1 to 0\.25, 6 are wanted"):
        drawn(0, 6)
