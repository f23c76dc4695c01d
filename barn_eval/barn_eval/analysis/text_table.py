"""Tables of text for the terminal, pages and files, and helpers for their words."""

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "{": r"\{",
        "}": r"\}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
        **{character: f"\\{character}" for character in "#$%&_"},
    }
)


@dataclass(frozen=True)
class TextTable:
    """A table whose cells are text as a reader sees it."""

    name: str
    """Name of the table's files, without an ending."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    texts: int = 1
    """Number of columns on the left with words; the others have figures."""

    caption: str = ""

    def csv(self) -> str:
        """Return columns and rows as CSV text; title and caption are left out."""
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows([self.columns, *self.rows])
        return buffer.getvalue()


def latex_text(text: str) -> str:
    """Return text on one line, escaped for LaTeX, with a math minus before digits."""
    escaped = one_line(text).translate(_LATEX)
    # A hyphen in a name or a range stays a hyphen.
    return re.sub(r"(?<![\w.-])-(?=\d)", "$-$", escaped)


def count_noun(number: int, noun: str) -> str:
    """Return a number with its noun, such as "1 trial" or "2 trials".

    Args:
        number: How many there are.
        noun: What they are, in the singular.
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def join_names(names: Sequence[str], word: str = "and") -> str:
    """Return names joined by commas and a last word, such as "a, b and c".

    Args:
        names: What is listed.
        word: The word before the last name.
    """
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {word} {names[-1]}"


def one_line(text: str) -> str:
    """Return text with each run of line breaks and control characters made one space."""
    return re.sub(r"[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]+", " ", text)
