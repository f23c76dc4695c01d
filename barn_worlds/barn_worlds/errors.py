"""The errors that a user can cause, each worded as one line that says what to change."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class BarnError(Exception):
    """A mistake in the input: the message names the path or parameter, its value and what is allowed."""


class ConfigError(BarnError):
    """A configuration value or key that is not allowed."""


class WorldError(BarnError):
    """A world, map or data set that cannot be read, or that is not what it should be."""


class BagError(BarnError):
    """A recording that cannot be read or written."""


def suggest(name: object, known: Iterable[object]) -> str:
    """Return what to add to a message about an unknown name.

    The near one, if there is one, else all known names: "; did you mean 'dwa'?" or "; known: dwa, eband".
    """
    names = sorted(str(key) for key in known)
    near = difflib.get_close_matches(str(name), names, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(names)}"
