"""The 50 original worlds of the sample, where they are there, and a sixth of barn300."""

from typing import NamedTuple

import numpy as np
import pytest
from shared_fixtures import original_folder

from barn_worlds.datasets.dataset import open_dataset

__all__ = ["original_folder"]


class Original(NamedTuple):
    """One world of the original data set and what was published for it."""

    grid: np.ndarray
    cspace: np.ndarray
    path: np.ndarray
    published: np.ndarray
    corrected: list[float]


@pytest.fixture(scope="session")
def worlds():
    dataset = open_dataset("barn300")
    return {index: dataset.load(index) for index in dataset.world_numbers[::6]}


@pytest.fixture(scope="session")
def originals(original_folder):
    table = original_folder / "metrics_corrected.csv"
    if not table.is_file():
        pytest.skip(f"no {table}")
    worlds = []
    for number, *corrected in np.loadtxt(table, delimiter=",", skiprows=1):
        files = [
            original_folder / f"{kind}_files" / f"{kind}_{number:.0f}.npy"
            for kind in ("grid", "cspace", "path", "metrics")
        ]
        grid, cspace, path, published = map(np.load, files)
        worlds.append(Original(grid == 1, cspace == 1, path, published, corrected))
    return worlds
