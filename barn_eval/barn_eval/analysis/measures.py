"""The catalogue of measures: what each figure of a trial is called, its unit, and which way is better.

Tables, comparisons, rankings, pages and figures name measures by their key and write values as the catalogue says.
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
    """A figure of a trial.

    path: of the field of a result that has it, in parts that not all trials have. better: which way is.
    successes_only: whether means and comparisons leave failed trials out. maximum: the highest value there can be,
    where readers need it. percent: whether it lies in 0 to 1 and is shown in percent. as_failure: what a trial counts
    with, or would, as a failure; None where failures have no value of their own. of: what it is computed by where no
    field has it.
    """

    path: str
    label: str
    unit: str
    digits: int
    better: Better = ""
    successes_only: bool = False
    maximum: float | None = None
    percent: bool = False
    as_failure: Callable[[TrialResult], float] | None = None
    of: Callable[[TrialResult], float] | None = None

    @property
    def key(self) -> str:
        """Its column in the tables of results, or its own name where there is none."""
        return self.path.rpartition(".")[2]

    def value(self, result: TrialResult) -> float | None:
        """Return the figure of a trial, None where it has none."""
        found: Any = result
        for name in self.path.split("."):
            found = getattr(found, name, None)
        return self.of(result) if self.of else found

    @property
    def title(self) -> str:
        """The label, and which trials are in."""
        return f"{self.label} of successes" if self.successes_only else self.label

    @property
    def heading(self) -> str:
        """The title with its unit, for tables and axes."""
        return self._with_unit(self.title)

    @property
    def trial_heading(self) -> str:
        """The label with its unit, for the values of single trials."""
        return self._with_unit(self.label)

    @property
    def after(self) -> str:
        """What follows a value in a sentence: its unit."""
        return " %" if self.percent else f" {self.unit}".rstrip()

    def values(self, results: Rows) -> Floats:
        """Return the value of each trial (n,), NaN where it has none that counts."""
        found = (
            self.value(one) if one.scores.success or not self.successes_only else None
            for one in results
        )
        return np.array([np.nan if one is None else one for one in found], np.float64)

    @property
    def best(self) -> float:
        """The best value that there can be, of a measure that counts failures."""
        if self.better == "smaller":
            return 0.0
        return 1.0 if self.maximum is None else self.maximum

    def shown(self, interval: Interval) -> Interval:
        """Return an estimate of the measure in the unit of its heading."""
        return interval.scale(100.0) if self.percent else interval

    def text(self, interval: Interval) -> str:
        """Return an estimate of the measure with its limits, without the unit."""
        return self.shown(interval).text(self.digits)

    def number(self, value: float | None) -> str:
        """Return a value of the measure without the unit."""
        return number(
            100.0 * value if self.percent and value is not None else value, self.digits
        )

    def _with_unit(self, name: str) -> str:
        of = "" if self.maximum is None else f" (of {self.maximum:g})"
        unit = "%" if self.percent else self.unit
        return f"{name}{of} [{unit}]" if unit else f"{name}{of}"


def _nothing(_: TrialResult) -> float:
    return 0.0


def _failure_s_per_m(result: TrialResult) -> float:
    return result.scores.failure_time_s / result.scores.path_length_m


def _path_ratio(result: TrialResult) -> float:
    return result.measures.driven_m / result.scores.path_length_m


_FAILURE_S = attrgetter("scores.failure_time_s")
_TIME = "scores.normalised_time_s_per_m"
_ALL = (
    Measure(
        "scores.success", "success", "", 1, "larger", percent=True, as_failure=_nothing
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
        _TIME,
        "time per metre as counted",
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
        as_failure=_nothing,
    ),
    Measure(
        "scores.challenge_2022",
        "challenge metric of 2022",
        "",
        3,
        "larger",
        maximum=0.25,
        as_failure=_nothing,
    ),
    Measure(
        "scores.efficiency",
        "efficiency",
        "",
        1,
        "larger",
        percent=True,
        as_failure=_nothing,
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
        of=_path_ratio,
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
MEASURES = {one.key: one for one in _ALL}
SCORED = tuple(one.key for one in _ALL if one.path.startswith("scores.") and one.better)
MOVING = tuple(one.key for one in _ALL if one.path.startswith("motion."))
_KEYS = tuple(MEASURES)
DRIVEN = _KEYS[
    _KEYS.index("driven_m") : _KEYS.index(MOVING[0])
]  # what reports and summaries say beside
COMPARED = (
    *SCORED,
    "driven_m",
    "min_clearance_m",
    "contact_s",
    "rms_jerk_mps3",
    "rotation_rad",
)
COMPARED += ("compute_p50_ms", "compute_p95_ms")


def with_motion(keys: Sequence[str], *groups: Rows) -> tuple[str, ...]:
    """Return keys of measures, and those made for moving obstacles where each group has trials among such."""
    moving = bool(groups) and all(
        any(one.motion is not None for one in group) for group in groups
    )
    return (*keys, *MOVING) if moving else tuple(keys)


def measures_named(names: Sequence[str]) -> tuple[str, ...]:
    """Return keys of measures as they are; ConfigError for one that the catalogue does not have."""
    for name in names:
        if name not in MEASURES:
            raise ConfigError(f"unknown measure {name!r}{suggest(name, MEASURES)}")
    return tuple(dict.fromkeys(names))


def metric_of(results: Rows) -> Measure:
    """Return the measure that the protocol of results ranks planners by; rows of version 1 do not name it."""
    first = results[0]
    return MEASURES[
        first.metric
        or (
            "challenge"
            if first.protocol == CHALLENGE.name
            else "normalised_time_s_per_m"
        )
    ]


def safety_of(results: Rows) -> Measure:
    """Return the clearance that tells how safe trials were: to what moves, where all were among such."""
    return MEASURES[
        "moving_clearance_m"
        if all(one.motion is not None for one in results)
        else "min_clearance_m"
    ]
