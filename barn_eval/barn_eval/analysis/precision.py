"""Estimate from results how many worlds and repetitions a precision needs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.compare import (
    count_available_worlds,
    require_pairs,
    trial_values,
)
from barn_eval.analysis.measures import (
    MEASURES,
    Measure,
    ranking_measure,
    require_measures,
)
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import (
    Components,
    half_width,
    worlds_for_difference,
    worlds_for_half_width,
)
from barn_eval.analysis.statistics import TrialValues, difference, matched_trials
from barn_eval.analysis.text_table import TextTable, count_noun
from barn_eval.analysis.verdict import list_cautions
from barn_eval.trials.result import RowsByPlanner
from barn_metrics.bootstrap import number
from barn_worlds.base.errors import ConfigError

REPETITIONS = (1, 2, 3, 5, 10)
# The precision in question by default, as a share of the mean.
DEFAULT_SHARE = 0.05
_SELECTION = "FOLDER:PLANNER,PLANNER"
_ONE_TRIAL_NOTE = (
    "With one trial per world, the data do not show how similar the trials of a world "
    "are, nor what repetitions would gain. To find out, drive some worlds with "
    "--repetitions 3."
)


@dataclass(frozen=True)
class Figure:
    """The mean of a planner, or of the difference of two, and its variance."""

    of: str
    """Planner, or the difference of two as "A - B"."""

    mean: float
    worlds: int
    trials: int

    repetitions: int
    """Trials per world, rounded."""

    parts: Components
    """Variance of a value."""

    half_width: float
    """Half the width of the interval that follows from the variance."""


@dataclass(frozen=True)
class Need:
    """The number of worlds that a precision needs."""

    of: str
    """As in `Figure`."""

    kind: str
    """Either "half_width" or "difference"."""

    wanted: float
    """Half the width of the 95% interval of a mean, or a difference to detect.

    A difference is detected in 8 of 10 runs.
    """

    repetitions: int

    worlds: int | None
    """None above a million."""


@dataclass(frozen=True)
class Precision:
    """How precise results are by a measure, and how many worlds more precision needs."""

    measure: str
    """Key of the measure."""

    figures: Sequence[Figure]
    needs: Sequence[Need]
    notes: Sequence[str]

    available: int = 0
    """Number of worlds in the data set, 0 if unknown."""


def estimate_precision(
    results: RowsByPlanner,
    width: float | None = None,
    size: float | None = None,
    *,
    measure_key: str = "",
    repetitions: int | None = None,
) -> Precision:
    """Return how many worlds a mean or a difference of two needs; BarnError if unknown.

    Args:
        results: Results by planner. With two planners, their difference is estimated.
        width: Half the width that the interval of a mean may have, in the unit of the
            measure. Default: 5% of the mean.
        size: Difference to detect, in the unit of the measure. Default: 5% of the first
            mean.
        measure_key: Key of the measure. Default: the ranking measure.
        repetitions: Trials per world. By default, several numbers are tried.

    Raises:
        BarnError: If the estimate cannot be made.
    """
    _require_pair_for(size, results)
    first_rows = next(iter(results.values()))
    measure = ranking_measure(first_rows)
    if measure_key:
        measure = MEASURES[require_measures([measure_key])[0]]
    # See `_ONE_TRIAL_NOTE`.
    has_one_trial_per_world = all(
        len({row.world for row in rows}) == len(rows) for rows in results.values()
    )
    counts = (repetitions,) if repetitions else REPETITIONS
    if not repetitions and has_one_trial_per_world:
        # Variance within worlds is unknown, so more repetitions cannot be judged.
        counts = REPETITIONS[:1]

    figures: list[Figure] = []
    needs: list[Need] = []
    for name, rows in results.items():
        trials = trial_values(rows, measure)
        # Failures have no value by some measures, and a variance needs finite ones.
        trials = trials.at(np.flatnonzero(np.isfinite(trials.values)))
        figure = _make_figure(spelling(name), trials, trials.parts(), measure)
        figures.append(figure)
        # All planners get the same relative precision, however quick they are.
        mean_width = width or DEFAULT_SHARE * abs(figure.mean)
        for count in counts:
            worlds = worlds_for_half_width(figure.parts, mean_width, count)
            needs.append(Need(figure.of, "half_width", mean_width, count, worlds))

    if len(results) == 2:
        pair = _make_pair_figure(results, measure)
        wanted_difference = size or DEFAULT_SHARE * abs(figures[0].mean)
        figures.append(pair)
        for count in counts:
            worlds = worlds_for_difference(pair.parts, wanted_difference, count)
            needs.append(Need(pair.of, "difference", wanted_difference, count, worlds))

    available = count_available_worlds(first_rows)
    notes = list_cautions(max(figure.worlds for figure in figures))
    if has_one_trial_per_world:
        notes.append(_ONE_TRIAL_NOTE)
    if len(results) > 2:
        notes.append(
            f"For a difference, select two of the {len(results)} planners as "
            f"{_SELECTION}."
        )
    if any(_is_beyond(need, available) for need in needs):
        notes.append(
            f"The data set has only {available} worlds; barn worlds generate makes more."
        )
    return Precision(measure.key, figures, needs, notes, available)


def figures_table(precision: Precision) -> TextTable:
    """Return a text table of means and components of variance, a figure per row."""
    measure = MEASURES[precision.measure]
    # A variance is in the square of the heading's unit.
    scale = 100.0 if measure.percent else 1.0
    rows = []
    for figure in precision.figures:
        rows.append(
            (
                figure.of,
                measure.number(figure.mean),
                f"+- {measure.number(figure.half_width)}",
                number(scale**2 * figure.parts.between, 4),
                number(scale**2 * figure.parts.within, 4),
                f"{figure.trials} in {figure.worlds}",
            )
        )
    columns = (
        "",
        measure.heading,
        "95%",
        "variance between worlds",
        "within a world",
        "trials in worlds",
    )
    caption = " ".join(precision.notes)
    return TextTable("variance", "Precision so far", columns, rows, caption=caption)


def needs_table(precision: Precision) -> TextTable:
    """Return a text table of needed worlds, a number of repetitions per row."""
    measure = MEASURES[precision.measure]
    cells: dict[str, dict[int, str]] = {}
    for need in precision.needs:
        wanted_text = measure.number(need.wanted)
        question = f"{need.of} to +- {wanted_text}"
        if need.kind == "difference":
            question = f"{need.of}: detect {wanted_text}"
        text = str(need.worlds or "over a million")
        if _is_beyond(need, precision.available):
            text = f"over {precision.available}"
        cells.setdefault(question, {})[need.repetitions] = text

    # Each question was answered for the same numbers of repetitions.
    counts = list(dict.fromkeys(need.repetitions for need in precision.needs))
    rows = []
    for count in counts:
        texts = [by_count[count] for by_count in cells.values()]
        rows.append((count_noun(count, "trial"), *texts))
    title = f"Worlds needed, {measure.heading}"
    return TextTable("needs", title, ("per world", *cells), rows)


def _require_pair_for(wanted_difference: float | None, results: RowsByPlanner) -> None:
    """Raise ConfigError if a difference is wanted and there are not two planners."""
    if wanted_difference is not None and len(results) != 2:
        raise ConfigError(
            f"a difference needs two planners, got {len(results)}: "
            f"{', '.join(results)}; select two as {_SELECTION}"
        )


def _is_beyond(need: Need, available: int) -> bool:
    """Tell whether a need exceeds the `available` worlds, if these are known."""
    return bool(available) and (need.worlds is None or need.worlds > available)


def _make_pair_figure(results: RowsByPlanner, measure: Measure) -> Figure:
    """Return the mean of first minus second planner in common trials, or BarnError."""
    (a, rows_a), (b, rows_b) = results.items()
    # Between different tasks, worlds would not explain the differences.
    require_pairs(rows_a, rows_b)
    left, right = matched_trials(
        [trial_values(rows_a, measure), trial_values(rows_b, measure)]
    )
    # The variance of the differences is far below that of either planner, because hard
    # worlds are hard for both.
    gaps = TrialValues(left.values - right.values, left.worlds, left.repetitions)
    name = f"{spelling(a)} - {spelling(b)}"
    return _make_figure(name, gaps, difference(left, right).parts, measure)


def _make_figure(
    name: str, trials: TrialValues, components: Components, measure: Measure
) -> Figure:
    """Return the mean of trials with a given variance; ConfigError below two worlds."""
    worlds = len(np.unique(trials.worlds))
    if worlds < 2:
        raise ConfigError(
            f"{name}: {count_noun(worlds, 'world')} with {measure.label} cannot show "
            "how worlds differ"
        )
    # In unfinished runs, worlds differ in trials, but the formula needs one number.
    repetitions = max(1, round(len(trials.values) / worlds))
    return Figure(
        of=name,
        mean=trials.average,
        worlds=worlds,
        trials=len(trials.values),
        repetitions=repetitions,
        parts=components,
        half_width=half_width(components, worlds, repetitions),
    )
