from contextlib import ExitStack, closing

import numpy as np
import pytest
from driving import world_with
from shared_fixtures import private_domain

from barn_sim.contact.scene import ScenePool
from barn_sim.simulator import Simulator

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
    return world_with()


@pytest.fixture(scope="session")
def walled_world():
    """A world whose first column of cells is filled, but for the path's row."""
    return world_with(np.s_[:15, 0], np.s_[16:, 0])
