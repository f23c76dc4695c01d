"""Reading YAML, JSON and CSV of users, bounded in size (every mistake is one line that names the file); Markdown."""

import csv
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

from barn_worlds.errors import ConfigError, shown, suggest
from barn_worlds.formats.files import read_at_most

LARGEST_JSON_BYTES = LARGEST_CSV_BYTES = 64 * 1024 * 1024
LARGEST_YAML_BYTES = 1_000_000


def read_json(path: Path, largest: int = LARGEST_JSON_BYTES) -> Any:
    """Return the content of a JSON file of at most `largest` bytes."""
    content = _read(path, largest)
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not JSON: {error}") from None


def read_yaml(path: Path, schema_version: int) -> dict[str, Any]:
    """Return the mapping in a YAML file without its `schema_version`, which must be the one given."""
    content = parse_yaml(_read(path, LARGEST_YAML_BYTES), str(path))
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: must be a mapping of names to values, got {shown(content)}")
    version = content.pop("schema_version", None)
    if version != schema_version:
        raise ConfigError(f"{path}: schema_version must be {schema_version}, got {shown(version)}")
    return content


def parse_yaml(text: str | bytes, where: str) -> Any:
    """Return the content of YAML text; ConfigError begins with `where` (a path or the name of an option)."""
    try:
        return yaml.load(text, _Loader)  # noqa: S506, derived from the safe one
    # PyYAML does not catch what its constructors raise for a bad date, `!!int x` and the like
    except (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
        raise ConfigError(f"{where}: not YAML: {' '.join(str(error).split())[:200]}") from None


def read_csv(path: Path, needed: tuple[str, ...]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the rows of a CSV file: the place, such as "times.csv, line 2", and the values by column.

    The first line names the columns; it must contain those that are needed.
    """
    try:
        rows = csv.reader(_read(path, LARGEST_CSV_BYTES).decode("utf-8").splitlines(), strict=True)
        names = next(rows, [])
        for name in needed:
            if name not in names:
                raise ConfigError(f"{path}: no column {shown(name)}{suggest(name, names)}")
        if len(set(names)) < len(names):
            raise ConfigError(f"{path}: has two columns of the same name")
        for row in filter(None, rows):
            where = f"{path}, line {rows.line_num}"
            if len(row) != len(names):
                raise ConfigError(f"{where}: has {len(row)} values, must have {len(names)}")
            yield where, dict(zip(names, row, strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: not a CSV file: {error}") from None


def finite(content: Any) -> Any:
    """Return plain data that JSON can hold: None for numbers that are not finite, keys as text, tuples as lists."""
    if isinstance(content, dict):
        return {str(key): finite(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def markdown_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _read(path: Path, largest: int) -> bytes:
    try:
        return read_at_most(path, largest)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise ConfigError(f"{path}: {getattr(error, 'strerror', None) or error}") from None


class _Loader(yaml.SafeLoader):
    """Refuses aliases, which let a short file describe a huge structure."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not allowed")
        return super().compose_node(parent, index)
