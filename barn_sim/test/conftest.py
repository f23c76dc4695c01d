from contextlib import ExitStack, closing

import numpy as np
import pytest
from shared_fixtures import private_domain

from barn_sim.contact.scene import ScenePool
from barn_sim.simulator import Simulator
from barn_worlds.worlds.world import World

__all__ = ["private_domain"]


@pytest.fixture(scope="module")
def scenes():
    """Physics clients for many simulators."""
    with closing(ScenePool()) as pool:
        yield pool


@pytest.fixture
def simulators():
    """Make simulators, which are closed in the end."""
    with ExitStack() as stack:

        def make(*arguments, **options):
            return stack.enter_context(closing(Simulator(*arguments, **options)))

        yield make


@pytest.fixture(scope="session")
def empty_world():
    """A world with nothing but its containment."""
    path = np.array([[15, column] for column in range(30)])
    return World("empty", np.zeros((30, 30), np.bool_), path)


@pytest.fixture(scope="session")
def walled_world():
    """A world whose first column of cells is filled, but for the path's row."""
    grid = np.zeros((30, 30), np.bool_)
    grid[:, 0] = True
    grid[15, 0] = False
    return World("walled", grid, np.array([[15, column] for column in range(30)]))
