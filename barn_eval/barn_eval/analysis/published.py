"""Tables of published trial times, by which planners are calibrated.

A row per world: `world`, `path_length_m` and columns PLANNER_1, PLANNER_2, ... of times in seconds.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from barn_worlds.errors import ConfigError

# How failures stand in the paper's table: exactly 30 s, or cut off at 50 s.
FAILURE_TIME_S = 30.0
LIMIT_S = 50.0
_MAX_BYTES = 10_000_000
_COLUMN = re.compile(r"(.+)_([1-9][0-9]*)")


@dataclass(frozen=True, eq=False)
class Trials:
    """Trials of one planner: number of the world, time as counted in seconds, whether it failed (each (n,)).

    lengths_m: arc length of the path of each world in metres.
    """

    worlds: npt.NDArray[np.int64]
    times_s: npt.NDArray[np.float64]
    failed: npt.NDArray[np.bool_]
    lengths_m: Mapping[int, float]

    @property
    def normalised_s_per_m(self) -> npt.NDArray[np.float64]:
        """The times by the length of the world's path (n,)."""
        lengths_m: npt.NDArray[np.float64] = np.array([self.lengths_m[int(world)] for world in self.worlds])
        return self.times_s / lengths_m

    def with_equal_failures(self) -> Trials:
        """Return the trials with every failure counted as `FAILURE_TIME_S`."""
        times_s = np.where(self.failed, FAILURE_TIME_S, self.times_s)
        return Trials(self.worlds, times_s, self.failed, self.lengths_m)

    def only(self, worlds: set[int]) -> Trials:
        """Return the trials in some of the worlds."""
        kept = np.isin(self.worlds, sorted(worlds))
        return Trials(self.worlds[kept], self.times_s[kept], self.failed[kept], self.lengths_m)


def read_published(path: Path) -> dict[str, Trials]:
    """Return the published trials by planner; ConfigError in one line for a file that is no such table."""
    rows = _rows(path)
    planners = _planner_columns(path, rows[0])
    lengths: dict[int, float] = {}
    times: dict[str, list[tuple[int, float]]] = {planner: [] for planner in planners}
    for line, row in enumerate(rows[1:], 2):
        where = f"{path}, line {line}"
        if len(row) != len(rows[0]):
            raise ConfigError(f"{where}: has {len(row)} values, must have {len(rows[0])}")
        cells = dict(zip(rows[0], row, strict=True))
        world = int(_number(where, "world", cells["world"], whole=True))
        if world in lengths:
            raise ConfigError(f"{where}: world {world} is there already")
        lengths[world] = _number(where, "path_length_m", cells["path_length_m"])
        for planner, columns in planners.items():
            times[planner] += [(world, _number(where, column, cells[column])) for column in columns]
    return {planner: _trials(found, lengths) for planner, found in times.items()}


def _trials(found: list[tuple[int, float]], lengths: Mapping[int, float]) -> Trials:
    times = np.array([time for _, time in found])
    failed = np.isclose(times, FAILURE_TIME_S, rtol=0.0, atol=1e-9) | (times >= LIMIT_S)
    return Trials(np.array([world for world, _ in found], np.int64), times, failed, lengths)


def _rows(path: Path) -> list[list[str]]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ConfigError(f"{path}: is larger than {_MAX_BYTES} bytes")
        text = path.read_text("utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a table of text (UTF-8)") from None
    try:
        rows = [row for row in csv.reader(text.splitlines(), strict=True) if row]
    except csv.Error as error:
        raise ConfigError(f"{path}: not CSV: {error}") from None
    if len(rows) < 2:
        raise ConfigError(f"{path}: must have a line of column names and at least one world")
    return rows


def _planner_columns(path: Path, names: list[str]) -> dict[str, list[str]]:
    """Return the columns of each planner; ConfigError where columns are missing or twice there."""
    for name in ("world", "path_length_m"):
        if name not in names:
            raise ConfigError(f"{path}: has no column {name!r}, only {', '.join(names)}")
    if len(set(names)) < len(names):
        raise ConfigError(f"{path}: has two columns of the same name")
    planners: dict[str, list[str]] = {}
    for name in names:
        if match := _COLUMN.fullmatch(name):
            planners.setdefault(match[1], []).append(name)
    if not planners:
        raise ConfigError(f"{path}: has no columns of times, such as dwa_1, only {', '.join(names)}")
    return planners


def _number(where: str, column: str, text: str, *, whole: bool = False) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if whole and not (value >= 0.0 and value.is_integer()):
        raise ConfigError(f"{where}: {column} must be a whole number from 0, got {text!r}")
    if not whole and not (value > 0.0 and math.isfinite(value)):
        raise ConfigError(f"{where}: {column} must be a number above 0, got {text!r}")
    return value
