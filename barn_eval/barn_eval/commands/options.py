"""What several commands have in common: options, the way values are written, and tables."""

from __future__ import annotations

import json
from typing import Any

import click
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from barn_worlds.errors import ConfigError, shown
from barn_worlds.text_files import finite, parse_yaml

console = Console()
notes = Console(stderr=True)

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


def table(*columns: str, title: str | None = None) -> Table:
    """Return an empty table.

    Columns whose name begins with '>' hold numbers and are aligned to the right; '!' marks those never to be wrapped.
    """
    made = Table(title=title, title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        made.add_column(
            Text(column.lstrip("!>")),
            justify="right" if column.startswith(">") else "left",
            no_wrap=column.startswith("!"),
            overflow="fold",
        )
    return made


def row(made: Table, *cells: str) -> None:
    """Add a row of plain texts, in which brackets are brackets."""
    made.add_row(*map(Text, cells))
