"""Scores of worlds from a table, measured or predicted, by which a data set can be numbered."""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from barn_worlds.errors import WorldError, suggest

_LARGEST_FILE_BYTES = 200_000_000


def read_scores(file: Path, column: str, worlds: Sequence[int]) -> tuple[float, ...]:
    """Return one score per world: the mean of a column over the rows of a CSV file with the world's number in `world`.

    A campaign's results.csv is such a file. Raises WorldError in one line for a file that cannot be read, a missing
    column, a value that is not a finite number, or a world without a row.
    """
    values: dict[int, list[float]] = defaultdict(list)
    try:
        if file.stat().st_size > _LARGEST_FILE_BYTES:
            raise WorldError(f"{file}: must be at most {_LARGEST_FILE_BYTES} bytes, has {file.stat().st_size}")
        with file.open(newline="", encoding="utf-8") as stream:
            rows = csv.DictReader(stream)
            for wanted in ("world", column):
                if wanted not in (rows.fieldnames or ()):
                    raise WorldError(f"{file}: no column {wanted!r}{suggest(wanted, rows.fieldnames or ())}")
            for number, row in enumerate(rows, 2):
                world, value = _parsed(row["world"], row[column], f"{file}, line {number}")
                values[world].append(value)
    except OSError as error:
        raise WorldError(f"{file}: {error.strerror or error}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise WorldError(f"{file}: not a CSV file: {error}") from None
    missing = next((world for world in worlds if world not in values), None)
    if missing is not None:
        raise WorldError(f"{file}: no row for world {missing}")
    return tuple(math.fsum(values[world]) / len(values[world]) for world in worlds)


def _parsed(world: str | None, value: str | None, where: str) -> tuple[int, float]:
    try:
        parsed = int(world or ""), float(value or "")
    except ValueError:
        raise WorldError(f"{where}: must hold a world's number and a score, got {world!r} and {value!r}") from None
    if not math.isfinite(parsed[1]):
        raise WorldError(f"{where}: score must be finite, got {value!r}")
    return parsed
