"""The catalog of measures: name, unit and better direction of each figure of a trial.

Tables, comparisons, rankings, pages and figures name measures by key and format values
by the catalog.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from barn_eval.results.row_table import column, has_motion
from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import Rows
from barn_metrics.bootstrap import Interval, number
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError, suggest

Better = Literal["larger", "smaller", ""]


def _numbers(rows: Rows, path: str) -> Floats:
    """Return the numbers in a dotted field of rows (n,); NaN for rows without one."""
    return column(rows, path).astype(np.float64)  # type: ignore[no-any-return]


# A failure scores zero by some measures, and counts the time that the protocol sets by
# others.
_ZERO_AT_FAILURE = ("success", "challenge", "challenge_2022", "efficiency")
_TIMES = ("scored_time_s", "normalised_time_s_per_m")


@dataclass(frozen=True)
class Measure:
    """A figure of a trial."""

    path: str
    """Field of a result that holds it, dotted; not all trials have all fields."""

    label: str
    digits: int
    unit: str = ""
    better: Better = ""

    successes_only: bool = False
    """Whether means and comparisons leave failed trials out."""

    maximum: float | None = None
    """Highest possible value, where readers need it."""

    percent: bool = False
    """Whether the value lies in 0 to 1 and is shown in percent."""

    @property
    def key(self) -> str:
        """Last part of `path`: key of `MEASURES` and column of tables."""
        return self.path.rpartition(".")[2]

    def raw_values(self, results: Rows) -> Floats:
        """Return each trial's figure (n,), also of failed trials; NaN if it has none."""
        return _numbers(results, self.path)

    def failure_values(self, results: Rows) -> Floats | None:
        """Return each trial's value if it were a failure (n,); None if that has none.

        The value is NaN for a time per meter without a path length.
        """
        if self.key in _ZERO_AT_FAILURE:
            return np.zeros(len(results))
        if self.key not in _TIMES:
            return None
        times_s = _numbers(results, "scores.failure_time_s")
        if self.key == "scored_time_s":
            return times_s
        lengths_m = _numbers(results, "scores.path_length_m")
        return times_s / np.where(lengths_m == 0.0, math.nan, lengths_m)

    @property
    def title(self) -> str:
        """Label, followed by " of successes" if failed trials do not count."""
        return f"{self.label} of successes" if self.successes_only else self.label

    @property
    def heading(self) -> str:
        """Title with any maximum and the unit in brackets, for table columns and axes."""
        return self._with_unit(self.title)

    @property
    def trial_heading(self) -> str:
        """Label with any maximum and the unit in brackets, for columns of single trials."""
        return self._with_unit(self.label)

    @property
    def after(self) -> str:
        """Unit as text after a value, with a space unless it is %; empty without a unit."""
        return "%" if self.percent else f" {self.unit}".rstrip()

    def values(self, results: Rows) -> Floats:
        """Return a value per result (n,); NaN if missing or, with `successes_only`, failed."""
        values = self.raw_values(results)
        if not self.successes_only:
            return values
        # Otherwise a collision after two seconds would count as a quick trial.
        return np.where(column(results, "scores.success") == 1, values, math.nan)

    @property
    def best(self) -> float:
        """Best possible value: 0 if smaller is better, else `maximum` or 1."""
        if self.better == "smaller":
            return 0.0
        return 1.0 if self.maximum is None else self.maximum

    def in_heading_unit(self, interval: Interval) -> Interval:
        """Return the interval times 100 if shown in percent, else unchanged."""
        return interval.scale(100.0) if self.percent else interval

    def text(self, interval: Interval) -> str:
        """Return "estimate [low, high]" in the heading's unit, without naming it."""
        return self.in_heading_unit(interval).text(self.digits)

    def number(self, value: float | None) -> str:
        """Return a value as text in the heading's unit, without the unit; "-" for none."""
        if self.percent and value is not None:
            value = 100.0 * value
        return number(value, self.digits)

    def _with_unit(self, name: str) -> str:
        """Return a name followed by maximum and unit, such as "time [s]"."""
        if self.maximum is not None:
            name = f"{name} (of {self.maximum:g})"
        unit = "%" if self.percent else self.unit
        return f"{name} [{unit}]" if unit else name


_FILE = Path(__file__).parents[1] / "data" / "measures.json"
_CONTENT = json.loads(_FILE.read_bytes())
_CATALOG = [Measure(**fields) for fields in _CONTENT["measures"]]
MEASURES = {measure.key: measure for measure in _CATALOG}
# Keys of the measures that a table, a page or a figure shows.
SHOWN: dict[str, list[str]] = _CONTENT["shown"]
_KEYS = tuple(MEASURES)

SCORED = tuple(
    measure.key
    for measure in _CATALOG
    if measure.path.startswith("scores.") and measure.better
)
# Measures of trials among moving obstacles.
MOVING = tuple(
    measure.key for measure in _CATALOG if measure.path.startswith("motion.")
)
# Measures that reports and summaries list besides the scores.
DRIVEN = _KEYS[_KEYS.index("driven_m") : _KEYS.index(MOVING[0])]
COMPARED = (*SCORED, *SHOWN["compared"])


def with_moving_measures(keys: Sequence[str], *groups: Rows) -> tuple[str, ...]:
    """Return keys, plus those for moving obstacles if every planner met some.

    Args:
        keys: Keys of measures.
        *groups: Results of each planner.
    """
    meets_motion = [bool(has_motion(results).any()) for results in groups]
    # A planner that met no moving obstacle would have no pairs.
    if meets_motion and all(meets_motion):
        return (*keys, *MOVING)
    return tuple(keys)


def require_measures(names: Sequence[str]) -> tuple[str, ...]:
    """Return measure keys without repetitions; ConfigError if one is unknown.

    Raises:
        ConfigError: If the catalog lacks one of them.
    """
    for name in names:
        if name not in MEASURES:
            raise ConfigError(f"unknown measure {name!r}{suggest(name, MEASURES)}")
    return tuple(dict.fromkeys(names))


def ranking_measure(results: Rows) -> Measure:
    """Return the measure by which the first result's protocol ranks planners."""
    first = results[0]
    if first.metric:
        return MEASURES[first.metric]
    # Rows of schema 1 do not name the measure.
    if first.protocol == CHALLENGE.name:
        return MEASURES["challenge"]
    return MEASURES["normalised_time_s_per_m"]


def clearance_measure(results: Rows) -> Measure:
    """Return the measure of clearance to moving obstacles if all have some, else to all."""
    if has_motion(results).all():
        return MEASURES["moving_clearance_m"]
    return MEASURES["min_clearance_m"]
