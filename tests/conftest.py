"""Fixtures of the tests of the repository.

Its documentation, examples, images and the tools of its makers.
"""

import pytest
from extra_messages import extra_message_types, with_extra_messages
from shared_fixtures import longest_first, original_folder

from barn_worlds.datasets.dataset import open_dataset

__all__ = ["extra_message_types", "original_folder", "with_extra_messages"]
LONGEST = [
    "test_documented_commands.py",
    "test_way_in.py",
    "test_templates.py",
    "test_faults.py",
    "test_endurance.py",
    "test_nav2.py",
    "test_notebooks.py",
    "test_mutation.py",
]


def pytest_collection_modifyitems(items):
    """Put the longest files of tests first."""
    longest_first(items, LONGEST)


@pytest.fixture(scope="module")
def worlds():
    """Return each sixth world of barn300, by number."""
    dataset = open_dataset("barn300")
    return {number: dataset.load(number) for number in dataset.world_numbers[::6]}
