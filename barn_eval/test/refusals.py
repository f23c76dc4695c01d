"""What tests expect of the suite's errors."""

from contextlib import contextmanager

import pytest

from barn_worlds.base.errors import ConfigError


@contextmanager
def refused(words, error=ConfigError):
    """Expect an error of one line in which a regular expression is found."""
    with pytest.raises(error, match=words) as caught:
        yield caught
    assert "\n" not in str(caught.value)
