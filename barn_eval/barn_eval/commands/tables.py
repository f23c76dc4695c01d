"""Tables that fit the width of a terminal without breaking a word or a number."""

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, JustifyMethod, RenderResult
from rich.table import Table
from rich.text import Text

from barn_eval.analysis.text_table import TextTable
from barn_worlds.base.config import fields_of

_GAP = 2  # spaces between two columns
_MARGINS = 2  # spaces left and right of a table
# textwrap does not break lines here, nor does it appear in output.
_NO_BREAK = "\N{NO-BREAK SPACE}"

# A heading and its cells.
Column = Sequence[str]


@dataclass(frozen=True)
class FittedTable:
    """A table for any width.

    In a narrow terminal, cells are wrapped between words, so that limits go below their
    estimates. If that is not enough, columns move to a second table below.
    """

    columns: tuple[Column, ...]

    # Of each column, whether it is aligned to the right.
    right: tuple[bool, ...]

    # Number of leading columns that each part repeats.
    keys: int

    title: str
    caption: str

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        """Yield title, one or more tables that fit the width, and caption, for rich."""
        if self.title:
            yield Text(self.title, style="italic")
        for places in self._divide(options.max_width):
            yield self._render([*range(self.keys), *places], options.max_width)
        if self.caption:
            yield Text(self.caption, style="dim italic")

    def _render(self, places: Sequence[int], width: int) -> Table:
        """Return a rich table of the columns at `places`, wrapped to `width` characters."""
        rendered = Table(
            header_style="bold",
            box=SIMPLE_HEAD,
            pad_edge=False,
            padding=(0, _GAP - 1, 0, 0),
        )
        columns = _fit([self.columns[place] for place in places], width)
        for place, column in zip(places, columns, strict=True):
            justify: JustifyMethod = "left"
            if self.right[place]:
                justify = "right"
            # Cells are already wrapped; rich must not break words.
            rendered.add_column(Text(column[0]), justify=justify, no_wrap=True)
        for cells in list(zip(*columns, strict=True))[1:]:
            rendered.add_row(*map(Text, cells))
        return rendered

    def _divide(self, width: int) -> Iterator[list[int]]:
        """Yield, for each table that fits `width`, its columns' places besides the keys."""
        min_widths = [_min_width(column) for column in self.columns]
        places: list[int] = []
        for place in range(self.keys, len(self.columns)):
            part = [*range(self.keys), *places, place]
            total = _total_width([min_widths[member] for member in part])
            # A table has at least one column besides the keys, even if too wide.
            if places and total > width:
                yield places
                places = []
            places.append(place)
        yield places


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    title: str = "",
    caption: str = "",
) -> FittedTable:
    """Return a table for the terminal whose parts all repeat the first column.

    Args:
        columns: Headings; a '>' in front aligns a column to the right.
        rows: Cells of each row.
        title: Line above the table.
        caption: Line below the table.
    """
    # zip makes columns of rows, each below its heading.
    headings = [heading.removeprefix(">") for heading in columns]
    cells = [map(str, row) for row in rows]
    return FittedTable(
        tuple(zip(headings, *cells, strict=True)),
        tuple(heading.startswith(">") for heading in columns),
        1,
        title,
        caption,
    )


def rich_table(content: TextTable) -> FittedTable:
    """Return a `TextTable` as a table that adapts to the terminal's width."""
    return FittedTable(
        tuple(zip(content.columns, *content.rows, strict=True)),
        tuple(place >= content.texts for place in range(len(content.columns))),
        content.texts,
        content.title,
        content.caption,
    )


def quantities_table(
    config: object, title: str, excluded: Iterable[str] = ()
) -> FittedTable:
    """Return a table with name, value, unit and meaning of each field of a configuration.

    Args:
        config: The configuration.
        title: Line above the table.
        excluded: Names of quantities, without their section, that are left out.
    """
    rows = []
    for name, quantity, value in fields_of(config):
        if name.rpartition(".")[2] not in excluded:
            rows.append((name, value_text(value), quantity.unit, quantity.description))
    return table(("quantity", "value", "unit", "meaning"), rows, title=title)


def value_text(value: object) -> str:
    """Return a value as text: a float with five digits, a tuple with commas, None as -."""
    if value is None:
        return "-"
    if isinstance(value, tuple):
        parts = []
        for part in value:
            text = value_text(part)
            if isinstance(part, tuple):
                text = f"({text})"
            parts.append(text)
        return ", ".join(parts)
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def decimals_text(value: object) -> str:
    """Return a float with two decimals, any other value as its str."""
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def _fit(columns: Sequence[Column], width: int) -> list[Column]:
    """Return columns wrapped so that a table fits `width` characters, if it can.

    The widest column is narrowed first. Words are broken only if nothing else fits.
    """
    fitted = [
        _wrap(column, max(_longest_word(column[0]), _width(column[1:])))
        for column in columns
    ]
    min_widths = [_min_width(column) for column in columns]
    # By one character at a time, so that the columns end up about equally wide.
    while _total_width([_width(column) for column in fitted]) > width:
        widths = [_width(column) for column in fitted]
        wide_places = []
        for place, min_width in enumerate(min_widths):
            if widths[place] > min_width:
                wide_places.append(place)
        if wide_places:
            place = max(wide_places, key=widths.__getitem__)
            fitted[place] = _wrap(columns[place], widths[place] - 1)
        elif max(min_widths) > 1:
            # Not even single words fit: the longest are broken.
            min_widths = [1] * len(columns)
        else:
            break
    return fitted


def _min_width(column: Column) -> int:
    """Return the length of the longest word in a column, heading included."""
    return max(map(_longest_word, column))


def _width(texts: Column) -> int:
    """Return the length of the longest line of all texts, 0 if there are none."""
    return max(map(len, "\n".join(texts).split("\n")))


def _total_width(widths: Sequence[int]) -> int:
    """Return a table's width with gaps and margins, in characters."""
    return sum(widths) + _GAP * (len(widths) - 1) + _MARGINS


def _join_words(text: str) -> str:
    """Return text with no-break spaces after commas in brackets and before a star."""
    joined = re.sub(
        r"\[[^]]*\]", lambda limits: limits[0].replace(", ", f",{_NO_BREAK}"), text
    )
    return joined.replace(" *", f"{_NO_BREAK}*")


def _longest_word(text: str) -> int:
    """Return the length of a text's longest part that must not be broken."""
    return max(map(len, re.split("[ \n]", _join_words(text))))


def _wrap(column: Column, width: int) -> Column:
    """Return a column's texts wrapped to `width`; only longer words are broken."""
    # Hyphens are part of names and of negative numbers.
    wrapper = textwrap.TextWrapper(max(width, 1), break_on_hyphens=False)
    # Cells may have line breaks of their own, which stay.
    wrapped = []
    for text in column:
        lines = map(wrapper.fill, _join_words(text).split("\n"))
        wrapped.append("\n".join(lines).replace(_NO_BREAK, " "))
    return wrapped
