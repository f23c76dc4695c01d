"""What several tests need: the sample of the original data, and a small world."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from barn_worlds.ros.domain import reserved_domain
from barn_worlds.worlds.world import World

settings.register_profile("suite", deadline=None, max_examples=60, derandomize=True)
settings.load_profile("suite")

SAMPLE = Path(__file__).parents[2].parent / "shared" / "barn_original"


@pytest.fixture(scope="session")
def original_folder() -> Path:
    """The folder of original worlds; tests that need it are skipped where it is not."""
    folder = Path(os.environ.get("BARN_ORIGINAL", SAMPLE))
    if not (folder / "grid_files").is_dir():
        pytest.skip(f"no original worlds at {folder}; set BARN_ORIGINAL")
    return folder


@pytest.fixture
def small_world() -> World:
    """A world of 9 x 12 cells with a hollow block, side walls and a straight path."""
    grid = np.zeros((9, 12), bool)
    grid[[0, -1]] = True
    grid[1:4, 4:9] = True
    path = np.stack([np.full(12, 6), np.arange(12)], axis=1)
    return World("small", grid, path, footprint_cells=3)


@pytest.fixture(scope="module")
def own_domain() -> Iterator[int]:
    """A ROS domain for the tests of a module and the processes that they start, on this host only."""
    with reserved_domain({}) as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield number
