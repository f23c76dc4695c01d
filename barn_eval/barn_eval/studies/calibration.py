"""How closely planners agree with published trials of the same worlds (the paper's, Sec. IV)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from barn_eval.analysis.published import Trials, read_published
from barn_eval.analysis.sources import Entry, read_entries
from barn_eval.analysis.statistics import mean_over_trials, rank_correlation, ratio_of_means, repetition_spread, wilson
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import Interval
from barn_worlds.errors import ConfigError

Floats = npt.NDArray[np.float64]
# Path lengths of the same world: tables hold them with six decimals.
_SAME_LENGTH_M = 0.001
# The easy worlds of a planner: this share of the common ones, those it was quickest in when published.
EASY_SHARE = 0.2


@dataclass(frozen=True)
class Side:
    """What ours and the published trials have each; intervals are of 95 %.

    trials, failure_share: with failures counted. normalised_s_per_m: mean over all trials, failures as they count.
    spread_s_per_m: standard deviation over a world's trials, averaged over worlds. easy_s: mean time in the easy
    worlds, easy_range_s: lowest and highest mean of one of them.
    """

    trials: int
    failure_share: Interval
    normalised_s_per_m: Interval
    spread_s_per_m: float
    easy_s: Interval
    easy_range_s: tuple[float, float]


@dataclass(frozen=True)
class WorldTimes:
    """Mean times in one world, failures as they count, and how many failed."""

    world: int
    ours_s: float
    published_s: float
    our_failures: int
    published_failures: int


@dataclass(frozen=True)
class Calibration:
    """The agreement of one planner with the table.

    Correlations are Spearman's over worlds, of mean times per metre: of all trials with failures as they count, and
    of successful ones, in worlds where both have some. bias_percent: of the mean time per metre, against the
    published one. The two of equal failures count every failure of both sides with 30 s, since a trial cut off stands
    with 50 s in the table and most failures with 30 s. easy_worlds: see `EASY_SHARE`.
    """

    label: str
    planner: str
    protocol: str
    worlds: tuple[WorldTimes, ...]
    correlation: Interval
    correlation_of_successes: Interval
    bias_percent: Interval
    correlation_of_equal_failures: Interval
    bias_percent_of_equal_failures: Interval
    ours: Side
    published: Side
    easy_worlds: tuple[int, ...]


@dataclass(frozen=True)
class Joint:
    """Spearman's correlation over worlds of the mean of several planners' times per metre, failures counted."""

    labels: tuple[str, ...]
    worlds: int
    correlation: Interval


@dataclass(frozen=True)
class CalibrationReport:
    """The agreement of each planner, and of those together that belong together."""

    planners: tuple[Calibration, ...]
    joint: tuple[Joint, ...]


def calibrate(folders: Sequence[Path], reference: Path) -> CalibrationReport:
    """Compare the planners of runs and campaigns with a table of published times.

    Planners that the table does not have are left out. ConfigError in one line if none is left, if a planner has no
    world of the table, or if worlds of the same number have other paths.
    """
    table = read_published(reference)
    entries = [entry for entry in read_entries(folders) if entry.planner in table]
    if not entries:
        raise ConfigError(f"{reference}: has times of {', '.join(table)}, the results of none of these")
    pairs = {entry.label: _common(entry, table[entry.planner], reference) for entry in entries}
    planners = tuple(_calibration(entry, *pairs[entry.label]) for entry in entries)
    groups = _together(entries)
    return CalibrationReport(planners, tuple(_joint({label: pairs[label] for label in group}) for group in groups))


def _common(entry: Entry, published: Trials, reference: Path) -> tuple[Trials, Trials]:
    """Return our trials and the published ones in the worlds that both have."""
    ours = _trials(entry.results)
    shared = ours.lengths_m.keys() & published.lengths_m.keys()
    if not shared:
        raise ConfigError(f"{reference}: has no world in common with the results of {entry.label}")
    for world in sorted(shared):
        length_m, theirs_m = ours.lengths_m[world], published.lengths_m[world]
        if abs(length_m - theirs_m) > _SAME_LENGTH_M:
            raise ConfigError(
                f"{reference}: the path of world {world} is {theirs_m:.3f} m there and {length_m:.3f} m in the results"
                f" of {entry.label}: these are other worlds"
            )
    return ours.only(shared), published.only(shared)


def _trials(results: Sequence[TrialResult]) -> Trials:
    return Trials(
        np.array([one.world for one in results], np.int64),
        np.array([one.scores.scored_time_s for one in results]),
        np.array([not one.scores.success for one in results]),
        {one.world: one.scores.path_length_m for one in results},
    )


def _calibration(entry: Entry, ours: Trials, published: Trials) -> Calibration:
    easy = _easy_worlds(published)
    equal = ours.with_equal_failures(), published.with_equal_failures()
    return Calibration(
        label=entry.label,
        planner=entry.planner,
        protocol=", ".join(sorted({one.protocol for one in entry.results})),
        worlds=_world_times(ours, published),
        correlation=_correlation(ours, published),
        correlation_of_successes=rank_correlation(_successes(ours), _successes(published)),
        bias_percent=_bias_percent(ours, published),
        correlation_of_equal_failures=_correlation(*equal),
        bias_percent_of_equal_failures=_bias_percent(*equal),
        ours=_side(ours, easy),
        published=_side(published, easy),
        easy_worlds=easy,
    )


def _side(trials: Trials, easy: tuple[int, ...]) -> Side:
    normalised = trials.normalised_s_per_m
    quick = trials.only(set(easy))
    means = _world_means(quick.times_s, quick).values()
    failures, count = int(trials.failed.sum()), len(trials.failed)
    return Side(
        trials=count,
        failure_share=wilson(failures, count),
        normalised_s_per_m=mean_over_trials(normalised, trials.worlds),
        spread_s_per_m=repetition_spread(normalised, trials.worlds),
        easy_s=mean_over_trials(quick.times_s, quick.worlds),
        easy_range_s=(min(means), max(means)),
    )


def _joint(pairs: Mapping[str, tuple[Trials, Trials]]) -> Joint:
    """Return the agreement of the planners' mean in the worlds that all of them have."""
    means = [
        [_world_means(side.normalised_s_per_m, side) for side in (ours, published)]
        for ours, published in pairs.values()
    ]
    shared = sorted(set.intersection(*(set(ours) for ours, _ in means)))
    worlds = np.array(shared, np.int64)
    mine, theirs = (
        np.array([np.mean([of_planner[side][world] for of_planner in means]) for world in shared]) for side in (0, 1)
    )
    return Joint(tuple(pairs), len(shared), rank_correlation((mine, worlds), (theirs, worlds)))


def _together(entries: Sequence[Entry]) -> list[list[str]]:
    """Return the labels that are averaged: all, if no planner is there twice, else those of one folder."""
    if len({entry.planner for entry in entries}) == len(entries):
        groups = [[entry.label for entry in entries]]
    else:
        sources = {entry.source.path: entry.source for entry in entries}.values()
        groups = [[entry.label for entry in entries if entry.source is source] for source in sources]
    return [group for group in groups if len(group) > 1]


def _easy_worlds(published: Trials) -> tuple[int, ...]:
    means = _world_means(published.times_s, published)
    quickest = sorted(means, key=lambda world: (means[world], world))
    return tuple(sorted(quickest[: math.ceil(EASY_SHARE * len(quickest))]))


def _world_times(ours: Trials, published: Trials) -> tuple[WorldTimes, ...]:
    mine, theirs = _world_means(ours.times_s, ours), _world_means(published.times_s, published)
    return tuple(
        WorldTimes(
            world,
            mine[world],
            theirs[world],
            int(ours.failed[ours.worlds == world].sum()),
            int(published.failed[published.worlds == world].sum()),
        )
        for world in mine
    )


def _world_means(values: Floats, trials: Trials) -> dict[int, float]:
    """Return the mean of the values (n,) of each world's trials, worlds ascending."""
    return {int(world): float(values[trials.worlds == world].mean()) for world in np.unique(trials.worlds)}


def _successes(trials: Trials) -> tuple[Floats, npt.NDArray[np.int64]]:
    return np.where(trials.failed, np.nan, trials.normalised_s_per_m), trials.worlds


def _correlation(ours: Trials, published: Trials) -> Interval:
    return rank_correlation((ours.normalised_s_per_m, ours.worlds), (published.normalised_s_per_m, published.worlds))


def _bias_percent(ours: Trials, published: Trials) -> Interval:
    """Return how far our mean time per metre is from the published one; every world counts alike."""
    mine, theirs = (np.array(list(_world_means(side.normalised_s_per_m, side).values())) for side in (ours, published))
    ratio = ratio_of_means(mine, theirs)
    low, high = (None if limit is None else 100.0 * (limit - 1.0) for limit in (ratio.low, ratio.high))
    return Interval(100.0 * (ratio.estimate - 1.0), low, high)
