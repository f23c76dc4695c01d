"""Planners from best to worst by one figure, with a test of each pair, and what that says: a sentence, and details.

Those that cannot be told apart share a rank.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

from barn_eval.analysis.compare import Comparison, check_pairs, columns, worlds_of
from barn_eval.analysis.measures import MEASURES, Measure, metric_of
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import (
    ALPHA,
    FLIPS,
    POWER,
    Difference,
    holm,
    p_text,
    worlds_for_difference,
)
from barn_eval.analysis.sources import Source, notes_on
from barn_eval.analysis.statistics import Columns, difference, matched_trials
from barn_eval.analysis.text_table import counted, joined
from barn_eval.trials.result import RowsByPlanner
from barn_metrics.bootstrap import Interval, number
from barn_worlds.base.errors import BarnError, ConfigError

_FLIPS_PER_PAIR = (
    40  # so that the smallest p-value, times the number of pairs, is below ALPHA
)


@dataclass(frozen=True)
class Ranking:
    """Planners from best to worst, on the trials that all of them have.

    means: of each. differences: by places (i, j), i the better one, of the value of i minus that of j. p: of these,
    after Holm for `tests` pairs. failures: the share of failures of each, None where they have no value of their own.
    available: how many worlds their data set has, 0 where that is not known.
    """

    names: tuple[str, ...]
    means: tuple[float, ...]
    worlds: int
    trials: int
    differences: Mapping[tuple[int, int], Difference]
    p: Mapping[tuple[int, int], float]
    tests: int
    failures: tuple[Interval | None, ...]
    available: int = 0

    def clear(self, better: int, worse: int) -> bool:
        """Tell whether one place is clearly better than a later one."""
        return self.p[better, worse] <= ALPHA

    @property
    def leaders(self) -> tuple[int, ...]:
        """The places that are not clearly worse than the first."""
        return tuple(
            place
            for place in range(len(self.names))
            if place == 0 or not self.clear(0, place)
        )

    @property
    def ranks(self) -> tuple[int, ...]:
        """The rank of each place: a new one begins where all above are clearly better than all from there on.

        So planners whose difference is not clear always share a rank. Within a rank some may differ clearly, if others
        lie between them.
        """
        ranks: list[int] = []
        for place in range(len(self.names)):
            rest = range(place, len(self.names))
            begins = all(
                self.clear(better, worse) for better in range(place) for worse in rest
            )
            ranks.append(place + 1 if begins else ranks[-1])
        return tuple(ranks)


def rank_results(results: RowsByPlanner, measure: Measure) -> Ranking:
    """Rank at least one planner by the results of each; ConfigError if two have not done the same task."""
    try:
        for a, b in combinations(results, 2):
            check_pairs(results[a], results[b])
    except BarnError as error:
        raise ConfigError(
            f"{a} and {b} cannot be ranked against each other: {error}"
        ) from None
    values = {name: columns(own, measure) for name, own in results.items()}
    found = rank(values, larger_is_better=measure.better == "larger")
    return replace(found, available=worlds_of(next(iter(results.values()))))


def rank(
    planners: Mapping[str, Columns],
    *,
    larger_is_better: bool,
    seed: int = 0,
    flips: int = FLIPS,
) -> Ranking:
    """Rank at least one planner, each given by its trials, on those that all have a value for."""
    rows = dict(zip(planners, matched_trials(list(planners.values())), strict=True))
    means = {
        name: float(row.values.mean()) if len(row.values) else math.nan
        for name, row in rows.items()
    }
    sign = -1.0 if larger_is_better else 1.0
    names = sorted(planners, key=lambda name: (sign * means[name], name))
    places = list(combinations(range(len(names)), 2))
    flips = max(flips, _FLIPS_PER_PAIR * len(places))
    differences = {
        (i, j): difference(rows[names[i]], rows[names[j]], seed, flips)
        for i, j in places
    }
    worlds = rows[names[0]].worlds
    return Ranking(
        tuple(names),
        tuple(means[name] for name in names),
        len(set(worlds.tolist())),
        len(worlds),
        differences,
        dict(
            zip(places, holm([differences[place].p for place in places]), strict=True)
        ),
        len(places),
        tuple(rows[name].failure_share() for name in names),
    )


FEW_WORLDS = 10
_NAMED = 4  # that share the lead and are named
_SENTENCES = {
    "nothing": "There is no trial that all planners have.",
    "alone": "{a} is the only planner: {title} {mean_a}.",
    "equal": "{a}, {others} have the same {title}, {mean_a}: they cannot be told apart.",
    "better": "{a} is better than {b}: {title} {mean_a} against {mean_b}.",
    "open": "{a} and {b} cannot be told apart: {title} {mean_a} against {mean_b}.",
    "leads": "{a} is better than all others: {title} {mean_a} against {mean_b} of {b}, the next.",
    "ahead": "{a} is ahead, but {rest} cannot be told apart from it: {title} {mean_a} against {mean_b} of {b}.",
}
_WANTED = {
    "few": " With fewer than {fewest} worlds no difference can be clear.",
    "equal": " The means are equal; more worlds would only narrow the interval.",
    "hopeless": " No number of worlds up to a million would tell so small a difference.",
    "beyond": " The {available} worlds of this set cannot tell such a difference: it would take about {needed} with"
    " {repetitions} each.",
    "worlds": " To tell such a difference {times:g} times in 10, about {needed} worlds with {repetitions}"
    " each would be needed.",
}


class Conclusion(NamedTuple):
    """What a ranking says: in a short sentence, and how sure that is. As text, both."""

    short: str
    details: str = ""

    def __str__(self) -> str:
        """Return all of it."""
        return f"{self.short} {self.details}".rstrip()


def verdict(ranking: Ranking, measure: Measure) -> Conclusion:
    """Return what a ranking by a measure says: the leader, or those who cannot be told from it, and how sure that is.

    The number of worlds needed is for a power of 0.8, with as many repetitions, and for the test after Holm.
    """
    if not ranking.trials:
        return Conclusion(_SENTENCES["nothing"])
    count, leaders = len(ranking.names), ranking.leaders
    trials = (
        counted(ranking.trials, "trial")
        if count == 1
        else counted(ranking.trials, "pair") + " of trials"
    )
    extent = f"{counted(ranking.worlds, 'world')}, {trials}"
    words = {
        "a": ranking.names[0],
        "title": measure.title,
        "mean_a": _value(measure, ranking.means[0]),
    }
    if count == 1:
        return Conclusion(_SENTENCES["alone"].format(**words), f"Over {extent}.")
    if count > 2 and len(set(ranking.means)) == 1:
        told = _SENTENCES["equal"].format(
            **words, others=joined(list(ranking.names[1:]))
        )
        return Conclusion(told, f"Over {extent}.")
    next_best = leaders[1] if len(leaders) > 1 else 1
    found, name, mean = (
        ranking.differences[0, next_best],
        ranking.names[next_best],
        ranking.means[next_best],
    )
    words |= {"b": name, "mean_b": _value(measure, mean)}
    rest = [ranking.names[place] for place in leaders[1:]]
    words |= {"rest": joined(rest) if len(rest) <= _NAMED else f"{len(rest)} others"}
    kinds = {
        (False, True): "better",
        (True, True): "open",
        (False, False): "leads",
        (True, False): "ahead",
    }
    after = " after Holm" if ranking.tests > 1 else ""
    details = f"The difference is {_difference(measure, found.interval, name, mean)}"
    details += f" ({p_text(ranking.p[0, next_best])}{after}, {extent}).{_failures(ranking, (0, next_best))}"
    if len(leaders) > 1:
        details += _wanted(found, ranking)
    return Conclusion(
        _SENTENCES[kinds[len(leaders) > 1, count == 2]].format(**words), details
    )


def results_verdict(results: RowsByPlanner) -> Conclusion:
    """Return what the results of at least one planner, of one protocol, say by its metric; errors as `rank_results`."""
    measure = metric_of(next(iter(results.values())))
    return verdict(rank_results(results, measure), measure)


def pair_verdict(found: Comparison) -> Conclusion:
    """Return what a comparison of two planners says by the metric of its protocol."""
    row = found.row(found.metric)
    one, interval = row.paired, row.paired.difference
    sides = [
        *zip(
            (spelling(found.a), spelling(found.b)),
            (one.mean_a, one.mean_b),
            one.failures,
            strict=True,
        )
    ]
    if (one.mean_a < one.mean_b) == row.larger_is_better:
        sides, interval = sides[::-1], interval.negate()
    names, means, failures = zip(*sides, strict=True)
    by, p = (
        {(0, 1): Difference(interval, one.p, one.worlds, one.trials, one.parts)},
        {(0, 1): row.p_holm},
    )
    ranking = Ranking(
        names,
        means,
        one.worlds,
        one.trials,
        by,
        p,
        found.pairs,
        failures,
        found.available,
    )
    return verdict(ranking, MEASURES[found.metric])


def cautions(worlds: int, sources: Iterable[Source] = ()) -> tuple[str, ...]:
    """Return what to be careful about: so few worlds, folders that are not finished, and late commands."""
    return tuple(
        filter(
            None,
            (
                few_worlds(worlds),
                *(note for one in sources for note in notes_on(one, one.results)),
            ),
        )
    )


def few_worlds(worlds: int) -> str:
    """Return a warning if there are fewer than ten worlds, else an empty text."""
    rough = "intervals and tests are rough, and hardly any difference is clear"
    return (
        f"Only {counted(worlds, 'world')}: with fewer than {FEW_WORLDS}, {rough}."
        if worlds < FEW_WORLDS
        else ""
    )


def _failures(ranking: Ranking, places: Iterable[int]) -> str:
    """Return what share of failures of these planners cannot be ruled out, as a sentence."""
    limits = [(ranking.names[place], ranking.failures[place]) for place in places]
    known = [
        f"{number(100.0 * one.high, 1)} % of {name}'s"
        for name, one in limits
        if one and one.high is not None
    ]
    return (
        f" Failures in up to {joined(known)} trials cannot be ruled out."
        if known
        else ""
    )


def _wanted(found: Difference, ranking: Ranking) -> str:
    """Return what it would take to tell a difference that is not clear, as a sentence."""
    # All worlds on one side are the clearest result that the test knows: p = 2 / 2^worlds.
    fewest = math.ceil(1.0 + math.log2(ranking.tests / ALPHA))
    size, repetitions = (
        abs(found.interval.estimate),
        max(1, round(found.trials / found.worlds)),
    )
    if size == 0.0:
        return _WANTED["equal"]
    if found.worlds < fewest:
        return _WANTED["few"].format(fewest=fewest)
    needed = worlds_for_difference(
        found.parts, size, repetitions, 1.0 - ALPHA / ranking.tests
    )
    if needed is None:
        return _WANTED["hopeless"]
    words = {
        "needed": max(needed, found.worlds + 1),
        "repetitions": counted(repetitions, "trial"),
    }
    kind = "beyond" if 0 < ranking.available < needed else "worlds"
    return _WANTED[kind].format(
        **words, times=10.0 * POWER, available=ranking.available
    )


def _difference(measure: Measure, interval: Interval, other: str, mean: float) -> str:
    """Return the size of a difference with its interval, and in percent of the other's mean where that makes sense."""
    size = interval if interval.estimate >= 0.0 else interval.negate()
    text = measure.text(size) + (
        " percentage points" if measure.percent else measure.after
    )
    if measure.percent or mean == 0.0:
        return text
    return f"{text} or {number(100.0 * size.estimate / abs(mean), 1)} % of {other}'s"


def _value(measure: Measure, value: float) -> str:
    return measure.number(value) + measure.after
