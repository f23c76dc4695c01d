"""Tables on the terminal, laid out for its width so that no word and no number is broken."""

import re
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

Column = Sequence[str]  # a head and its cells


@dataclass(frozen=True)
class FittedTable:
    """A table for any width.

    Where it is too wide, cells are wrapped at words, so that limits go below their estimates; then columns go into a
    second table below, which repeats the first `keys` columns. right: the columns that are aligned to the right.
    """

    columns: tuple[Column, ...]
    right: tuple[bool, ...]
    keys: int
    title: str
    caption: str

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        """Yield title, table or tables, and caption."""
        if self.title:
            yield Text(self.title, style="italic")
        for part in self._parts(options.max_width):
            made = Table(
                header_style="bold",
                box=SIMPLE_HEAD,
                pad_edge=False,
                padding=(0, _GAP - 1, 0, 0),
            )
            fitted = _fitted([self.columns[place] for place in part], options.max_width)
            for place, (head, *_) in zip(part, fitted, strict=True):
                made.add_column(
                    Text(head),
                    justify="right" if self.right[place] else "left",
                    no_wrap=True,
                )
            for cells in list(zip(*fitted, strict=True))[1:]:
                made.add_row(*map(Text, cells))
            yield made
        if self.caption:
            yield Text(self.caption, style="dim italic")

    def _parts(self, width: int) -> Iterator[list[int]]:
        """Yield the places of the columns of each table that is drawn."""
        narrowest = [max(map(_longest_word, column)) for column in self.columns]
        keys, rest = list(range(self.keys)), list(range(self.keys, len(self.columns)))
        while True:
            fits = (
                n
                for n in range(len(rest), 1, -1)
                if _total([narrowest[k] for k in keys + rest[:n]]) <= width
            )
            count = next(fits, 1)
            yield keys + rest[:count]
            rest = rest[count:]
            if not rest:
                return


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    title: str = "",
    caption: str = "",
) -> FittedTable:
    """Return a table of plain texts, in which brackets are brackets.

    Columns whose name begins with '>' hold numbers and are aligned to the right.
    """
    heads = [name.removeprefix(">") for name in columns]
    made = tuple(zip(heads, *(map(str, row) for row in rows), strict=True))
    return FittedTable(
        made, tuple(name.startswith(">") for name in columns), 1, title, caption
    )


def rich_table(found: TextTable) -> FittedTable:
    """Return a table of results for the terminal."""
    right = tuple(place >= found.texts for place in range(len(found.columns)))
    columns = tuple(zip(found.columns, *found.rows, strict=True))
    return FittedTable(columns, right, found.texts, found.title, found.caption)


def _fitted(columns: Sequence[Column], width: int) -> list[Column]:
    """Return columns that together are no wider than a width if they can be, the widest narrowed first."""
    made = [
        _wrapped(column, max(_longest_word(column[0]), _width(column[1:])))
        for column in columns
    ]
    narrowest = [max(map(_longest_word, column)) for column in columns]
    while _total(list(map(_width, made))) > width:
        wide = [
            place
            for place, column in enumerate(made)
            if _width(column) > narrowest[place]
        ]
        if wide:
            place = max(wide, key=lambda one: _width(made[one]))
            made[place] = _wrapped(columns[place], _width(made[place]) - 1)
        elif max(narrowest) > 1:  # not even single words fit: the longest are broken
            narrowest = [1] * len(columns)
        else:
            break
    return made


def _width(texts: Column) -> int:
    return max((len(line) for text in texts for line in text.split("\n")), default=1)


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + _GAP * (len(widths) - 1) + _EDGES


def _words(text: str) -> str:
    """Return a text in which limits in brackets, and a star with its figure, are one word each."""
    kept = re.sub(
        r"\[[^]]*\]", lambda limits: limits[0].replace(", ", f",{_KEPT}"), text
    )
    return kept.replace(" *", f"{_KEPT}*")


def _longest_word(text: str) -> int:
    return max(map(len, re.split("[ \n]", _words(text))))


def _wrapped(column: Column, width: int) -> Column:
    """Return a column in lines of at most a width; only words longer than that are broken."""
    wrap = textwrap.TextWrapper(max(width, 1), break_on_hyphens=False).fill
    return [
        "\n".join(map(wrap, _words(text).split("\n"))).replace(_KEPT, " ")
        for text in column
    ]
