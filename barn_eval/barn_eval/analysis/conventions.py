"""Rank physical trials by the rules of events: which attempts count, and how."""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from barn_eval.analysis.entries import read_entries
from barn_eval.analysis.sources import require_same_task
from barn_eval.analysis.text_table import TextTable
from barn_eval.trials.result import Rows, TrialResult
from barn_worlds.base.config import Checked, from_dict, quantity
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import read_package_yaml


@dataclass(frozen=True)
class Convention(Checked):
    """How an event counts the attempts at its courses."""

    best: int = quantity(
        0, "number of successes that count, the fastest first; 0: all trials"
    )
    window_s: float = quantity(
        0.0, "time limit from the first attempt at a course; 0: none", "s"
    )
    reference: str = quantity("", "planner whose fastest success is the reference time")


CONVENTIONS = {
    name: from_dict(Convention, content, f"conventions.yaml: {name}")
    for name, content in read_package_yaml("barn_eval", "conventions.yaml").items()
}


_COLUMNS = (
    "rank",
    "planner",
    "courses",
    "attempts",
    "late",
    "count",
    "time [s]",
    "time over reference",
)
# Rows by data set and number of their world.
_Courses = dict[tuple[str, int], list[TrialResult]]


@dataclass(frozen=True)
class Place:
    """A planner's counted trials and times, over all its courses."""

    planner: str
    courses: int
    attempts: int
    # Attempts that ended after the window; None if rows do not say when they began.
    late: int | None
    # Trials that count, and the mean over courses of their mean time [s].
    counted: int
    time_s: float | None
    # Mean over courses of mean time divided by the reference's; None without one.
    over_reference: float | None


def rank_by_convention(paths: Sequence[Path], convention: Convention) -> list[Place]:
    """Rank planners but the reference by counted trials, then time; ConfigError if none.

    Args:
        paths: Results folders of one task, including those of the reference.
        convention: Rules of the event.

    Returns:
        The planners without the reference, the best first.

    Raises:
        ConfigError: If tasks differ, or only the reference has trials.
        BarnError: If a folder cannot be read.
    """
    require_same_task(paths)
    entries = read_entries(paths)
    references_s: dict[tuple[str, int], float] = {}
    for entry in entries:
        if entry.planner == convention.reference:
            for course, rows in _by_course(entry.results).items():
                times_s = _successes_s(rows)
                if times_s:
                    references_s[course] = min(times_s)

    places = []
    for entry in entries:
        if entry.planner != convention.reference:
            courses = _by_course(entry.results)
            places.append(_place(entry.label, courses, convention, references_s))
    if not places:
        raise ConfigError(f"{paths[0]}: has only trials of {convention.reference}")
    places.sort(key=lambda place: (-place.counted, place.time_s or math.inf))
    return places


def convention_table(places: Sequence[Place], name: str) -> TextTable:
    """Return places as a text table in their order, "-" for what is unknown.

    Args:
        places: The planners.
        name: Name of the convention.
    """
    rows = []
    for rank, place in enumerate(places, 1):
        cells = [str(rank), place.planner]
        for value in astuple(place)[1:]:
            text = f"{value:.2f}" if isinstance(value, float) else str(value)
            cells.append("-" if value is None else text)
        rows.append(cells)
    title = f"by the convention {name}; late: - if rows do not say when they began"
    return TextTable("convention", title, _COLUMNS, rows, texts=2)


def _by_course(rows: Rows) -> _Courses:
    """Return rows by data set and number of their world."""
    courses: _Courses = {}
    for row in rows:
        courses.setdefault((row.dataset, row.world), []).append(row)
    return courses


def _place(
    planner: str,
    courses: _Courses,
    convention: Convention,
    references_s: dict[tuple[str, int], float],
) -> Place:
    """Return one planner's place: counts, mean time, and its ratio to the reference."""
    attempts = sum(map(len, courses.values()))
    timely_attempts = 0
    counted = 0
    means_s = []
    ratios = []
    for course, rows in courses.items():
        timely = select_timely(rows, convention.window_s)
        timely_attempts += len(timely)
        times_s = [row.scores.scored_time_s for row in timely]
        if convention.best:
            times_s = sorted(_successes_s(timely))[: convention.best]
        if times_s:
            counted += len(times_s)
            means_s.append(float(np.mean(times_s)))
            ratios.append(means_s[-1] / references_s.get(course, math.nan))
    is_known = all(
        row.wall_clock.started_at for rows in courses.values() for row in rows
    )
    return Place(
        planner,
        len(courses),
        attempts,
        attempts - timely_attempts if is_known else None,
        counted,
        _mean(means_s),
        _mean(ratios),
    )


def _mean(values: Sequence[float]) -> float | None:
    """Return the mean; None without values, or if one is not finite."""
    # Of nothing, the mean would be a warning.
    mean = float(np.mean(values or math.nan))
    return mean if math.isfinite(mean) else None


def _successes_s(rows: Rows) -> list[float]:
    """Return the scored times [s] of the successes among rows."""
    return [row.scores.scored_time_s for row in rows if row.scores.success]


def select_timely(rows: Rows, window_s: float) -> Rows:
    """Return rows that ended within `window_s` of the first start; all if 0 or unknown.

    Rows that do not say when they began are kept.

    Args:
        rows: Attempts of one planner at one course.
        window_s: Length of the window from the first start [s]; 0 for no limit.
    """
    starts_s = {}
    for row in rows:
        if row.wall_clock.started_at:
            start = datetime.fromisoformat(row.wall_clock.started_at)
            starts_s[row.trial_id] = start.timestamp()
    if not starts_s or not window_s:
        return rows

    window_end_s = min(starts_s.values()) + window_s
    return [
        row
        for row in rows
        if starts_s.get(row.trial_id, -math.inf) + row.wall_clock.duration_s
        <= window_end_s
    ]
