"""Tables on the terminal, laid out for its width so that no word and no number is broken."""

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text

from barn_eval.analysis.text_table import TextTable

_GAP = 2  # between two columns
_EDGES = 2  # of a table, left and right
_KEPT = "\N{NO-BREAK SPACE}"  # between what stays on one line


def table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, title: str | None = None, caption: str = ""
) -> "FittedTable":
    """Return a table of plain texts, in which brackets are brackets.

    Columns whose name begins with '>' hold numbers and are aligned to the right.
    """
    cells = zip(*rows, strict=True)
    made = (
        _Column(name.removeprefix(">"), tuple(map(str, values)), right=name.startswith(">"))
        for name, values in zip(columns, [*cells] or [()] * len(columns), strict=True)
    )
    return FittedTable(tuple(made), 1, title or "", caption)


def rich_table(found: TextTable) -> "FittedTable":
    """Return a table of results for the terminal."""
    cells = [*zip(*found.rows, strict=True)] or [()] * len(found.columns)
    made = (
        _Column(name, values, right=place >= found.texts)
        for place, (name, values) in enumerate(zip(found.columns, cells, strict=True))
    )
    return FittedTable(tuple(made), found.texts, found.title, found.caption)


@dataclass(frozen=True)
class _Column:
    """A column: its head, its cells, and whether they are aligned to the right."""

    head: str
    cells: tuple[str, ...]
    right: bool = False

    @property
    def widest(self) -> int:
        """The width at which no cell is wrapped; heads are wrapped to their cells, and at words alone."""
        return max(_longest_word(self.head), *(len(line) for cell in self.cells for line in cell.split("\n")), 1)

    @property
    def narrowest(self) -> int:
        """The width of the longest word of cells and head."""
        return max(map(_longest_word, (self.head, *self.cells)), default=1)

    def wrapped(self, width: int) -> "_Column":
        """Return the column in lines of at most a width; only words longer than that are broken."""
        return _Column(_wrap(self.head, width), tuple(_wrap(cell, width) for cell in self.cells), self.right)

    @property
    def width(self) -> int:
        """The length of the longest line."""
        return max(len(line) for text in (self.head, *self.cells) for line in text.split("\n"))


@dataclass(frozen=True)
class FittedTable:
    """A table for any width.

    Where it is too wide, cells are wrapped at words, so that limits go below their estimates; then columns go into a
    second table below, which repeats the first `keys` columns.
    """

    columns: tuple[_Column, ...]
    keys: int
    title: str
    caption: str

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield title, table or tables, and caption."""
        if self.title:
            yield Text(self.title, style="italic")
        for part in self._parts(options.max_width):
            made = Table(header_style="bold", box=SIMPLE_HEAD, pad_edge=False, padding=(0, _GAP - 1, 0, 0))
            for column in part:
                made.add_column(Text(column.head), justify="right" if column.right else "left", no_wrap=True)
            for cells in zip(*(column.cells for column in part), strict=True):
                made.add_row(*map(Text, cells))
            yield made
        if self.caption:
            yield Text(self.caption, style="dim italic")

    def _parts(self, width: int) -> Iterator[list[_Column]]:
        """Yield the columns of each table that is drawn, wrapped to fit a width."""
        keys, rest = list(self.columns[: self.keys]), list(self.columns[self.keys :])
        while rest:
            count = next((n for n in range(len(rest), 1, -1) if _least(keys + rest[:n]) <= width), 1)
            yield _fitted(keys + rest[:count], width)
            rest = rest[count:]
        if len(self.columns) == self.keys:
            yield _fitted(keys, width)


def _fitted(columns: Sequence[_Column], width: int) -> list[_Column]:
    """Return columns that together are no wider than a width if they can be, the widest narrowed first."""
    made = [column.wrapped(column.widest) for column in columns]
    limits = [column.narrowest for column in columns]
    while _total([one.width for one in made]) > width:
        open_ones = [place for place, one in enumerate(made) if one.width > limits[place]]
        if not open_ones:  # not even single words fit: the longest are broken
            open_ones, limits = list(range(len(made))), [1] * len(made)
            if all(one.width == 1 for one in made):
                break
        place = max(open_ones, key=lambda one: made[one].width)
        made[place] = columns[place].wrapped(made[place].width - 1)
    return made


def _least(columns: Sequence[_Column]) -> int:
    return _total([column.narrowest for column in columns])


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + _GAP * (len(widths) - 1) + _EDGES


def _words(text: str) -> str:
    """Return a text in which limits in brackets, and a star with its figure, are one word each."""
    kept = "".join(part.replace(", ", f",{_KEPT}") if part.startswith("[") else part for part in _split_brackets(text))
    return kept.replace(" *", f"{_KEPT}*")


def _split_brackets(text: str) -> Iterator[str]:
    """Yield what is within square brackets, and what is between."""
    while "[" in text and "]" in text[text.index("[") :]:
        begin = text.index("[")
        end = text.index("]", begin) + 1
        yield text[:begin]
        yield text[begin:end]
        text = text[end:]
    yield text


def _longest_word(text: str) -> int:
    return max(map(len, _words(text).replace("\n", " ").split(" ")))


def _wrap(text: str, width: int) -> str:
    lines = []
    for line in _words(text).split("\n"):
        long = max(map(len, line.split(" "))) > width
        lines += textwrap.wrap(line, width, break_long_words=long, break_on_hyphens=False) or [""]
    return "\n".join(lines).replace(_KEPT, " ")
