"""How many worlds and repetitions a wanted precision needs, told from results that are there."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.compare import check_pairs, columns, worlds_of
from barn_eval.analysis.means import Columns
from barn_eval.analysis.measures import MEASURES, Measure, measures_named, metric_of
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import Components, half_width, worlds_for_difference, worlds_for_half_width
from barn_eval.analysis.statistics import difference, matched_trials
from barn_eval.analysis.text_table import TextTable, counted
from barn_eval.analysis.verdict import cautions
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import number
from barn_worlds.base.errors import ConfigError

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
    results: Mapping[str, Sequence[TrialResult]],
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
    found = MEASURES[measures_named([measure])[0]] if measure else metric_of(next(iter(results.values())))
    if difference_wanted is not None and len(results) != 2:
        raise ConfigError(
            f"a difference needs two planners; there are {len(results)}: {', '.join(results)}; choose two as {_CHOICE}"
        )
    alike_unknown = all(len({one.world for one in own}) == len(own) for own in results.values())
    counts = (repetitions,) if repetitions else REPETITIONS[:1] if alike_unknown else REPETITIONS
    figures, needs = [], []
    for name, own in results.items():
        every = columns(own, found)
        known = every.at(np.flatnonzero(np.isfinite(every.values)))
        one = _figure(spelling(name), known, known.parts, found)
        wanted = half_width_wanted or DEFAULT_SHARE * abs(one.mean)
        needs += [Need(one.of, "half_width", wanted, n, worlds_for_half_width(one.parts, wanted, n)) for n in counts]
        figures.append(one)
    if len(results) == 2:
        pair = _pair(results, found)
        wanted = difference_wanted or DEFAULT_SHARE * abs(figures[0].mean)
        needs += [Need(pair.of, "difference", wanted, n, worlds_for_difference(pair.parts, wanted, n)) for n in counts]
        figures.append(pair)
    notes = list(cautions(max(one.worlds for one in figures)))
    if alike_unknown:
        notes.append(
            "With one trial per world nothing is known of how alike the trials of a world are, nor of what repetitions"
            " would bring: drive some worlds with --repetitions 3 to tell."
        )
    if len(results) > 2:
        notes.append(f"For a difference choose two of the {len(results)} planners as {_CHOICE}.")
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
        parts = (number(scale**2 * part, 4) for part in (one.parts.between, one.parts.within))
        mean = (measure.number(one.mean), f"+- {measure.number(one.half_width)}")
        rows.append((one.of, *mean, *parts, f"{one.trials} in {one.worlds}"))
    head = ("", measure.heading, "95 %", "variance between worlds", "within a world", "trials in worlds")
    return TextTable("variance", "What there is", head, tuple(rows), caption=" ".join(made.notes))


def needs_table(made: Precision) -> TextTable:
    """Return how many worlds are needed, a row for each number of repetitions."""
    measure = MEASURES[made.measure]
    words = {"half_width": "{of} to +- {wanted}", "difference": "{of} of {wanted} to be found"}
    by_question: dict[str, dict[int, str]] = {}
    for one in made.needs:
        question = words[one.kind].format(of=one.of, wanted=measure.number(one.wanted))
        beyond = made.available and (one.worlds is None or one.worlds > made.available)
        text = f"over {made.available}" if beyond else str(one.worlds or "over a million")
        by_question.setdefault(question, {})[one.repetitions] = text
    counts = list(dict.fromkeys(one.repetitions for one in made.needs))
    rows = [(counted(count, "trial"), *(found[count] for found in by_question.values())) for count in counts]
    return TextTable("needs", f"Worlds needed, {measure.heading}", ("per world", *by_question), tuple(rows))


def _pair(results: Mapping[str, Sequence[TrialResult]], measure: Measure) -> Figure:
    (a, first), (b, second) = results.items()
    check_pairs(first, second)
    left, right = matched_trials([columns(first, measure), columns(second, measure)])
    apart = Columns(left.values - right.values, left.worlds, left.repetitions)
    return _figure(f"{spelling(a)} - {spelling(b)}", apart, lambda: difference(left, right).parts, measure)


def _figure(of: str, trials: Columns, parts: Callable[[], Components], measure: Measure) -> Figure:
    count = len(np.unique(trials.worlds))
    if count < 2:
        raise ConfigError(f"{of}: {counted(count, 'world')} with {measure.label} cannot say how worlds differ")
    found, repetitions = parts(), max(1, round(len(trials.values) / count))
    width = half_width(found, count, repetitions)
    return Figure(of, float(trials.values.mean()), count, len(trials.values), repetitions, found, width)
