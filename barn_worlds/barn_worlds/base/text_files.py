"""Reading YAML, JSON and lines of JSON that anyone may have written; Markdown.

Size, depth, count, numbers and encoding are bounded. Every mistake is a ConfigError of one line that names the file.
"""

import json
import math
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias

import yaml

from barn_worlds.base.errors import ConfigError, format_error, format_value
from barn_worlds.base.files import open_regular, read_at_most

LARGEST_JSON_BYTES = 64 * 1024 * 1024
LARGEST_YAML_BYTES = 256 * 1024
LARGEST_LINES_BYTES = 1 << 30
LONGEST_LINE_BYTES = 1 << 20
MOST_VALUES = 1_000_000
DEEPEST = 60
Plain: TypeAlias = Any  # None, bool, int, float, str, and lists and mappings of them
_LARGEST_INTEGER = 2**63 - 1
_Loader: Any = getattr(
    yaml, "CSafeLoader", yaml.SafeLoader
)  # libyaml's is ten times faster


def read_json(path: Path, largest: int = LARGEST_JSON_BYTES) -> Plain:
    """Return the content of a JSON file of at most `largest` bytes."""
    return parse_json(_read(path, largest), str(path))


def parse_json(text: str | bytes, where: str) -> Plain:
    """Return the content of JSON text that can be written as JSON again; ConfigError begins with `where`.

    Numbers must be finite, integers of 64 bits, texts valid Unicode.
    """
    try:
        content = text if isinstance(text, str) else text.decode("utf-8")
        if sum(map(content.count, ",[{")) > MOST_VALUES:
            raise ValueError(f"more than {MOST_VALUES} values")
        found = json.loads(content, parse_constant=_no_number)
        _check(found)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{where}: not JSON: {format_error(error)}") from None
    return found


def read_lines(path: Path) -> Iterator[tuple[str, str]]:
    """Yield each line of a file, if there is one, with its place, such as "rows.jsonl, line 2"; not one cut off."""
    try:
        with open_regular(path) as file:
            read = 0
            for number, line in enumerate(
                iter(lambda: file.readline(LONGEST_LINE_BYTES + 1), b""), 1
            ):
                read += len(line)
                if len(line) > LONGEST_LINE_BYTES or read > LARGEST_LINES_BYTES:
                    limits = f"{LONGEST_LINE_BYTES} bytes in a line or {LARGEST_LINES_BYTES} in the file"
                    raise ConfigError(
                        f"{path}, line {number}: more than the allowed {limits}"
                    )
                if line.endswith(b"\n"):
                    yield f"{path}, line {number}", line[:-1].decode("utf-8")
    except FileNotFoundError:
        return
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}, line {number}: not JSON: {error}") from None
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None


def read_yaml(
    path: Path, schema_version: int, largest: int = LARGEST_YAML_BYTES
) -> dict[str, Any]:
    """Return the mapping in a YAML file of at most `largest` bytes without its `schema_version`, the one given."""
    content = parse_yaml(_read(path, largest), str(path))
    if not isinstance(content, dict):
        raise ConfigError(
            f"{path}: must be a mapping of names to values, got {format_value(content)}"
        )
    version = content.pop("schema_version", None)
    if version != schema_version:
        raise ConfigError(
            f"{path}: schema_version must be {schema_version}, got {format_value(version)}"
        )
    return content


def parse_yaml(text: str | bytes, where: str) -> Plain:
    """Return the content of YAML text; ConfigError begins with `where` (a path or the name of an option)."""
    try:
        _check_events(text)
        found = yaml.load(text, _Loader)  # one of the safe ones  # noqa: S506  # nosec B506
        _check(
            found, numbers=False
        )  # ranges are the configuration's, which names the key
    # PyYAML does not catch what its constructors raise for a bad date, `!!int x` and the like
    except (
        yaml.YAMLError,
        ValueError,
        TypeError,
        LookupError,
        AttributeError,
        ArithmeticError,
    ) as error:
        raise ConfigError(f"{where}: not YAML: {format_error(error)}") from None
    return found


def read_package_yaml(package: str, file: str) -> Plain:
    """Return the content of a YAML file in a package's data."""
    return parse_yaml((files(package) / "data" / file).read_text("utf-8"), file)


def make_json_safe(content: Plain) -> Plain:
    """Return plain data that JSON can hold: None for numbers that are not finite, keys as text, tuples as lists."""
    if isinstance(content, dict):
        return {str(key): make_json_safe(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [make_json_safe(value) for value in content]
    return (
        None if isinstance(content, float) and not math.isfinite(content) else content
    )


def markdown_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |"
        for line in lines
    )


def _read(path: Path, largest: int) -> bytes:
    try:
        return read_at_most(path, largest)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise ConfigError(
            f"{path}: {getattr(error, 'strerror', None) or error}"
        ) from None


def _no_number(name: str) -> None:
    raise ValueError(f"numbers must be finite, got {name}")


def _check(content: Plain, *, numbers: bool = True) -> None:
    """Raise ValueError for plain data that is nested too deep, has texts or, if asked, numbers that are not allowed."""
    level = [content]
    for _ in range(DEEPEST):
        deeper: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                deeper += value
                deeper += value.values()
            elif isinstance(value, (list, tuple, set)):
                deeper += value
            elif isinstance(value, str):
                value.encode()  # lone surrogates could not be written
            elif (
                numbers
                and isinstance(value, int)
                and not -_LARGEST_INTEGER <= value <= _LARGEST_INTEGER
            ):
                raise ValueError(
                    f"integers must be of 64 bits, got {format_value(value)}"
                )
            elif numbers and isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"numbers must be finite, got {value}")
        if not deeper:
            return
        level = deeper
    raise ValueError(f"nested more than {DEEPEST} deep")


def _check_events(text: str | bytes) -> None:
    """Raise YAMLError for aliases, which let a short file describe a huge structure, and for a structure too deep."""
    depth = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not allowed")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(
            event, yaml.CollectionEndEvent
        )
        if depth > DEEPEST:
            raise yaml.YAMLError(f"nested more than {DEEPEST} deep")
