"""Figures of many trials with their uncertainty, and comparisons of planners.

A world is the unit of sampling: functions take one value per trial and, beside it, the number of its world. Limits of
means are those of `means`, shares and the test of differences those of `significance` beside this. All are the same
for any order of the trials.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from barn_eval.analysis.means import Columns
from barn_eval.analysis.significance import FLIPS, Components, Difference, paired_difference
from barn_metrics.bootstrap import Interval, over_worlds, spearman
from barn_worlds.base.arrays import Floats, Integers


@dataclass(frozen=True)
class Paired:
    """A comparison of A and B on what both did in the same worlds with the same seeds.

    mean_a, mean_b: over those trials. difference: mean of A - B over them. p: two-sided, of the test that flips the
    sign of whole worlds, and not below that at which the interval leaves out 0. parts: variance of the difference.
    improvement: probability that a trial of A is better than one of B in the same world, ties counting half, averaged
    over worlds. failures: the share of failures of each, None where they have no value of their own.
    """

    worlds: int
    trials: int
    mean_a: float
    mean_b: float
    difference: Interval
    p: float
    parts: Components
    improvement: Interval
    failures: tuple[Interval | None, Interval | None] = (None, None)


def repetition_spread(values: Floats, worlds: Integers) -> float:
    """Return the standard deviation over a world's trials, averaged over worlds: the paper's +- (Sec. IV).

    It is that of the trials themselves (divisor n); worlds with one trial have none and no part in the average.
    """
    spreads = [part.std() for part in _groups(values, worlds).values() if len(part) > 1]
    return float(np.mean(spreads)) if spreads else math.nan


def matched_trials(columns: Sequence[Columns]) -> list[Columns]:
    """Return the trials that all planners have a value for, in the same order of worlds and repetitions.

    Trials of one world and repetition belong together; they met the same noise.
    """
    found = [_places(one) for one in columns]
    keys = sorted(set.intersection(*map(set, found)))
    return [
        one.at(np.array([places[key] for key in keys], np.int64)) for one, places in zip(columns, found, strict=True)
    ]


def difference(a: Columns, b: Columns, seed: int = 0, flips: int = FLIPS) -> Difference:
    """Return the mean difference of matched trials, each as `paired_difference` has it.

    Where failures count, it is clear only if it keeps its sign when the better one fails as often as its failures so
    far allow: by the test alone, a quick planner that fails rarely seems better than a steady one of the same mean as
    long as no failure was drawn. Limits hold what either one's failures would make of the difference.
    """
    found = paired_difference(a.values - b.values, a.worlds, seed, flips)
    if not (a.counted and b.counted and found.trials):
        return found
    size, p, ends = found.interval.estimate, found.p, []
    for one, other, cost in ((a, b, a.cost), (b, a, -b.cost)):
        more = one.excess(other)
        ends.append(size - cost * (more.limits[1] - more.share))
        if size * cost > 0.0:
            p = max(p, more.p_above(more.share + size / cost))
    return replace(
        found,
        interval=found.interval.reaching(*ends),
        p=p,
        parts=replace(found.parts, unseen=a.unseen + b.unseen),
    )


def paired(a: Columns, b: Columns, *, larger_is_better: bool, seed: int = 0) -> Paired:
    """Compare two planners on the pairs of trials in which both have a value.

    The probability of improvement looks at every pair of a trial of A and one of B in a world (Agarwal et al. 2021,
    over worlds in place of tasks). Its interval is that of its difference from one half.
    """
    left, right = matched_trials([a, b])
    found = difference(left, right, seed)
    if not found.trials:
        return Paired(0, 0, math.nan, math.nan, found.interval, math.nan, found.parts, Interval(math.nan))
    sign = 1.0 if larger_is_better else -1.0
    groups_a, groups_b = (_groups(sign * one.values, one.worlds) for one in (left, right))
    chances = np.array([_chance(groups_a[world], groups_b[world]) for world in groups_a])
    return Paired(
        found.worlds,
        found.trials,
        float(left.values.mean()),
        float(right.values.mean()),
        found.interval,
        found.p,
        found.parts,
        paired_difference(chances - 0.5, np.array(list(groups_a)), seed).interval.shifted(0.5),
        (left.failure_share(), right.failure_share()),
    )


def rank_correlation(a: tuple[Floats, Integers], b: tuple[Floats, Integers], seed: int = 0) -> Interval:
    """Return Spearman's correlation of two planners' means per world, each given as (values, worlds)."""
    first, second = _groups(*a), _groups(*b)
    shared = sorted(first.keys() & second.keys())
    if len(shared) < 3:
        return Interval(math.nan)
    means = (np.array([groups[world].mean() for world in shared]) for groups in (first, second))
    x, y = (np.unique(one, return_inverse=True)[1] for one in means)  # whole numbers are ranked quickly
    return over_worlds(lambda drawn: spearman(x[drawn], y[drawn]), len(shared), seed)


def _chance(a: Floats, b: Floats) -> float:
    """Return the probability that a value of `a` is above one of `b`, ties counting half."""
    above = a[:, None] - b[None, :]
    return float(np.mean((above > 0.0) + 0.5 * (above == 0.0)))


def _places(columns: Columns) -> dict[tuple[int, int], int]:
    """Return where the trials with a value are, by world and repetition."""
    keys = zip(columns.worlds.tolist(), columns.repetitions.tolist(), columns.values.tolist(), strict=True)
    return {(world, repetition): k for k, (world, repetition, value) in enumerate(keys) if math.isfinite(value)}


def _groups(values: Floats, worlds: Integers) -> dict[int, Floats]:
    """Return the values of each world that are finite, by size, so that no sum depends on the order of the trials."""
    known = np.isfinite(values)
    order = np.lexsort((values[known], worlds[known]))
    values, worlds = values[known][order], worlds[known][order]
    return {int(number): values[worlds == number] for number in np.unique(worlds)}
