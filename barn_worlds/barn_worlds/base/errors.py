"""Errors that a user can cause. The message is one line that says what to change."""

import difflib
import logging
import math
import multiprocessing
import re
import reprlib
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from functools import cache
from os import PathLike
from types import FunctionType
from typing import Any

logger = logging.getLogger(__name__)

# Longest texts in a message, in characters.
_LONGEST_VALUE = 120
_LONGEST_ERROR = 200
_LONGEST_MESSAGE = 1000
# Of a longer message, how much of its beginning and its end remains.
_HEAD = 650
_TAIL = 300
_OBJECT = re.compile(r":? <[\w.]+ object at 0x\w+>")
_MOST_NAMES = 20  # in a list of known names
_PLAIN = (bool, bytes, complex, float, range, type(None))


class _Repr(reprlib.Repr):
    """Formats plain data as Python does, other objects without class and address.

    Users' values may be huge and deeply nested, so only a part of them is formatted.
    """

    def repr_instance(self, x: Any, level: int) -> str:
        """Return text of a path, array or function; else "a Python object"."""
        if type(x) in _PLAIN:
            return super().repr_instance(x, level)
        if hasattr(x, "tolist"):
            return self.repr1(x.tolist(), level)
        if isinstance(x, PathLike):
            return self.repr1(str(x), level)
        if isinstance(x, FunctionType):
            return f"function {x.__name__}"
        return "a Python object"


_REPR = _Repr()
_REPR.maxlevel = 3
_REPR.maxstring = _REPR.maxother = _LONGEST_VALUE


class ExitCode(IntEnum):
    """Exit codes of commands; docs/troubleshooting.md explains them in a table."""

    DONE = 0
    FINDINGS = 1
    REFUSED = 2
    NOT_SCORED = 3
    WORSE = 4
    NOT_SHOWN = 5
    INTERRUPTED = 130
    READER_GONE = 141


class BarnError(Exception):
    """A mistake in the input: path or parameter, its value and what is allowed."""

    exit_code = ExitCode.REFUSED  # of the command that the error ends

    def __str__(self) -> str:
        """Return the message, without its middle if it is above 1000 characters."""
        text = super().__str__()
        if len(text) <= _LONGEST_MESSAGE:
            return text
        return f"{text[:_HEAD]} ... {text[-_TAIL:]}"


class ConfigError(BarnError):
    """A configuration value or key that is not allowed."""


class FindingError(ConfigError):
    """The content of a file that a command checked is wrong."""

    exit_code = ExitCode.FINDINGS


class WorldError(BarnError):
    """A world, map or data set that cannot be read or is malformed."""


class MessageError(BarnError):
    """A ROS message that cannot be read."""


class ModelError(BarnError):
    """Weights that cannot be read, or a model that cannot be trained."""


class StoreError(BarnError):
    """A result or table that cannot be written; files on disk stay intact."""


class TippedError(BarnError):
    """The simulated robot has tipped over."""


class BagError(BarnError):
    """A recording that cannot be read or written."""


@contextmanager
def convert_os_errors(kind: type[BarnError], subject: object) -> Iterator[None]:
    """Convert an OSError in the `with` block to `kind`, with message "SUBJECT: reason".

    Args:
        kind: Class to raise.
        subject: Beginning of the message, such as the path and the failed operation.

    Raises:
        BarnError: Of the class `kind`, if the block raises OSError.
    """
    try:
        yield
    except OSError as error:
        # `strerror` has no error number and no path; `subject` names the path.
        raise kind(f"{subject}: {error.strerror or error}") from None


@cache
def note(text: str) -> None:
    """Log a warning, each text once; worker processes log nothing.

    If the program has set no log handler, Python prints the warning on stderr.
    """
    if multiprocessing.parent_process() is None:
        logger.warning("%s", text)


def parse_number(text: str) -> float:
    """Return text as float; NaN if it is none, or one for Python only, such as 1_000."""
    try:
        return float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        return math.nan


def read_numbers(text: str | None, count: int, where: str) -> list[float]:
    """Return `count` numbers within 1e6 from text; WorldError for anything else.

    Args:
        text: Numbers separated by blanks.
        count: Required number of them.
        where: What the text is, to begin an error message with.

    Raises:
        WorldError: If there are more or fewer, or one is not a number below 1e6.
    """
    numbers = [parse_number(word) for word in (text or "").split()]
    # NaN fails the comparison.
    if len(numbers) != count or not all(abs(number) < 1e6 for number in numbers):
        allowed = "a finite number" if count == 1 else f"{count} finite numbers"
        raise WorldError(f"{where} must be {allowed}, got {text!r:.60}")
    return numbers


def find_duplicates(names: Iterable[Any]) -> list[Any]:
    """Return the names that occur more than once."""
    return [name for name, count in Counter(names).items() if count > 1]


def refuse_duplicates(names: Iterable[Any]) -> None:
    """Raise ValueError with the first name that occurs more than once."""
    for name in find_duplicates(names):
        raise ValueError(f"{name!r:.60} occurs twice; keep only one")


def list_names(names: Iterable[object]) -> str:
    """Return the first twenty names, joined by commas; ", ..." stands for the rest."""
    texts = [_name_text(name) for name in names]
    ellipsis = ", ..." if len(texts) > _MOST_NAMES else ""
    return ", ".join(texts[:_MOST_NAMES]) + ellipsis


def format_value(value: object) -> str:
    """Return the repr of a value on one line, cut after about 120 characters."""
    try:
        text = " ".join(_REPR.repr(value).split())
    except ValueError:
        # Python refuses the repr of an integer of more than 4300 digits.
        return "a number of thousands of digits"
    return text if len(text) <= _LONGEST_VALUE else text[:_LONGEST_VALUE] + "..."


def format_error(error: object) -> str:
    """Return an error's message on one line, cut at 200 characters; never empty.

    Control characters, which would steer a terminal, are left out, and so are objects
    that a library names by class and address.
    """
    text = _OBJECT.sub("", join_lines(str(error)))
    return text[:_LONGEST_ERROR] or "no reason is known"


def strip_controls(text: str) -> str:
    """Return text without nonprinting characters; white space stays."""
    return "".join(c for c in text if c.isprintable() or c.isspace())


def join_lines(text: str) -> str:
    """Return text on one line, without nonprinting characters."""
    return " ".join(strip_controls(text).split())


def suggest(name: object, candidates: Iterable[object]) -> str:
    """Return "; did you mean ...?" or "; known: ..." to append to an error message.

    Args:
        name: What the user wrote.
        candidates: Names that exist. Of dotted names, those with the same parent as
            `name` come first.

    Returns:
        "; did you mean 'dwa'?" if a name is similar, else "; known: dwa, eband".
    """
    names = sorted(map(_name_text, candidates))
    # Dozens of names of other parents would hide the few that the user can mean.
    siblings = _siblings(_name_text(name), names)
    return suggest_similar(name, names) or f"; known: {list_names(siblings) or 'none'}"


def suggest_similar(name: object, candidates: Iterable[object]) -> str:
    """Return "; did you mean 'dwa'?" with up to three similar names, "" without any.

    Args:
        name: What the user wrote.
        candidates: Names that exist, dotted or not.
    """
    text = _name_text(name)
    names = sorted(map(_name_text, candidates))
    similar = (
        # A user may leave out the parents of a dotted name.
        [candidate for candidate in names if candidate.endswith(f".{text}")][:3]
        or _most_similar(text, _siblings(text, names), 0.6)
        # Under another parent, a name must be closer to count as meant.
        or _most_similar(text, names, 0.8)
    )
    return f"; did you mean {' or '.join(map(repr, similar))}?" if similar else ""


def _name_text(name: object) -> str:
    """Return a name, cut after 120 characters; of an object but text, its repr."""
    text = name if isinstance(name, str) else format_value(name)
    return text[:_LONGEST_VALUE]


def _siblings(name: str, names: list[str]) -> list[str]:
    """Return the names with the same dotted parent as `name`; all names if none has."""
    parent = name.rpartition(".")[0]
    return [other for other in names if other.rpartition(".")[0] == parent] or names


def _most_similar(name: str, names: list[str], cutoff: float) -> list[str]:
    """Return a list with the one name whose last part is most similar, or no name."""
    by_last_part = {candidate.rpartition(".")[2]: candidate for candidate in names}
    last_part = name.rpartition(".")[2]
    # Parents are long and alike; the last part of a name is what users mistype.
    matches = difflib.get_close_matches(last_part, by_last_part, n=1, cutoff=cutoff)
    return [by_last_part[match] for match in matches]
