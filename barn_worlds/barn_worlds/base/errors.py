"""The errors that a user can cause. Each is one line that says what to change."""

import difflib
import reprlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

_LONGEST_NAME, _LONGEST_SHOWN, _LONGEST_ERROR = 60, 120, 200
_LONGEST_MESSAGE, _HEAD, _TAIL = 1000, 650, 300
_MOST_LISTED, _MOST_HINTS = 20, 3
_REPR = reprlib.Repr()
_REPR.maxlevel = 3
_REPR.maxstring = _REPR.maxother = _LONGEST_SHOWN


class BarnError(Exception):
    """A mistake in the input: the message names the path or parameter, its value and what is allowed.

    Of a message that is too long, whatever is in it, beginning and end are left.
    """

    def __str__(self) -> str:
        """Return the message."""
        text = super().__str__()
        return (
            text
            if len(text) <= _LONGEST_MESSAGE
            else f"{text[:_HEAD]} ... {text[-_TAIL:]}"
        )


class ConfigError(BarnError):
    """A configuration value or key that is not allowed."""


class WorldError(BarnError):
    """A world, map or data set that cannot be read or is malformed."""


class MessageError(BarnError):
    """A ROS message that cannot be read."""


class ModelError(BarnError):
    """Weights that cannot be read, trials that no model can be made of, or a library that training lacks."""


class StoreError(BarnError):
    """A result or table that cannot be written; what was written before is whole."""


class BagError(BarnError):
    """A recording that cannot be read or written."""


@contextmanager
def convert_os_errors(kind: type[BarnError], what: object) -> Iterator[None]:
    """Raise an OSError of the block as an error of that kind, whose one line begins with `what`."""
    try:
        yield
    except OSError as error:
        raise kind(f"{what}: {error.strerror or error}") from None


def format_value(value: object) -> str:
    """Return a value for a message: its repr on one line, cut if it is long."""
    try:
        text = " ".join(_REPR.repr(value).split())
    except ValueError:  # Python gives no repr for an integer of thousands of digits
        return "a number of thousands of digits"
    return text if len(text) <= _LONGEST_SHOWN else text[:_LONGEST_SHOWN] + "..."


def format_error(error: object) -> str:
    """Return the message of an error of a library as one line, cut if it is long; its kind where it has none."""
    return " ".join(str(error).split())[:_LONGEST_ERROR] or type(error).__name__


def suggest(name: object, known: Iterable[object]) -> str:
    """Return what to add to a message about an unknown name: the near one, or else the known ones.

    So "; did you mean 'dwa'?" or "; known: dwa, eband". Among dotted names, those under the same parent count first.
    """
    names = sorted(str(key)[:_LONGEST_NAME] for key in known)
    wanted = (name if isinstance(name, str) else format_value(name))[:_LONGEST_SHOWN]
    siblings = [
        one for one in names if one.rpartition(".")[0] == wanted.rpartition(".")[0]
    ] or names
    near = [one for one in names if one.endswith(f".{wanted}")] or _alike(
        wanted, siblings, 0.6
    )
    near = near or _alike(wanted, names, 0.8)
    if near:
        return "; did you mean " + " or ".join(map(repr, near[:_MOST_HINTS])) + "?"
    more = ", ..." if len(siblings) > _MOST_LISTED else ""
    return f"; known: {', '.join(siblings[:_MOST_LISTED])}{more}"


def _alike(wanted: str, names: list[str], cutoff: float) -> list[str]:
    """Return the name whose last part is most like that of `wanted`, in a list; an empty list if none is alike."""
    by_end = {name.rpartition(".")[2]: name for name in names}
    return [
        by_end[end]
        for end in difflib.get_close_matches(
            wanted.rpartition(".")[2], by_end, n=1, cutoff=cutoff
        )
    ]
