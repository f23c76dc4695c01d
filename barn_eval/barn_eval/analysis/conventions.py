"""How events count physical trials: which attempts count, and against whose time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
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

    best: int = quantity(0, "fastest successes at a course that count; 0: all trials")
    window_s: float = quantity(
        0.0, "time from the first attempt at a course; 0: no limit", "s"
    )
    reference: str = quantity("", "planner whose fastest success is the reference")


CONVENTIONS = {
    name: from_dict(Convention, content, f"conventions.yaml: {name}")
    for name, content in read_package_yaml("barn_eval", "conventions.yaml").items()
}


@dataclass(frozen=True)
class Place:
    """What counts of a planner, over all its courses."""

    planner: str
    courses: int
    attempts: int
    # Attempts that ended after the window; None where rows do not say when they began.
    late: int | None
    # Trials that count, and the mean over courses of their mean time [s].
    counted: int
    time_s: float | None
    # Mean over courses of the mean time by the reference's; None without one.
    over_reference: float | None


def rank_by_convention(paths: Sequence[Path], convention: Convention) -> list[Place]:
    """Rank planners by the trials that count, then by their mean time.

    Args:
        paths: Results folders of one task, those of the reference among them.
        convention: What counts.

    Returns:
        The planners without the reference, the best first.

    Raises:
        ConfigError: The tasks differ, or nobody but the reference has trials.
        BarnError: A folder cannot be read.
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
        raise ConfigError(f"{paths[0]}: has trials of {convention.reference} alone")
    places.sort(key=lambda place: (-place.counted, place.time_s or math.inf))
    return places


def convention_table(
    places: Sequence[Place], name: str, convention: Convention
) -> TextTable:
    """Return places as a table, the best first.

    Args:
        places: The planners.
        name: Name of the convention.
        convention: What counts.
    """
    counts = "all trials count"
    if convention.best:
        counts = f"the {convention.best} fastest successes at each course count"
    columns = ["rank", "planner", "courses", "attempts", "count", "time [s]"]
    if convention.window_s:
        columns.insert(4, f"after {convention.window_s / 60.0:g} min")
    if convention.reference:
        columns.append(f"time over {convention.reference}'s")
    rows = []
    for rank, place in enumerate(places, 1):
        cells = [rank, place.planner, place.courses, place.attempts, place.counted]
        if convention.window_s:
            cells.insert(4, "unknown" if place.late is None else place.late)
        cells.append(_text(place.time_s, 1))
        if convention.reference:
            cells.append(_text(place.over_reference, 2))
        rows.append(tuple(map(str, cells)))
    title = f"convention {name}: {counts}"
    return TextTable("convention", title, tuple(columns), tuple(rows), texts=2)


def _text(value: float | None, digits: int) -> str:
    """Return a number, or "-" for an unknown one."""
    return "-" if value is None else f"{value:.{digits}f}"


def _by_course(rows: Rows) -> dict[tuple[str, int], list[TrialResult]]:
    """Return rows by data set and number of their world."""
    courses: dict[tuple[str, int], list[TrialResult]] = {}
    for row in rows:
        courses.setdefault((row.dataset, row.world), []).append(row)
    return courses


def _place(
    planner: str,
    courses: dict[tuple[str, int], list[TrialResult]],
    convention: Convention,
    references_s: dict[tuple[str, int], float],
) -> Place:
    """Return what counts of one planner's trials."""
    late: int | None = 0
    counted = 0
    means_s = []
    ratios = []
    for course, rows in courses.items():
        timely = select_timely(rows, convention.window_s)
        if timely is None:
            timely = rows
            late = None
        elif late is not None:
            late += len(rows) - len(timely)
        times_s = [row.scores.scored_time_s for row in timely]
        if convention.best:
            times_s = sorted(_successes_s(timely))[: convention.best]
        if not times_s:
            continue
        counted += len(times_s)
        means_s.append(float(np.mean(times_s)))
        if course in references_s:
            ratios.append(means_s[-1] / references_s[course])
    return Place(
        planner,
        len(courses),
        sum(map(len, courses.values())),
        late,
        counted,
        _mean(means_s),
        _mean(ratios),
    )


def _mean(values: Sequence[float]) -> float | None:
    """Return the mean; None without values, or if one is unknown."""
    if not values or not np.isfinite(values).all():
        return None
    return float(np.mean(values))


def _successes_s(rows: Rows) -> list[float]:
    """Return the times of successes."""
    return [row.scores.scored_time_s for row in rows if row.scores.success]


def select_timely(rows: Rows, window_s: float) -> Rows | None:
    """Return the rows whose trials ended in the window; None if that is unknown.

    Args:
        rows: Attempts of one planner at one course.
        window_s: Time from the start of the first; 0 for no limit.
    """
    if not window_s:
        return rows
    if not all(row.wall_clock.started_at for row in rows):
        return None
    starts_s = []
    for row in rows:
        start = datetime.fromisoformat(row.wall_clock.started_at)
        starts_s.append(start.timestamp())
    end_s = min(starts_s) + window_s
    timely = []
    for row, start_s in zip(rows, starts_s, strict=True):
        if start_s + row.wall_clock.duration_s <= end_s:
            timely.append(row)
    return timely
