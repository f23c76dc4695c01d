"""Fixtures of the tests of several packages: a ROS domain of one's own, and the sample of the original data."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from barn_worlds.ros.domain import reserved_domain

__all__ = ["original_folder", "own_domain"]
SAMPLE = Path(__file__).resolve().parents[3] / "shared" / "barn_original"


@pytest.fixture(scope="module")
def own_domain() -> Iterator[int]:
    """A ROS domain for the tests of a module and the processes that they start, on this host only."""
    with reserved_domain({}) as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield number


@pytest.fixture(scope="session")
def original_folder() -> Path:
    """The folder of original worlds; tests that need it are skipped where it is not."""
    folder = Path(os.environ.get("BARN_ORIGINAL", SAMPLE))
    if not (folder / "grid_files").is_dir():
        pytest.skip(f"no original worlds at {folder}; set BARN_ORIGINAL")
    return folder
