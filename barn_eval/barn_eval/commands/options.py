"""What several commands have in common: options, the way values are written, and tables."""

import json
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import click
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from barn_eval.analysis.text_table import TextTable
from barn_worlds.errors import ConfigError, shown
from barn_worlds.text_files import finite, parse_yaml

console = Console()
notes = Console(stderr=True)

PATH = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)
SEED = click.IntRange(0, 2**62)

json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of tables.")
worlds_option = click.option("--worlds", "spec", default="all", show_default=True, help="Which worlds, such as 0-49.")


def parse_settings(settings: tuple[str, ...], option: str) -> dict[str, Any]:
    """Return texts "key=value" as a mapping; values are read as YAML. ConfigError for anything else."""
    changes: dict[str, Any] = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals or not key.strip():
            raise ConfigError(f"{option} {shown(setting)}: must be key=value")
        if key.strip() in changes:
            raise ConfigError(f"{option} {shown(setting)}: {key.strip()} is given twice")
        changes[key.strip()] = parse_yaml(value, f"{option} {shown(setting)}")
    return changes


def print_json(content: Any) -> None:
    """Print plain data as JSON; numbers that JSON does not have become null."""
    click.echo(json.dumps(finite(content), indent=1, allow_nan=False))


def say(line: object) -> None:
    """Print a line that is not part of the results, such as a path, to standard error."""
    notes.print(str(line), markup=False, soft_wrap=True)


def table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, title: str | None = None, caption: str = ""
) -> Table:
    """Return a table of plain texts, in which brackets are brackets.

    Columns whose name begins with '>' hold numbers and are aligned to the right.
    """
    made = Table(title=title, title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    made.caption, made.caption_justify = Text(caption) if caption else None, "left"
    for column in columns:
        made.add_column(
            Text(column.removeprefix(">")), justify="right" if column.startswith(">") else "left", overflow="fold"
        )
    for cells in rows:
        made.add_row(*map(Text, cells))
    return made


def rich_table(found: TextTable) -> Table:
    """Return a table of results for the terminal; where it is too wide, limits go below their estimates."""
    texts, figures = found.columns[: found.texts], found.columns[found.texts :]
    columns = [list(column) for column in zip(*found.rows, strict=True)]
    widths = [max(map(len, column)) for column in columns[found.texts :]]
    if sum(widths) + _TEXT * len(texts) + 3 * len(columns) > console.width:
        columns[found.texts :] = [[cell.replace(" [", "\n[") for cell in column] for column in columns[found.texts :]]
    made = table(texts, (), title=found.title, caption=found.caption)
    for name, column in zip(figures, columns[found.texts :], strict=True):
        made.add_column(Text(_head(name, column)), justify="right", no_wrap=True, overflow="fold")
    for cells in zip(*columns, strict=True):
        made.add_row(*map(Text, cells))
    return made


_TEXT = 20  # characters that a column of texts is granted before the table counts as too wide
_WORD = 12  # characters of a head that are not parted at hyphens


def _head(name: str, column: Sequence[str]) -> str:
    """Return the head of figures in lines that are no longer than they are, as far as its words allow."""
    lines = [line for cell in column for line in cell.split("\n")]
    words = [part for word in name.split() for part in (word.split("-") if len(word) > _WORD else [word])]
    return textwrap.fill(name, max(map(len, [*lines, *words])) + 1)
