"""How closely planners agree with published trials of the same worlds.

The published trials are the paper's (Sec. IV).
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from evaluation import determination
from published import FAILURE_TIME_S, TimedTrials, read_published

from barn_eval.analysis.entries import Entry, read_entries
from barn_eval.analysis.significance import proportion
from barn_eval.analysis.statistics import (
    mean_interval,
    rank_correlation,
    repetition_spread,
)
from barn_metrics.bootstrap import Interval, bootstrap_interval
from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.errors import ConfigError

# The easy worlds of a planner: this share of the common ones, those it was quickest in
# when published.
EASY_SHARE = 0.2
FIGURES = (".png", ".svg", ".pdf")  # what the scatter can be written as


@dataclass(frozen=True)
class Side:
    """What ours and the published trials have each; intervals are of 95%.

    trials, failure_share: with failures counted. normalised_s_per_m: mean over all
    trials, failures as they count. successes_s_per_m: mean over the successful trials,
    NaN where there is none. spread_s_per_m: standard deviation over a world's trials,
    averaged over worlds. easy_s: mean time in the easy worlds, easy_range_s: lowest and
    highest mean of one of them.
    """

    trials: int
    failure_share: Interval
    normalised_s_per_m: Interval
    successes_s_per_m: float
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

    Correlations are Spearman's over worlds, of mean times per meter: of all trials with
    failures as they count, and of successful ones, in worlds where both have some.
    bias_percent: of the mean time per meter, against the published one. Those of equal
    failures count every failure of both sides with 30 s, since a trial cut off stands
    with 50 s in the table and most failures with 30 s. determination: R2 of our means
    as they are, not of a line through them, for the published ones. easy_worlds: see
    `EASY_SHARE`.
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
    determination_of_equal_failures: Interval
    ours: Side
    published: Side
    easy_worlds: tuple[int, ...]


@dataclass(frozen=True)
class Joint:
    """The agreement over worlds of the mean of several planners' times per meter.

    correlation: Spearman's, failures as they count. determination_of_equal_failures:
    R2, each failure as 30 s.
    """

    labels: tuple[str, ...]
    worlds: int
    correlation: Interval
    determination_of_equal_failures: Interval


@dataclass(frozen=True)
class CalibrationReport:
    """The agreement of each planner, and of those together that belong together."""

    planners: tuple[Calibration, ...]
    joint: tuple[Joint, ...]


def calibrate(folders: Sequence[Path], reference: Path) -> CalibrationReport:
    """Compare the planners of runs and campaigns with a table of published times.

    Planners that the table does not have are left out. ConfigError in one line if none
    is left, if a planner has no world of the table, or if worlds of the same number
    have other paths.
    """
    table = read_published(reference)
    entries = [entry for entry in read_entries(folders) if entry.planner in table]
    if not entries:
        raise ConfigError(
            f"{reference}: has times of {', '.join(table)}, the results of none of these"
        )
    pairs = {
        entry.label: _common(entry, table[entry.planner], reference)
        for entry in entries
    }
    planners = tuple(_calibration(entry, *pairs[entry.label]) for entry in entries)
    groups = _together(entries)
    joint = []
    for group in groups:
        joint.append(_joint({label: pairs[label] for label in group}))
    return CalibrationReport(planners, tuple(joint))


def _common(
    entry: Entry, published: TimedTrials, reference: Path
) -> tuple[TimedTrials, TimedTrials]:
    """Return our trials and the published ones in the worlds that both have."""
    ours = TimedTrials(
        np.array([result.world for result in entry.results], np.int64),
        np.array([result.scores.scored_time_s for result in entry.results]),
        np.array([not result.scores.success for result in entry.results]),
        {result.world: result.scores.path_length_m or 0.0 for result in entry.results},
    )
    shared = sorted(ours.lengths_m.keys() & published.lengths_m.keys())
    if not shared:
        raise ConfigError(
            f"{reference}: no world in common with the results of {entry.label}"
        )
    other = published.other_length((world, ours.lengths_m[world]) for world in shared)
    if other is not None:
        raise ConfigError(
            f"{reference}: the path of world {other} is {published.lengths_m[other]:.3f} m there and "
            f"{ours.lengths_m[other]:.3f} m in the results of {entry.label}: these are other worlds"
        )
    return _only(ours, shared), _only(published, shared)


def _calibration(
    entry: Entry, ours: TimedTrials, published: TimedTrials
) -> Calibration:
    easy = _easy_worlds(published)
    equal = _equal_failures(ours), _equal_failures(published)
    return Calibration(
        label=entry.label,
        planner=entry.planner,
        protocol=", ".join(sorted({result.protocol for result in entry.results})),
        worlds=_world_times(ours, published),
        correlation=_correlation(ours, published),
        correlation_of_successes=rank_correlation(
            _successes(ours), _successes(published)
        ),
        bias_percent=_bias_percent(ours, published),
        correlation_of_equal_failures=_correlation(*equal),
        bias_percent_of_equal_failures=_bias_percent(*equal),
        determination_of_equal_failures=_determination([equal]),
        ours=_side(ours, easy),
        published=_side(published, easy),
        easy_worlds=easy,
    )


def _side(trials: TimedTrials, easy: tuple[int, ...]) -> Side:
    quick = _only(trials, easy)
    means = _by_world(quick, quick.times_s).values()
    succeeded = trials.normalised_s_per_m[~trials.failed]
    return Side(
        trials=len(trials.failed),
        failure_share=proportion(trials.failed.astype(np.int64), trials.worlds),
        normalised_s_per_m=mean_interval(trials.normalised_s_per_m, trials.worlds),
        successes_s_per_m=float(np.mean(succeeded)) if len(succeeded) else math.nan,
        spread_s_per_m=repetition_spread(trials.normalised_s_per_m, trials.worlds),
        easy_s=mean_interval(quick.times_s, quick.worlds),
        easy_range_s=(min(means), max(means)),
    )


def _joint(pairs: Mapping[str, tuple[TimedTrials, TimedTrials]]) -> Joint:
    """Return the agreement of the planners' mean in the worlds that all have."""
    worlds, mine, theirs = _means_of_planners(list(pairs.values()))
    equal = [
        (_equal_failures(ours), _equal_failures(published))
        for ours, published in pairs.values()
    ]
    return Joint(
        tuple(pairs),
        len(worlds),
        rank_correlation((mine, worlds), (theirs, worlds)),
        _determination(equal),
    )


def _means_of_planners(
    pairs: Sequence[tuple[TimedTrials, TimedTrials]],
) -> tuple[Integers, Floats, Floats]:
    """Return the worlds (n,) that all planners have and the planners' mean times there.

    The times are ours and the published ones, each (n,).
    """
    means = [
        [_by_world(side, side.normalised_s_per_m) for side in pair] for pair in pairs
    ]
    shared = sorted(set.intersection(*(set(ours) for ours, _ in means)))
    mine, theirs = (
        np.array(
            [
                np.mean([of_planner[side][world] for of_planner in means])
                for world in shared
            ]
        )
        for side in (0, 1)
    )
    return np.array(shared, np.int64), mine, theirs


def _determination(pairs: Sequence[tuple[TimedTrials, TimedTrials]]) -> Interval:
    _, mine, theirs = _means_of_planners(pairs)
    return determination(mine[None], theirs)


def _together(entries: Sequence[Entry]) -> list[list[str]]:
    """Return the labels that are averaged.

    All of one task if no planner is there twice, else those of one folder.
    """
    tasks = {result.task for entry in entries for result in entry.results}
    if len({entry.planner for entry in entries}) == len(entries) and len(tasks) == 1:
        groups = [[entry.label for entry in entries]]
    else:
        sources = {entry.source.path: entry.source for entry in entries}.values()
        groups = [
            [entry.label for entry in entries if entry.source is source]
            for source in sources
        ]
    return [group for group in groups if len(group) > 1]


def _easy_worlds(published: TimedTrials) -> tuple[int, ...]:
    means = _by_world(published, published.times_s)
    quickest = sorted(means, key=lambda world: (means[world], world))
    count = math.ceil(EASY_SHARE * len(quickest))
    return tuple(sorted(quickest[:count]))


def _world_times(ours: TimedTrials, published: TimedTrials) -> tuple[WorldTimes, ...]:
    mine, theirs = (_by_world(side, side.times_s) for side in (ours, published))
    failed = [
        {world: int(side.failed[side.worlds == world].sum()) for world in mine}
        for side in (ours, published)
    ]
    return tuple(
        WorldTimes(
            number, mine[number], theirs[number], failed[0][number], failed[1][number]
        )
        for number in mine
    )


def _successes(trials: TimedTrials) -> tuple[Floats, Integers]:
    return np.where(trials.failed, np.nan, trials.normalised_s_per_m), trials.worlds


def _correlation(ours: TimedTrials, published: TimedTrials) -> Interval:
    return rank_correlation(
        (ours.normalised_s_per_m, ours.worlds),
        (published.normalised_s_per_m, published.worlds),
    )


def _bias_percent(ours: TimedTrials, published: TimedTrials) -> Interval:
    """Return how far our mean time per meter is from the published one.

    Every world counts alike.
    """
    mine, theirs = (
        np.array(list(_by_world(side, side.normalised_s_per_m).values()))
        for side in (ours, published)
    )
    ratio = bootstrap_interval(
        lambda sample: mine[sample].sum(axis=-1) / theirs[sample].sum(axis=-1),
        len(mine),
    )
    low, high = (
        None if limit is None else 100.0 * (limit - 1.0)
        for limit in (ratio.low, ratio.high)
    )
    return Interval(100.0 * (ratio.estimate - 1.0), low, high)


def _equal_failures(trials: TimedTrials) -> TimedTrials:
    """Return trials with every failure counted as `FAILURE_TIME_S`."""
    return replace(
        trials, times_s=np.where(trials.failed, FAILURE_TIME_S, trials.times_s)
    )


def _only(trials: TimedTrials, worlds: Collection[int]) -> TimedTrials:
    """Return the trials in some of the worlds."""
    selected = np.isin(trials.worlds, sorted(worlds))
    return TimedTrials(
        trials.worlds[selected],
        trials.times_s[selected],
        trials.failed[selected],
        trials.lengths_m,
    )


def _by_world(trials: TimedTrials, values: Floats) -> dict[int, float]:
    """Return the mean of a value per trial (n,) over each world's trials.

    Worlds are ascending.
    """
    return {
        int(world): float(values[trials.worlds == world].mean())
        for world in np.unique(trials.worlds)
    }
