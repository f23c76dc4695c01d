"""What tests of several packages share: a ROS domain of one's own, the sample of the original data, their order."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from barn_worlds.base.garbage import reduce_garbage_collection
from barn_worlds.ros.domain import reserve_domain

__all__ = ["longest_first", "original_folder", "private_domain"]
reduce_garbage_collection()
SAMPLE = Path(__file__).resolve().parents[3] / "shared" / "barn_original"


def longest_first(items: list[pytest.Item], longest: Sequence[str]) -> None:
    """Put the slowest files of tests first, so that no process waits for one at the end.

    Args:
        items: Tests, which are sorted in place.
        longest: Ends of paths of files, the slowest first.
    """

    def place(item: pytest.Item) -> int:
        path = item.path.as_posix()
        for number, ending in enumerate(longest):
            if path.endswith(f"/{ending}"):
                return number
        return len(longest)

    items.sort(key=place)


@pytest.fixture(scope="module")
def private_domain() -> Iterator[int]:
    """A ROS domain for the tests of a module and the processes that they start, on this host only."""
    with reserve_domain({}) as number, pytest.MonkeyPatch.context() as patch:
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
