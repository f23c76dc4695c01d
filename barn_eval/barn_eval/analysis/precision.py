"""How many worlds and repetitions a wanted precision needs, and how well worlds rank planners, told from results."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.compare import check_pairs, columns, worlds_of
from barn_eval.analysis.measures import MEASURES, Measure, measures_named, metric_of
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import (
    Components,
    half_width,
    worlds_for_difference,
    worlds_for_half_width,
)
from barn_eval.analysis.statistics import Columns, difference, matched_trials
from barn_eval.analysis.text_table import TextTable, counted, joined
from barn_eval.analysis.verdict import cautions, rank_results
from barn_eval.trials.result import RowsByPlanner
from barn_metrics.bootstrap import number
from barn_worlds.base.errors import ConfigError, suggest

REPETITIONS = (1, 2, 3, 5, 10)
DEFAULT_SHARE = 0.05  # of the mean, wanted unless something else is
_CHOICE = "FOLDER:PLANNER,PLANNER"


@dataclass(frozen=True)
class Figure:
    """A mean, of a planner or of the difference of two, as the results have it.

    repetitions: trials per world, rounded. parts: variance of a value. half_width: of its interval by these.
    """

    of: str
    mean: float
    worlds: int
    trials: int
    repetitions: int
    parts: Components
    half_width: float


@dataclass(frozen=True)
class Need:
    """How many worlds it takes with so many trials in each; None above a million.

    wanted: half the width of the 95 % interval of a mean, or a difference that is to be found 8 times in 10.
    """

    of: str
    kind: str
    wanted: float
    repetitions: int
    worlds: int | None


@dataclass(frozen=True)
class Precision:
    """What results say about their own precision by a measure, named by its key, and what more would take.

    available: how many worlds the data set has, 0 if unknown.
    """

    measure: str
    figures: tuple[Figure, ...]
    needs: tuple[Need, ...]
    notes: tuple[str, ...]
    available: int = 0


def precision(
    results: RowsByPlanner,
    half_width_wanted: float | None = None,
    difference_wanted: float | None = None,
    *,
    measure: str = "",
    repetitions: int | None = None,
) -> Precision:
    """Return how many worlds are needed for means of planners, and for a difference between two, to be so precise.

    Wanted are, in the unit of the measure, half the width of an interval and the size of a difference; 5 % of the mean
    unless given. measure: its key, without one the metric of the protocol. ConfigError in one line, by the names of the
    command's options, for what cannot be told.
    """
    found = (
        MEASURES[measures_named([measure])[0]]
        if measure
        else metric_of(next(iter(results.values())))
    )
    if difference_wanted is not None and len(results) != 2:
        raise ConfigError(
            f"a difference needs two planners; there are {len(results)}: {', '.join(results)}; choose two as {_CHOICE}"
        )
    alike_unknown = all(
        len({one.world for one in own}) == len(own) for own in results.values()
    )
    counts = (
        (repetitions,)
        if repetitions
        else REPETITIONS[:1]
        if alike_unknown
        else REPETITIONS
    )
    figures, needs = [], []
    for name, own in results.items():
        every = columns(own, found)
        known = every.at(np.flatnonzero(np.isfinite(every.values)))
        one = _figure(spelling(name), known, known.parts, found)
        wanted = half_width_wanted or DEFAULT_SHARE * abs(one.mean)
        needs += [
            Need(
                one.of,
                "half_width",
                wanted,
                n,
                worlds_for_half_width(one.parts, wanted, n),
            )
            for n in counts
        ]
        figures.append(one)
    if len(results) == 2:
        (a, first), (b, second) = results.items()
        check_pairs(first, second)
        left, right = matched_trials([columns(first, found), columns(second, found)])
        apart = Columns(left.values - right.values, left.worlds, left.repetitions)
        pair = _figure(
            f"{spelling(a)} - {spelling(b)}",
            apart,
            lambda: difference(left, right).parts,
            found,
        )
        wanted = difference_wanted or DEFAULT_SHARE * abs(figures[0].mean)
        needs += [
            Need(
                pair.of,
                "difference",
                wanted,
                n,
                worlds_for_difference(pair.parts, wanted, n),
            )
            for n in counts
        ]
        figures.append(pair)
    notes = list(cautions(max(one.worlds for one in figures)))
    if alike_unknown:
        notes.append(
            "With one trial per world nothing is known of how alike the trials of a world are, nor of what repetitions"
            " would bring: drive some worlds with --repetitions 3 to tell."
        )
    if len(results) > 2:
        notes.append(
            f"For a difference choose two of the {len(results)} planners as {_CHOICE}."
        )
    available = worlds_of(next(iter(results.values())))
    if available and any(one.worlds is None or one.worlds > available for one in needs):
        notes.append(
            f"The set has {available} worlds: where more are needed it cannot tell; barn worlds generate makes more."
        )
    return Precision(found.key, tuple(figures), tuple(needs), tuple(notes), available)


def figures_table(made: Precision) -> TextTable:
    """Return the components of variance of each figure; a row each."""
    measure = MEASURES[made.measure]
    scale = 100.0 if measure.percent else 1.0
    rows = []
    for one in made.figures:
        parts = (
            number(scale**2 * part, 4) for part in (one.parts.between, one.parts.within)
        )
        mean = (measure.number(one.mean), f"+- {measure.number(one.half_width)}")
        rows.append((one.of, *mean, *parts, f"{one.trials} in {one.worlds}"))
    head = (
        "",
        measure.heading,
        "95 %",
        "variance between worlds",
        "within a world",
        "trials in worlds",
    )
    return TextTable(
        "variance", "What there is", head, tuple(rows), caption=" ".join(made.notes)
    )


def needs_table(made: Precision) -> TextTable:
    """Return how many worlds are needed, a row for each number of repetitions."""
    measure = MEASURES[made.measure]
    words = {
        "half_width": "{of} to +- {wanted}",
        "difference": "{of} of {wanted} to be found",
    }
    by_question: dict[str, dict[int, str]] = {}
    for one in made.needs:
        question = words[one.kind].format(of=one.of, wanted=measure.number(one.wanted))
        beyond = made.available and (one.worlds is None or one.worlds > made.available)
        text = (
            f"over {made.available}" if beyond else str(one.worlds or "over a million")
        )
        by_question.setdefault(question, {})[one.repetitions] = text
    counts = list(dict.fromkeys(one.repetitions for one in made.needs))
    rows = [
        (counted(count, "trial"), *(found[count] for found in by_question.values()))
        for count in counts
    ]
    return TextTable(
        "needs",
        f"Worlds needed, {measure.heading}",
        ("per world", *by_question),
        tuple(rows),
    )


def _figure(
    of: str, trials: Columns, parts: Callable[[], Components], measure: Measure
) -> Figure:
    count = len(np.unique(trials.worlds))
    if count < 2:
        raise ConfigError(
            f"{of}: {counted(count, 'world')} with {measure.label} cannot say how worlds differ"
        )
    found, repetitions = parts(), max(1, round(len(trials.values) / count))
    width = half_width(found, count, repetitions)
    return Figure(
        of,
        float(trials.values.mean()),
        count,
        len(trials.values),
        repetitions,
        found,
        width,
    )


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
    results: RowsByPlanner, measures: Sequence[str] = (), seed: int = 0
) -> list[RankingPower]:
    """Return how well the worlds of results rank their planners, by measures or by the metric of the protocol.

    Worlds are drawn with replacement, so as to stand for other worlds of the same kind. The order and which planners
    differ are taken from the same results, over all worlds; ConfigError for fewer than two planners or an unknown
    measure.
    """
    first = next(iter(results.values()))
    if len(results) < 2:
        raise ConfigError(
            f"a ranking needs two planners; there is {', '.join(results)} only"
        )
    for key in measures:
        if key not in MEASURES or not MEASURES[key].better:
            raise ConfigError(f"unknown measure {key!r}{suggest(key, MEASURES)}")
    return [
        _power(results, MEASURES[key], seed)
        for key in measures or (metric_of(first).key,)
    ]


def _power(results: RowsByPlanner, measure: Measure, seed: int) -> RankingPower:
    ranking = rank_results(results, measure)
    differing = [places for places in ranking.p if ranking.clear(*places)]
    rows = matched_trials([columns(results[name], measure) for name in ranking.names])
    world = np.unique(rows[0].worlds, return_inverse=True)[1]
    count = ranking.worlds
    sign = 1.0 if measure.better == "larger" else -1.0
    sums = sign * np.array(
        [np.bincount(world, row.values, minlength=count) for row in rows]
    )
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
        tuple(
            (spelling(ranking.names[i]), spelling(ranking.names[j]))
            for i, j in differing
        ),
        count,
        {n: float(by_worlds[n - 1]) for n in DRAWN_WORLDS if n <= count}
        if differing
        else {},
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
            *(
                number(100.0 * one.shares[n], 1) if n in one.shares else "-"
                for n in sizes
            ),
            str(one.enough or f"over {one.worlds}"),
        )
        for one in found
    ]
    columns = (
        "set",
        "measure",
        "planners, best first",
        "pairs that differ",
        *map(str, sizes),
        "95 % from",
    )
    title = "Draws of so many worlds in which all planners that differ come in the right order [%]"
    return TextTable("ranking", title, columns, tuple(rows), texts=3)
