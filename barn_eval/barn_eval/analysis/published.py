"""Tables of published trial times.

A row per world: `world`, `path_length_m` and columns PLANNER_1, PLANNER_2, ... of times in seconds.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.errors import ConfigError, shown
from barn_worlds.base.text_files import read_csv

# How failures stand in the paper's table: exactly 30 s, or cut off at 50 s.
FAILURE_TIME_S = 30.0
LIMIT_S = 50.0
SAME_LENGTH_M = 0.001  # path lengths of the same world: tables hold them with six decimals
_COLUMN = re.compile(r"(.+)_([1-9][0-9]*)")


@dataclass(frozen=True, eq=False)
class TimedTrials:
    """Trials of one planner: number of the world, time as counted in seconds, whether it failed (each (n,)).

    lengths_m: arc length of the path of each world in metres.
    """

    worlds: Integers
    times_s: Floats
    failed: npt.NDArray[np.bool_]
    lengths_m: Mapping[int, float]

    @property
    def normalised_s_per_m(self) -> Floats:
        """The times by the length of the world's path (n,)."""
        lengths_m: Floats = np.array([self.lengths_m[int(world)] for world in self.worlds])
        return self.times_s / lengths_m

    def other_length(self, lengths_m: Iterable[tuple[int, float]]) -> int | None:
        """Return the first of some worlds, given with their path lengths, that has another length here."""
        return next((world for world, one in lengths_m if abs(one - self.lengths_m[world]) > SAME_LENGTH_M), None)


def read_published(path: Path) -> dict[str, TimedTrials]:
    """Return the published trials by planner; ConfigError in one line for a file that is no such table."""
    lengths: dict[int, float] = {}
    times: dict[str, list[tuple[int, float]]] = {}
    for where, row in read_csv(path, ("world", "path_length_m")):
        if not re.fullmatch("[0-9]{1,9}", row["world"]) or int(row["world"]) in lengths:
            raise ConfigError(f"{where}: world must be another whole number, got {shown(row['world'])}")
        world = int(row["world"])
        lengths[world] = _above_zero(where, "path_length_m", row["path_length_m"])
        for column, text in row.items():
            if match := _COLUMN.fullmatch(column):
                times.setdefault(match[1], []).append((world, _above_zero(where, column, text)))
    if not times:
        raise ConfigError(f"{path}: must have at least one world and columns of times, such as dwa_1")
    return {planner: _trials(found, lengths) for planner, found in times.items()}


def _trials(found: list[tuple[int, float]], lengths: Mapping[int, float]) -> TimedTrials:
    times = np.array([time for _, time in found])
    failed = np.isclose(times, FAILURE_TIME_S, rtol=0.0, atol=1e-9) | (times >= LIMIT_S)
    return TimedTrials(np.array([world for world, _ in found], np.int64), times, failed, lengths)


def _above_zero(where: str, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise ConfigError(f"{where}: {column} must be a number above 0, got {shown(text)}")
    return value
