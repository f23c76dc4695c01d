"""How well a set of worlds ranks planners: how often so many of its worlds bring them into the right order."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.compare import columns
from barn_eval.analysis.measures import MEASURES, Measure, metric_of
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.statistics import matched_trials
from barn_eval.analysis.text_table import TextTable, joined
from barn_eval.analysis.verdict import rank_results
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import number
from barn_worlds.base.errors import ConfigError, suggest

DRAWN_WORLDS = (10, 20, 50, 100, 200, 300)
SURE = 0.95
_DRAWS = 2000


@dataclass(frozen=True)
class RankingPower:
    """How well worlds of a data set rank planners by a measure, named by its key.

    planners: best first; differing: the pairs (better, worse) that are clear over all worlds. worlds: that all planners
    have. shares: by number of worlds, the share of draws in which all these pairs come in the right order. enough: the
    fewest worlds from which that is 95 %, None where not even all are enough.
    """

    dataset: str
    measure: str
    planners: tuple[str, ...]
    differing: tuple[tuple[str, str], ...]
    worlds: int
    shares: Mapping[int, float]
    enough: int | None


def ranking_power(
    results: Mapping[str, Sequence[TrialResult]], measures: Sequence[str] = (), seed: int = 0
) -> list[RankingPower]:
    """Return how well the worlds of results rank their planners, by measures or by the metric of the protocol.

    Worlds are drawn with replacement, so as to stand for other worlds of the same kind. The order and which planners
    differ are taken from the same results, over all worlds; ConfigError for fewer than two planners or an unknown
    measure.
    """
    first = next(iter(results.values()))
    if len(results) < 2:
        raise ConfigError(f"a ranking needs two planners; there is {', '.join(results)} only")
    for key in measures:
        if key not in MEASURES or not MEASURES[key].better:
            raise ConfigError(f"unknown measure {key!r}{suggest(key, MEASURES)}")
    return [_power(results, MEASURES[key], seed) for key in measures or (metric_of(first).key,)]


def _power(results: Mapping[str, Sequence[TrialResult]], measure: Measure, seed: int) -> RankingPower:
    ranking = rank_results(results, measure)
    differing = [places for places in ranking.p if ranking.clear(*places)]
    rows = matched_trials([columns(results[name], measure) for name in ranking.names])
    world = np.unique(rows[0].worlds, return_inverse=True)[1]
    count = ranking.worlds
    sign = 1.0 if measure.better == "larger" else -1.0
    sums = sign * np.array([np.bincount(world, row.values, minlength=count) for row in rows])
    drawn = np.random.default_rng(seed).integers(0, max(count, 1), (_DRAWS, count))
    right = np.ones((_DRAWS, count), bool)
    for better, worse in differing:
        right &= np.cumsum((sums[better] - sums[worse])[drawn], axis=1) > 0.0
    by_worlds = right.mean(axis=0)
    short = np.flatnonzero(by_worlds < SURE)
    enough = int(short[-1]) + 2 if len(short) else 1
    return RankingPower(
        ", ".join(sorted({one.dataset for own in results.values() for one in own})),
        measure.key,
        tuple(map(spelling, ranking.names)),
        tuple((spelling(ranking.names[i]), spelling(ranking.names[j])) for i, j in differing),
        count,
        {n: float(by_worlds[n - 1]) for n in DRAWN_WORLDS if n <= count} if differing else {},
        enough if differing and enough <= count else None,
    )


def ranking_table(found: Sequence[RankingPower]) -> TextTable:
    """Return a row per set and measure."""
    sizes = [n for n in DRAWN_WORLDS if any(n in one.shares for one in found)]
    rows = [
        (
            one.dataset,
            MEASURES[one.measure].title,
            joined(one.planners),
            f"{len(one.differing)} of {len(one.planners) * (len(one.planners) - 1) // 2}",
            *(number(100.0 * one.shares[n], 1) if n in one.shares else "-" for n in sizes),
            str(one.enough or f"over {one.worlds}"),
        )
        for one in found
    ]
    columns = ("set", "measure", "planners, best first", "pairs that differ", *map(str, sizes), "95 % from")
    title = "Draws of so many worlds in which all planners that differ come in the right order [%]"
    return TextTable("ranking", title, columns, tuple(rows), texts=3)
