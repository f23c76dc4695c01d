"""What tests expect of the suite's errors."""

from contextlib import contextmanager

import pytest

from barn_worlds.base.errors import ConfigError


@contextmanager
def refused(pattern, kind=ConfigError, longest=400):
    """Expect an error of one short line with a pattern in it."""
    with pytest.raises(kind, match=pattern) as caught:
        yield caught
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < longest
