"""Planners from best to worst by one figure, with a test of each pair; those that cannot be told apart share a rank."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from barn_eval.analysis.compare import check_pairs, columns
from barn_eval.analysis.means import Columns
from barn_eval.analysis.measures import Measure
from barn_eval.analysis.significance import ALPHA, FLIPS, Difference, holm
from barn_eval.analysis.statistics import difference, matched_trials
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import Interval
from barn_worlds.base.errors import BarnError, ConfigError

_FLIPS_PER_PAIR = 40  # so that the smallest p-value, times the number of pairs, is below ALPHA


@dataclass(frozen=True)
class Ranking:
    """Planners from best to worst, on the trials that all of them have.

    means: of each. differences: by places (i, j), i the better one, of the value of i minus that of j. p: of these,
    after Holm for `tests` pairs. failures: the share of failures of each, None where they have no value of their own.
    """

    names: tuple[str, ...]
    means: tuple[float, ...]
    worlds: int
    trials: int
    differences: Mapping[tuple[int, int], Difference]
    p: Mapping[tuple[int, int], float]
    tests: int
    failures: tuple[Interval | None, ...]

    def clear(self, better: int, worse: int) -> bool:
        """Tell whether one place is clearly better than a later one."""
        return self.p[better, worse] <= ALPHA

    @property
    def leaders(self) -> tuple[int, ...]:
        """The places that are not clearly worse than the first."""
        return tuple(place for place in range(len(self.names)) if place == 0 or not self.clear(0, place))

    @property
    def ranks(self) -> tuple[int, ...]:
        """The rank of each place: a new one begins where all above are clearly better than all from there on.

        So planners whose difference is not clear always share a rank. Within a rank some may differ clearly, if others
        lie between them.
        """
        ranks: list[int] = []
        for place in range(len(self.names)):
            rest = range(place, len(self.names))
            begins = all(self.clear(better, worse) for better in range(place) for worse in rest)
            ranks.append(place + 1 if begins else ranks[-1])
        return tuple(ranks)


def rank_results(results: Mapping[str, Sequence[TrialResult]], measure: Measure) -> Ranking:
    """Rank at least one planner by the results of each; ConfigError if two have not done the same task."""
    try:
        for a, b in combinations(results, 2):
            check_pairs(results[a], results[b])
    except BarnError as error:
        raise ConfigError(f"{a} and {b} cannot be ranked against each other: {error}") from None
    values = {name: columns(own, measure) for name, own in results.items()}
    return rank(values, larger_is_better=measure.better == "larger")


def rank(planners: Mapping[str, Columns], *, larger_is_better: bool, seed: int = 0) -> Ranking:
    """Rank at least one planner, each given by its trials, on those that all have a value for."""
    rows = dict(zip(planners, matched_trials(list(planners.values())), strict=True))
    means = {name: float(row.values.mean()) if len(row.values) else math.nan for name, row in rows.items()}
    sign = -1.0 if larger_is_better else 1.0
    names = sorted(planners, key=lambda name: (sign * means[name], name))
    places = list(combinations(range(len(names)), 2))
    flips = max(FLIPS, _FLIPS_PER_PAIR * len(places))
    differences = {(i, j): difference(rows[names[i]], rows[names[j]], seed, flips) for i, j in places}
    worlds = rows[names[0]].worlds
    return Ranking(
        tuple(names),
        tuple(means[name] for name in names),
        len(set(worlds.tolist())),
        len(worlds),
        differences,
        dict(zip(places, holm([differences[place].p for place in places]), strict=True)),
        len(places),
        tuple(rows[name].failure_share() for name in names),
    )
