"""The catalog of measures: name, unit and better direction of each figure of a trial.

Tables, comparisons, rankings, pages and figures name measures by their key and write
values as the catalog says.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal

import numpy as np

from barn_eval.trials.protocol import CHALLENGE
from barn_eval.trials.result import Rows, TrialResult
from barn_eval.trials.trajectory import NEAR_CONTACT_M
from barn_metrics.bootstrap import Interval, number
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError, suggest

Better = Literal["larger", "smaller", ""]


@dataclass(frozen=True)
class Measure:
    """A figure of a trial."""

    path: str
    """Field of a result that holds it, dotted; not all trials have all fields."""

    label: str
    unit: str
    digits: int
    better: Better = ""

    successes_only: bool = False
    """Whether means and comparisons leave failed trials out."""

    maximum: float | None = None
    """Highest possible value, where readers need it."""

    percent: bool = False
    """Whether the value lies in 0 to 1 and is shown in percent."""

    as_failure: Callable[[TrialResult], float] | None = None
    """Value that a trial would have as a failure; None if failures have none."""

    compute: Callable[[TrialResult], float] | None = None
    """Computes the value where no field holds it."""

    @property
    def key(self) -> str:
        """Its column in the tables of results, or a name of its own."""
        return self.path.rpartition(".")[2]

    def value(self, result: TrialResult) -> float | None:
        """Return the figure of a trial, None if the trial has none."""
        if self.compute is not None:
            return self.compute(result)
        field: Any = result
        for name in self.path.split("."):
            field = getattr(field, name, None)
        value: float | None = field
        return value

    @property
    def title(self) -> str:
        """The label, and which trials count."""
        return f"{self.label} of successes" if self.successes_only else self.label

    @property
    def heading(self) -> str:
        """The title with its unit, for tables and axes."""
        return self._with_unit(self.title)

    @property
    def trial_heading(self) -> str:
        """The label with its unit, for values of single trials."""
        return self._with_unit(self.label)

    @property
    def after(self) -> str:
        """The unit as it follows a value in a sentence."""
        return " %" if self.percent else f" {self.unit}".rstrip()

    def values(self, results: Rows) -> Floats:
        """Return the value of each trial (n,), NaN where none counts."""
        values: Floats = np.full(len(results), np.nan)
        for position, result in enumerate(results):
            if self.successes_only and not result.scores.success:
                continue
            value = self.value(result)
            if value is not None:
                values[position] = value
        return values

    @property
    def best(self) -> float:
        """The best possible value of a measure that counts failures."""
        if self.better == "smaller":
            return 0.0
        return 1.0 if self.maximum is None else self.maximum

    def in_heading_unit(self, interval: Interval) -> Interval:
        """Return an estimate of the measure in the unit of its heading."""
        return interval.scale(100.0) if self.percent else interval

    def text(self, interval: Interval) -> str:
        """Return an estimate of the measure with its limits, without the unit."""
        return self.in_heading_unit(interval).text(self.digits)

    def number(self, value: float | None) -> str:
        """Return a value of the measure as text, without the unit."""
        if self.percent and value is not None:
            value = 100.0 * value
        return number(value, self.digits)

    def _with_unit(self, name: str) -> str:
        if self.maximum is not None:
            name = f"{name} (of {self.maximum:g})"
        unit = "%" if self.percent else self.unit
        return f"{name} [{unit}]" if unit else name


def _zero(_: TrialResult) -> float:
    return 0.0


def _failure_s_per_m(result: TrialResult) -> float:
    return result.scores.failure_time_s / result.scores.path_length_m


def _path_ratio(result: TrialResult) -> float:
    return result.measures.driven_m / result.scores.path_length_m


_FAILURE_S = attrgetter("scores.failure_time_s")
_CATALOG = (
    Measure(
        "scores.success", "success", "", 1, "larger", percent=True, as_failure=_zero
    ),
    Measure("scores.traversal_time_s", "time", "s", 2, "smaller", successes_only=True),
    Measure(
        "scores.scored_time_s",
        "time as counted",
        "s",
        2,
        "smaller",
        as_failure=_FAILURE_S,
    ),
    Measure(
        "scores.normalised_time_s_per_m",
        "time per meter as counted",
        "s/m",
        3,
        "smaller",
        as_failure=_failure_s_per_m,
    ),
    Measure("scores.optimal_time_s", "optimal time", "s", 2),
    Measure(
        "scores.challenge",
        "challenge metric",
        "",
        3,
        "larger",
        maximum=0.5,
        as_failure=_zero,
    ),
    Measure(
        "scores.challenge_2022",
        "challenge metric of 2022",
        "",
        3,
        "larger",
        maximum=0.25,
        as_failure=_zero,
    ),
    Measure(
        "scores.efficiency",
        "efficiency",
        "",
        1,
        "larger",
        percent=True,
        as_failure=_zero,
    ),
    Measure("scores.least_time_s", "least time possible", "s", 2),
    Measure("measures.mean_speed_mps", "mean speed", "m/s", 3),
    Measure("wall_clock.real_time_factor", "times real time", "", 1),
    Measure(
        "measures.driven_m", "driven length", "m", 3, "smaller", successes_only=True
    ),
    Measure(
        "path_ratio",
        "driven by path length",
        "",
        3,
        "smaller",
        successes_only=True,
        compute=_path_ratio,
    ),
    Measure("measures.min_clearance_m", "smallest clearance", "m", 3, "larger"),
    Measure("measures.mean_clearance_m", "mean clearance", "m", 3, "larger"),
    Measure("measures.contact_s", "time in contact", "s", 3, "smaller"),
    Measure(
        "measures.near_contact_s",
        f"time within {NEAR_CONTACT_M:g} m of obstacles",
        "s",
        2,
        "smaller",
    ),
    Measure("measures.rms_jerk_mps3", "rms jerk", "m/s3", 2, "smaller"),
    Measure("measures.rms_yaw_jerk_radps3", "rms angular jerk", "rad/s3", 1, "smaller"),
    Measure(
        "measures.speed_variation_mps",
        "total variation of speed commands",
        "m/s",
        2,
        "smaller",
    ),
    Measure(
        "measures.turn_variation_radps",
        "total variation of turn commands",
        "rad/s",
        2,
        "smaller",
    ),
    Measure(
        "measures.rms_speed_step_mps", "rms step of speed commands", "m/s", 4, "smaller"
    ),
    Measure(
        "measures.rms_turn_step_radps",
        "rms step of turn commands",
        "rad/s",
        4,
        "smaller",
    ),
    Measure("measures.off_plan_m", "mean distance from the plan", "m", 3, "smaller"),
    Measure(
        "measures.rotation_rad", "rotation", "rad", 2, "smaller", successes_only=True
    ),
    Measure("recoveries", "recoveries", "", 2),
    Measure("measures.unanswered_cycles", "unanswered cycles", "", 2, "smaller"),
    Measure("wall_clock.missed_cycles", "missed cycles", "", 2, "smaller"),
    Measure(
        "wall_clock.compute_p50_ms", "compute time per cycle, p50", "ms", 2, "smaller"
    ),
    Measure(
        "wall_clock.compute_p95_ms", "compute time per cycle, p95", "ms", 2, "smaller"
    ),
    Measure(
        "wall_clock.compute_max_ms", "compute time per cycle, max", "ms", 2, "smaller"
    ),
    Measure(
        "motion.moving_clearance_m",
        "smallest clearance to what moves",
        "m",
        3,
        "larger",
    ),
    Measure(
        "motion.time_to_collision_s", "shortest time to collision", "s", 2, "larger"
    ),
    Measure("motion.near_s", "time within 0.5 m of what moves", "s", 2, "smaller"),
    Measure(
        "motion.path_over_straight",
        "driven by straight length",
        "",
        3,
        "smaller",
        successes_only=True,
    ),
    Measure(
        "motion.time_over_straight",
        "time by that of the straight run",
        "",
        3,
        "smaller",
        successes_only=True,
    ),
    Measure("motion.hit_robot_mps", "own speed when hit", "m/s", 2, "smaller"),
    Measure("motion.hit_closing_mps", "closing speed when hit", "m/s", 2, "smaller"),
    Measure(
        "motion.hit_robot_share",
        "own share of the closing speed",
        "",
        1,
        "smaller",
        percent=True,
    ),
)
MEASURES = {measure.key: measure for measure in _CATALOG}
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
# What reports and summaries list beside the scores.
DRIVEN = _KEYS[_KEYS.index("driven_m") : _KEYS.index(MOVING[0])]
COMPARED = (
    *SCORED,
    "driven_m",
    "min_clearance_m",
    "contact_s",
    "rms_jerk_mps3",
    "rotation_rad",
    "compute_p50_ms",
    "compute_p95_ms",
)


def with_moving_measures(keys: Sequence[str], *groups: Rows) -> tuple[str, ...]:
    """Add the measures for moving obstacles where every planner has met some.

    Args:
        keys: Keys of measures.
        *groups: Results of each planner.
    """
    meets_motion = [
        any(result.motion is not None for result in results) for results in groups
    ]
    if meets_motion and all(meets_motion):
        return (*keys, *MOVING)
    return tuple(keys)


def require_measures(names: Sequence[str]) -> tuple[str, ...]:
    """Return keys of measures without repetitions.

    Raises:
        ConfigError: The catalog does not have one of them.
    """
    for name in names:
        if name not in MEASURES:
            raise ConfigError(f"unknown measure {name!r}{suggest(name, MEASURES)}")
    return tuple(dict.fromkeys(names))


def ranking_measure(results: Rows) -> Measure:
    """Return the measure by which the protocol of results ranks planners."""
    first = results[0]
    if first.metric:
        return MEASURES[first.metric]
    # Rows of schema 1 do not name it.
    if first.protocol == CHALLENGE.name:
        return MEASURES["challenge"]
    return MEASURES["normalised_time_s_per_m"]


def clearance_measure(results: Rows) -> Measure:
    """Return the clearance that says how safe trials were.

    Where all trials are among moving obstacles, it is the clearance to these.
    """
    if all(result.motion is not None for result in results):
        return MEASURES["moving_clearance_m"]
    return MEASURES["min_clearance_m"]
