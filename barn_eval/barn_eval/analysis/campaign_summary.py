"""What a campaign says of each planner, figure by figure with its uncertainty, and of each pair of planners."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.compare import Comparison, compare
from barn_eval.analysis.statistics import mean_over_trials
from barn_eval.analysis.summary import Summary, summarise
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import Interval

Value = Callable[[TrialResult], float | None]


def _path_ratio(result: TrialResult) -> float | None:
    """Return the driven length by the length of the world's path."""
    return result.measures.driven_m / result.scores.path_length_m if result.scores.success else None


# Name, unit and value of what is averaged over trials, beside what `Summary` has.
_MEANS: tuple[tuple[str, str, Value], ...] = (
    ("driven length of successes", "m", lambda one: one.measures.driven_m if one.scores.success else None),
    ("driven by path length of successes", "", _path_ratio),
    ("smallest clearance", "m", lambda one: one.measures.min_clearance_m),
    ("mean clearance", "m", lambda one: one.measures.mean_clearance_m),
    ("time in contact", "s", lambda one: one.measures.contact_s),
    ("rms jerk", "m/s3", lambda one: one.measures.rms_jerk_mps3),
    ("rotation", "rad", lambda one: one.measures.rotation_rad),
    ("recoveries", "", lambda one: one.recoveries),
    ("unanswered cycles", "", lambda one: one.measures.unanswered_cycles),
    ("missed cycles", "", lambda one: one.wall_clock.missed_cycles),
    ("compute time per cycle, p50", "ms", lambda one: one.wall_clock.compute_p50_ms),
    ("compute time per cycle, p95", "ms", lambda one: one.wall_clock.compute_p95_ms),
    ("compute time per cycle, max", "ms", lambda one: one.wall_clock.compute_max_ms),
)


@dataclass(frozen=True)
class Figure:
    """A mean over trials with its interval."""

    name: str
    unit: str
    value: Interval


@dataclass(frozen=True)
class PlannerSummary:
    """What a campaign says of one planner."""

    planner: str
    scores: Summary
    figures: tuple[Figure, ...]


@dataclass(frozen=True)
class CampaignSummary:
    """What a campaign says: of each planner, and of each pair on the worlds and seeds that both met."""

    planners: tuple[PlannerSummary, ...]
    comparisons: tuple[Comparison, ...]


def summarise_campaign(results: Sequence[TrialResult]) -> CampaignSummary:
    """Return the summary of at least one result; planners in the order in which they come."""
    groups = by_planner(results)
    names = list(groups)
    pairs = [(a, b) for number, a in enumerate(names) for b in names[number + 1 :]]
    return CampaignSummary(
        tuple(PlannerSummary(name, summarise(group), _figures(group)) for name, group in groups.items()),
        tuple(compare(groups[a], groups[b]) for a, b in pairs),
    )


def by_planner(results: Sequence[TrialResult]) -> dict[str, list[TrialResult]]:
    """Return the results of each planner."""
    groups: dict[str, list[TrialResult]] = {}
    for result in results:
        groups.setdefault(result.planner, []).append(result)
    return groups


def _figures(results: Sequence[TrialResult]) -> tuple[Figure, ...]:
    worlds = np.array([result.world for result in results], np.int64)
    figures = []
    for name, unit, value in _MEANS:
        values = [value(result) for result in results]
        known = np.array([np.nan if one is None else one for one in values], np.float64)
        figures.append(Figure(name, unit, mean_over_trials(known, worlds)))
    return tuple(figures)
