"""What several tests need."""

import numpy as np
import pytest
from hypothesis import settings
from shared_fixtures import original_folder, private_domain

from barn_worlds.worlds.world import World

__all__ = ["original_folder", "private_domain"]
settings.register_profile("suite", deadline=None, max_examples=60, derandomize=True)
settings.load_profile("suite")


@pytest.fixture
def small_world() -> World:
    """A world of 9 x 12 cells with a hollow block, side walls and a straight path."""
    grid = np.zeros((9, 12), bool)
    grid[[0, -1]] = True
    grid[1:4, 4:9] = True
    path = np.stack([np.full(12, 6), np.arange(12)], axis=1)
    return World("small", grid, path, footprint_cells=3)
