"""Rank planners with a test of each pair, and state the conclusion in words.

Planners without a significant difference share a rank.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

from barn_eval.analysis.compare import (
    Comparison,
    count_available_worlds,
    require_pairs,
    trial_values,
)
from barn_eval.analysis.entries import Entry
from barn_eval.analysis.measures import MEASURES, Measure, ranking_measure
from barn_eval.analysis.notes import list_notes
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
from barn_eval.analysis.statistics import TrialValues, difference, matched_trials
from barn_eval.analysis.text_table import count_noun, join_names
from barn_eval.trials.result import RowsByPlanner
from barn_metrics.bootstrap import Interval, number
from barn_worlds.base.errors import BarnError, ConfigError

FEW_WORLDS = 10
# This many patterns per pair keep the smallest p-value, times the pairs, below ALPHA.
_FLIPS_PER_PAIR = 40
_MAX_NAMED_PLANNERS = 4

# Tests of A minus B by the labels (A, B).
PairTests = Mapping[tuple[str, str], Difference]


@dataclass(frozen=True)
class Ranking:
    """Planners from best to worst, on the trials that all of them have."""

    names: Sequence[str]

    means: Sequence[float]
    """Mean of each planner."""

    worlds: int
    trials: int

    differences: Mapping[tuple[int, int], Difference]
    """By places (i, j), of which i is better: the value of i minus that of j."""

    p: Mapping[tuple[int, int], float]
    """The p-value of each difference, adjusted by Holm for `pair_count` pairs."""

    pair_count: int
    """Number of pairs that are tested together."""

    failures: Sequence[Interval | None]
    """Share of failures of each planner, None if failures have no value."""

    available: int = 0
    """Number of worlds in the data set, 0 if unknown."""

    def is_clear(self, better: int, worse: int) -> bool:
        """Tell whether one place is significantly better than a later one, after Holm.

        Args:
            better: The earlier place, counted from 0.
            worse: The later place.
        """
        return self.p[better, worse] <= ALPHA

    @property
    def leaders(self) -> tuple[int, ...]:
        """The first place, 0, and all places not significantly worse than it."""
        places = range(1, len(self.names))
        return (0, *(place for place in places if not self.is_clear(0, place)))

    @property
    def ranks(self) -> tuple[int, ...]:
        """Rank of each place, from 1; planners that no test separates share one.

        A new rank begins where all planners above are significantly better than all
        planners from there on. So planners without a significant difference always share
        a rank. Planners of one rank may differ if others lie between them.
        """
        count = len(self.names)
        ranks: list[int] = []
        for place in range(count):
            # Significance is not transitive, so a border needs all pairs across it.
            is_new_rank = all(
                self.is_clear(better, worse)
                for better in range(place)
                for worse in range(place, count)
            )
            ranks.append(place + 1 if is_new_rank else ranks[-1])
        return tuple(ranks)


def rank_results(
    results: RowsByPlanner, measure: Measure, comparisons: Sequence[Comparison] = ()
) -> Ranking:
    """Rank planners by a measure on common trials; ConfigError if tasks differ.

    Args:
        results: Results by planner, of at least one.
        measure: Measure to rank by.
        comparisons: Comparisons of these planners by this measure, labeled as in
            `results`. Their tests are reused if they are over the same trials.

    Raises:
        ConfigError: If two planners did not do the same task.
    """
    for a, b in combinations(results, 2):
        try:
            require_pairs(results[a], results[b])
        except BarnError as error:
            raise ConfigError(
                f"{a} and {b} cannot be ranked against each other: {error}"
            ) from None

    values = {name: trial_values(rows, measure) for name, rows in results.items()}
    pair_tests = {
        (comparison.a, comparison.b): comparison.row(measure.key).paired.test()
        for comparison in comparisons
    }
    ranking = rank(
        values, larger_is_better=measure.better == "larger", pair_tests=pair_tests
    )
    first = next(iter(results.values()))
    return replace(ranking, available=count_available_worlds(first))


def rank(
    planners: Mapping[str, TrialValues],
    *,
    larger_is_better: bool,
    flips: int = FLIPS,
    pair_tests: PairTests | None = None,
) -> Ranking:
    """Rank planners by mean over the trials that all have; test each pair, after Holm.

    Args:
        planners: Trials by planner, of at least one.
        larger_is_better: Whether larger values of the measure are better.
        flips: Number of patterns, raised if many pairs need more.
        pair_tests: Tests of some pairs, which are reused if they are over the same
            trials and with as many patterns.
    """
    matched = matched_trials(list(planners.values()))
    trials = dict(zip(planners, matched, strict=True))
    # Over common trials only, so that no planner leads because of easier worlds.
    means = {name: values.average for name, values in trials.items()}
    sign = -1.0 if larger_is_better else 1.0
    names = sorted(planners, key=lambda name: (sign * means[name], name))

    pairs = list(combinations(range(len(names)), 2))
    # No p-value is below 1 / (flips + 1), and Holm multiplies it by the pairs.
    enough_flips = max(flips, _FLIPS_PER_PAIR * len(pairs))
    # A test with fewer patterns could not be significant after Holm.
    if pair_tests is None or enough_flips > flips:
        pair_tests = {}
    differences = {}
    for i, j in pairs:
        better = trials[names[i]]
        worse = trials[names[j]]
        test = _find_test(pair_tests, names[i], names[j])
        # Trials that all planners share are among those that two share, so equal numbers
        # mean equal trials.
        if test is None or test.trials != len(better.values):
            test = difference(better, worse, enough_flips)
        differences[i, j] = test

    p_values = holm([differences[pair].p for pair in pairs])
    worlds = trials[names[0]].worlds
    return Ranking(
        names=names,
        means=[means[name] for name in names],
        worlds=len(set(worlds.tolist())),
        trials=len(worlds),
        differences=differences,
        p=dict(zip(pairs, p_values, strict=True)),
        pair_count=len(pairs),
        failures=[trials[name].failure_share() for name in names],
    )


def _find_test(pair_tests: PairTests, a: str, b: str) -> Difference | None:
    """Return the test of A minus B, negated if stored as B minus A; None if missing."""
    if (a, b) in pair_tests:
        return pair_tests[a, b]
    if (b, a) in pair_tests:
        return pair_tests[b, a].negate()
    return None


class Conclusion(NamedTuple):
    """The conclusion from a ranking; str() gives both parts."""

    short: str
    """The conclusion in a sentence."""

    details: str = ""
    """Sentences on how sure it is."""

    def __str__(self) -> str:
        """Return both parts."""
        return f"{self.short} {self.details}".rstrip()


def conclude_ranking(ranking: Ranking, measure: Measure) -> Conclusion:
    """Return sentences on who leads a ranking and how sure that is.

    The number of worlds that a significant difference would take is for a power of 0.8,
    as many repetitions, and p-values adjusted by Holm.

    Args:
        ranking: Planners ranked by the measure.
        measure: Measure that ranks them.
    """
    if not ranking.trials:
        return Conclusion("The planners have no trial in common.")

    names = ranking.names
    best = f"{measure.title} {_value_text(measure, ranking.means[0])}"
    worlds = count_noun(ranking.worlds, "world")
    if len(names) == 1:
        trials = count_noun(ranking.trials, "trial")
        return Conclusion(
            f"{names[0]} is the only planner: {best}.", f"Over {worlds}, {trials}."
        )

    _, *level_places = ranking.leaders
    # The best planner that is level with the first or, without one, the second best.
    next_place = level_places[0] if level_places else 1
    next_name = names[next_place]
    next_mean = ranking.means[next_place]
    test = ranking.differences[0, next_place]
    means = f"{best} against {_value_text(measure, next_mean)} of {next_name}"
    size = _difference_text(measure, test.interval, next_name, next_mean)
    after_holm = ", p after Holm" if ranking.pair_count > 1 else ""
    pairs = count_noun(ranking.trials, "pair")
    details = f"The difference is {size} ({pairs} of trials{after_holm})."
    details += _possible_failures(ranking, (0, next_place))
    if not level_places:
        largest_p = max(ranking.p[0, place] for place in range(1, len(names)))
        others = next_name if len(names) == 2 else "all others"
        short = (
            f"{names[0]} is better than {others} ({p_text(largest_p)}, {worlds}):"
            f" {means}."
        )
        return Conclusion(short, details)

    smallest_p = p_text(min(ranking.p[0, place] for place in level_places))
    if len(level_places) > 1:
        smallest_p = f"smallest {smallest_p}"
    short = _describe_lead(ranking, measure, f"{smallest_p}, {worlds}")
    details = f"{means[0].upper()}{means[1:]}. {details}"
    return Conclusion(short, details + _needed_worlds(test, ranking))


def _describe_lead(ranking: Ranking, measure: Measure, certainty: str) -> str:
    """Return a sentence on the planner that ranks first and those level with it.

    Args:
        ranking: Planners, of which at least two are level.
        measure: Measure that ranks them.
        certainty: P-value and number of worlds, as text.
    """
    first = ranking.names[0]
    value = _value_text(measure, ranking.means[0])
    equal = [first]
    behind = []
    for place in ranking.leaders[1:]:
        # Equal texts show no lead.
        if _value_text(measure, ranking.means[place]) == value:
            equal.append(ranking.names[place])
        else:
            behind.append(ranking.names[place])
    rivals = join_names(behind)
    if len(behind) > _MAX_NAMED_PLANNERS:
        rivals = f"{len(behind)} others"

    if len(equal) == 1:
        lead = f"{first} ranks first; its lead over"
        # Another pair of the same comparison may have the planner that ranks first.
        if ranking.pair_count > len(ranking.differences):
            lead = f"The lead of {first} over"
    else:
        lead = f"{join_names(equal)} have the same {measure.title}, {value}"
        if not behind:
            return f"{lead} ({certainty})."
        lead += "; their lead over"
    return f"{lead} {rivals} is not significant ({certainty})."


def conclude_results(
    results: RowsByPlanner, comparisons: Sequence[Comparison] = ()
) -> Conclusion:
    """Conclude who leads by the protocol's measure; ConfigError if tasks differ.

    Args:
        results: Results by planner, of at least one, all of one protocol.
        comparisons: As for `rank_results`.

    Raises:
        ConfigError: As for `rank_results`.
    """
    measure = ranking_measure(next(iter(results.values())))
    return conclude_ranking(rank_results(results, measure, comparisons), measure)


def conclude_comparison(comparison: Comparison) -> Conclusion:
    """Return sentences on which of two planners is better by the ranking measure."""
    row = comparison.row(comparison.metric)
    paired = row.paired
    test = paired.test()
    names = [spelling(comparison.a), spelling(comparison.b)]
    means = [paired.mean_a, paired.mean_b]
    failures = list(paired.failures)
    # The better planner comes first.
    if (paired.mean_a < paired.mean_b) == row.larger_is_better:
        names.reverse()
        means.reverse()
        failures.reverse()
        test = test.negate()

    ranking = Ranking(
        names=names,
        means=means,
        worlds=paired.worlds,
        trials=paired.trials,
        differences={(0, 1): test},
        p={(0, 1): row.p_holm},
        pair_count=comparison.pairs,
        failures=failures,
        available=comparison.available,
    )
    return conclude_ranking(ranking, MEASURES[comparison.metric])


def list_cautions(worlds: int, entries: Sequence[Entry] = ()) -> list[str]:
    """Return warning sentences: few worlds, mixtures, unfinished runs, late commands.

    Args:
        worlds: Number of worlds that conclusions rest on.
        entries: Planners that are compared.
    """
    notes = [warn_of_few_worlds(worlds), *list_notes(entries)]
    return list(filter(None, notes))


def warn_of_few_worlds(worlds: int) -> str:
    """Return a warning for fewer than ten worlds, else an empty text."""
    if worlds >= FEW_WORLDS:
        return ""
    return (
        f"Only {count_noun(worlds, 'world')}: with fewer than {FEW_WORLDS}, intervals "
        "and tests are rough, and few differences are significant."
    )


def _possible_failures(ranking: Ranking, places: Iterable[int]) -> str:
    """Return a sentence on upper limits of planners' failure shares, "" if unknown."""
    limits = []
    for place in places:
        share = ranking.failures[place]
        # If all trials failed, no more failures are possible.
        if share and share.high and share.estimate < 1.0:
            percent = number(100.0 * share.high, 1)
            limits.append(f"{percent}% of {ranking.names[place]}'s")
    if not limits:
        return ""
    return f" Failures in up to {join_names(limits)} trials cannot be ruled out."


def _needed_worlds(test: Difference, ranking: Ranking) -> str:
    """Return a sentence on how many worlds a significant difference takes, or why none."""
    size = abs(test.interval.estimate)
    repetitions = max(1, round(test.trials / test.worlds))
    # If every world favors the same planner, the test gives p = 2 / 2^worlds.
    fewest = math.ceil(1.0 + math.log2(ranking.pair_count / ALPHA))
    if test.worlds < fewest:
        return f" With fewer than {fewest} worlds, no difference can be significant."

    if size == 0.0:
        return " The means are equal; more worlds would only narrow the interval."

    # Bonferroni's level, that of Holm's hardest step, is on the safe side.
    level = 1.0 - ALPHA / ranking.pair_count
    worlds = worlds_for_difference(test.parts, size, repetitions, level)
    if worlds is None:
        return " Even a million worlds would not show so small a difference."
    # By chance, the variance may suggest fewer worlds than there already are.
    needed = max(worlds, test.worlds + 1)
    each = count_noun(repetitions, "trial")
    if 0 < ranking.available < worlds:
        return (
            f" The {ranking.available} worlds of this set cannot show such a "
            f"difference: it would take about {needed} with {each} each."
        )
    return (
        f" To show such a difference in {10.0 * POWER:g} of 10 runs, about {needed} "
        f"worlds with {each} each would be needed."
    )


def _difference_text(
    measure: Measure, interval: Interval, other: str, mean: float
) -> str:
    """Return a difference as text, without sign, with interval and percentage of `mean`."""
    size = interval if interval.estimate >= 0.0 else interval.negate()
    # A difference of shares is in percentage points.
    unit = " percentage points" if measure.percent else measure.after
    text = measure.text(size) + unit
    # A percentage of a share would confuse, and there is none of zero.
    if measure.percent or mean == 0.0:
        return text
    percent = number(100.0 * size.estimate / abs(mean), 1)
    return f"{text} or {percent}% of {other}'s"


def _value_text(measure: Measure, value: float) -> str:
    """Return a value as text with its unit, such as "8.31 s"."""
    return measure.number(value) + measure.after
