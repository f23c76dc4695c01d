"""Fixtures of the tests of the repository: its documentation, examples, images and the tools of its makers."""

import pytest
from extra_messages import more_messages, with_more_messages

__all__ = ["more_messages", "with_more_messages"]
# What takes longest, so that it is begun first and no process waits for it at the end.
LONGEST = ("test_way_in", "test_templates", "test_python_runs_as_it_is_shown", "test_endurance", "test_faults")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put the longest tests first, and keep those of a file together but for examples, which share nothing."""
    items.sort(key=lambda item: not item.name.startswith(LONGEST) and item.path.stem not in LONGEST)
    if config.pluginmanager.hasplugin("xdist"):
        for item in (one for one in items if not one.name.startswith(LONGEST)):
            item.add_marker(pytest.mark.xdist_group(item.path.stem))
