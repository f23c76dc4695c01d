"""Fixtures of the tests of the repository: its documentation, examples, images and the tools of its makers."""

import pytest
from extra_messages import more_messages, with_more_messages
from shared_fixtures import original_folder

__all__ = ["more_messages", "original_folder", "with_more_messages"]
LONGEST = ["documented_commands", "way_in", "templates", "faults", "endurance", "nav2", "notebooks", "mutation"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first, so that no process waits for one of them at the end."""
    names = [*LONGEST, *(item.path.stem.removeprefix("test_") for item in items)]
    items.sort(key=lambda item: names.index(item.path.stem.removeprefix("test_")))
