"""The figures of a report but for those on maps, and results at a glance."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from barn_eval.analysis.compare import Comparison
from barn_eval.analysis.difficulty import Band, Difficulty, by_world
from barn_eval.analysis.measures import MEASURES, Measure, metric_of, safety_of
from barn_eval.analysis.significance import ALPHA
from barn_eval.analysis.sources import Entry
from barn_eval.analysis.summary import Summary, summarise
from barn_eval.pages import figures as drawing
from barn_eval.trials.outcome import Outcome
from barn_metrics.bootstrap import Interval
from barn_worlds.drawing import palette

_OUTCOMES = tuple(Outcome)
_TIME = MEASURES["normalised_time_s_per_m"]
RANK = "world, from easy to difficult [rank]"
PREDICTED = "difficulty as predicted [s/m]"
NAMED_WORLDS = 40  # up to which each world has its number below it
DISTRIBUTED = ("normalised_time_s_per_m", "min_clearance_m", "mean_speed_mps", "rms_jerk_mps3")
COMPUTE = {"median": "compute_p50_ms", "95th percentile": "compute_p95_ms", "largest": "compute_max_ms"}
DASHES = ("-", "--", "-.", ":")


def overview_figure(entries: Sequence[Entry]) -> Figure:
    """Draw entries of one protocol at a glance: its metric and success of each, and its time in each world.

    Bars are 95 % intervals over worlds.
    """
    figure = drawing.new_figure(2.4 + 0.3 * len(entries))
    *left, right = figure.subplots(1, 3, width_ratios=(1, 1, 2))
    for axes, measure in zip(left, (metric_of(entries[0].results), MEASURES["success"]), strict=True):
        for place, entry in enumerate(entries):
            mean = measure.shown(summarise(entry.results, (measure.key,))[measure.key])
            drawing.points(axes, [place], [mean], entry.colour, drawing.marker_of(place), flat=True)
        drawing.label_axes(axes, measure.heading, "")
        axes.set_yticks(range(len(entries)), [drawing.plain(entry.label) for entry in entries])
        axes.set_ylim(len(entries) - 0.5, -0.5)
        axes.set_xlim(left=0)
    for place, entry in enumerate(entries):
        worlds = by_world(entry.results)
        means = [_TIME.values(trials).mean() for trials in worlds.values()]
        right.plot(list(worlds), means, linestyle="", marker=drawing.marker_of(place), color=entry.colour, alpha=0.8)
    drawing.label_axes(right, "world", _TIME.heading)
    right.xaxis.set_major_locator(MaxNLocator(integer=True))
    right.set_ylim(bottom=0)
    return figure


def worlds_figure(entries: Sequence[Entry], order: Difficulty, predicted: Sequence[float] = ()) -> Figure:
    """Draw the counted time per metre of each world, worlds from easy to difficult (the paper's Fig. 6).

    predicted: that of the difficulty model for each world, if it is to be drawn.
    """
    figure = drawing.new_figure(4.4)
    axes = figure.add_subplot()
    rank = np.array(order.predicted_s_per_m or np.arange(1, len(order.worlds) + 1))
    mean, spread = np.array(order.mean_s_per_m), np.array(order.spread_s_per_m)
    axes.fill_between(rank, mean - spread, mean + spread, color=palette.FAINT, alpha=0.3, linewidth=0)
    axes.plot(rank, mean, color=palette.INK, linewidth=1.6)
    handles = [axes.lines[0], axes.collections[0]]
    names = ["mean over planners", "± standard deviation of its trials"]
    if np.isfinite(predicted).any():
        handles += axes.plot(rank, predicted, color=palette.INK, linewidth=0.9, linestyle=":")
        names.append("predicted")
    for index, entry in enumerate(entries):
        groups = by_world(entry.results)
        times = [_TIME.values(groups.get(world, [])) for world in order.worlds]
        values = [part.mean() if len(part) else np.nan for part in times]
        size = 16 if len(rank) > 60 else 34
        handles.append(
            axes.scatter(rank, values, s=size, color=entry.colour, marker=drawing.marker_of(index), alpha=0.8, lw=0)
        )
    drawing.label_axes(axes, PREDICTED if order.predicted_s_per_m else RANK, _TIME.heading)
    if not order.predicted_s_per_m:
        _world_ticks(axes, order)
    axes.set_ylim(bottom=0)
    drawing.legend_below(figure, handles, [*names, *(entry.label for entry in entries)])
    return figure


def bands_figure(entries: Sequence[Entry], bands: Sequence[Band]) -> Figure:
    """Draw success and time by band of difficulty, with 95 % intervals."""
    figure = drawing.new_figure(3.9)
    measures = dict.fromkeys((metric_of(entries[0].results).key, "success", _TIME.key))
    panels = figure.subplots(1, len(measures), squeeze=False)[0]
    places = np.arange(len(bands))
    handles = []
    for axes, measure in zip(panels, map(MEASURES.__getitem__, measures), strict=True):
        for index, entry in enumerate(entries):
            shift = (index - (len(entries) - 1) / 2) * min(0.16, 0.6 / len(entries))
            means = [measure.shown(band.summaries[index][measure.key]) for band in bands]
            handles.append(drawing.points(axes, places + shift, means, entry.colour, drawing.marker_of(index)))
        drawing.label_axes(axes, "worlds by difficulty [band]", measure.heading, measure.title.capitalize())
        axes.set_xticks(places, [f"{band.name}\n({len(band.worlds)})" for band in bands])
        axes.set_ylim(0, 104 if measure.share else None)
    drawing.legend_below(figure, handles[: len(entries)], [entry.label for entry in entries])
    return figure


def strip_figure(entries: Sequence[Entry], order: Difficulty) -> Figure:
    """Draw the outcome of every trial: worlds across from easy to difficult, an entry per strip, a trial per line."""
    heights = [max(one.repetition for one in entry.results) + 1 for entry in entries]
    figure = drawing.new_figure(1.4 + sum(0.28 + min(0.15 * height, 1.2) for height in heights))
    panels = figure.subplots(len(entries), 1, sharex=True, squeeze=False)[:, 0]
    colours = [palette.NO_TRIAL, *(drawing.outcome_colour(outcome) for outcome in _OUTCOMES)]
    there: set[int] = set()
    for axes, entry, height in zip(panels, entries, heights, strict=True):
        cells = np.zeros((height, len(order.worlds)), np.int64)
        column = {world: index for index, world in enumerate(order.worlds)}
        for one in entry.results:
            if one.world in column:
                cells[one.repetition, column[one.world]] = 1 + _OUTCOMES.index(one.outcome)
        there |= set(np.unique(cells).tolist())
        axes.imshow(
            cells,
            cmap=ListedColormap(colours),
            vmin=-0.5,
            vmax=len(colours) - 0.5,
            aspect="auto",
            interpolation="none",
            extent=(0.5, len(order.worlds) + 0.5, height, 0),
        )
        axes.set_title(drawing.plain(entry.label))
        axes.set_yticks([0.5, height - 0.5] if height > 1 else [0.5], ["1", str(height)] if height > 1 else ["1"])
        axes.set_ylabel("trial")
    panels[-1].set_xlabel(RANK)
    _world_ticks(panels[-1], order)
    names = ["no trial", *(outcome.value.replace("_", " ") for outcome in _OUTCOMES)]
    shown = sorted(there)
    drawing.legend_below(figure, [Patch(color=colours[one]) for one in shown], [names[one] for one in shown])
    return figure


def paired_figure(comparisons: Sequence[Comparison]) -> Figure:
    """Draw differences of pairs of entries with their 95 % intervals; filled where the difference is clear."""
    figure = drawing.new_figure(1.3 + 0.36 * len(comparisons))
    panels = figure.subplots(1, 3, sharey=True)
    success = MEASURES["success"]
    successes, times = ([one.row(key) for one in comparisons] for key in (success.key, _TIME.key))
    chosen = (
        (
            "difference in success [percentage points]",
            0.0,
            "larger",
            successes,
            [success.shown(row.paired.difference) for row in successes],
        ),
        (f"difference in {_TIME.heading}", 0.0, "smaller", times, [row.paired.difference for row in times]),
        ("probability that the first is faster", 0.5, "larger", times, [row.paired.improvement for row in times]),
    )
    for axes, (title, neutral, measure_better, rows, intervals) in zip(panels, chosen, strict=True):
        for place, (row, interval) in enumerate(zip(rows, intervals, strict=True)):
            _difference(axes, place, interval, clear=row.p_holm <= ALPHA)
        axes.axvline(neutral, color=palette.INK, linewidth=1.0, linestyle="--")
        drawing.label_axes(axes, title, "")
        larger = measure_better == "larger"
        sides = ("second better", "first better") if larger else ("first better", "second better")
        for side, text, at in zip(("left", "right"), (f"← {sides[0]}", f"{sides[1]} →"), (0.0, 1.0), strict=True):
            axes.text(at, 1.02, text, transform=axes.transAxes, ha=side, va="bottom", fontsize=9)
    panels[0].set_yticks(
        range(len(comparisons)), [f"{drawing.plain(one.a)} - {drawing.plain(one.b)}" for one in comparisons]
    )
    panels[0].set_ylim(len(comparisons) - 0.4, -0.6)
    return figure


def distributions_figure(entries: Sequence[Entry]) -> Figure:
    """Draw the share of trials up to each value of time per metre, clearance, speed and jerk."""
    figure = drawing.new_figure(3.6)
    panels = figure.subplots(1, 4)
    handles = {}
    for axes, key in zip(panels, DISTRIBUTED, strict=True):
        for index, entry in enumerate(entries):
            known = _known(MEASURES[key], entry)
            if len(known):
                dashes = DASHES[index % len(DASHES)]
                handles[index] = axes.ecdf(known, color=entry.colour, linewidth=1.8, linestyle=dashes)
        drawing.label_axes(axes, MEASURES[key].heading, "")
        axes.set_ylim(0, 1.02)
    panels[0].set_ylabel("share of trials up to")
    drawing.legend_below(figure, list(handles.values()), [entries[index].label for index in handles])
    return figure


def trade_figure(entries: Sequence[Entry], summaries: Sequence[Summary]) -> Figure:
    """Draw speed against safety: the counted time per metre of each planner over its clearance, and over its contact.

    Bars are 95 % intervals; the better corner is named. Contact is left out where there was none.
    """
    measures = [safety_of([one for entry in entries for one in entry.results])]
    if any(summary["contact_s"].estimate > 0.0 for summary in summaries):
        measures.append(MEASURES["contact_s"])
    figure = drawing.new_figure(4.2)
    panels = figure.subplots(1, len(measures), sharey=True, squeeze=False)[0]
    handles: list[Any] = []
    for axes, measure in zip(panels, measures, strict=True):
        handles = [
            drawing.point(axes, summary[measure.key], summary[_TIME.key], entry.colour, drawing.marker_of(index))
            for index, (entry, summary) in enumerate(zip(entries, summaries, strict=True))
        ]
        larger = measure.better == "larger"
        drawing.label_axes(axes, measure.heading, "" if axes is not panels[0] else _TIME.heading)
        corner = "faster and safer ↘" if larger else "↙ faster and safer"
        where = (0.99, 0.02, "right") if larger else (0.01, 0.02, "left")
        axes.text(*where[:2], corner, transform=axes.transAxes, ha=where[2], va="bottom", fontsize=9)
        axes.margins(0.15)
    drawing.legend_below(figure, handles, [entry.label for entry in entries])
    return figure


def compute_figure(entries: Sequence[Entry]) -> Figure | None:
    """Draw the planner's time per cycle: of each trial its median, 95th percentile and largest; None if not known."""
    values = [[_known(MEASURES[key], entry) for entry in entries] for key in COMPUTE.values()]
    if not any(len(group) for groups in values for group in groups):
        return None
    figure = drawing.new_figure(1.3 + 0.42 * len(entries))
    panels = figure.subplots(1, 3, sharey=True, sharex=True)
    for axes, title, groups in zip(panels, COMPUTE, values, strict=True):
        boxes = axes.boxplot(groups, orientation="horizontal", widths=0.6, whis=(5, 95), showfliers=False)
        for parts in ("boxes", "whiskers", "caps", "medians"):
            for index, line in enumerate(boxes[parts]):
                entry = index // (len(boxes[parts]) // len(entries))
                line.set(color=entries[entry].colour, linewidth=1.8 if parts != "medians" else 2.6)
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0), numticks=6))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        drawing.label_axes(axes, "time per cycle [ms]", "", title)
    panels[0].set_yticks(range(1, len(entries) + 1), [drawing.plain(entry.label) for entry in entries])
    panels[0].set_ylim(len(entries) + 0.6, 0.4)
    return figure


def _world_ticks(axes: Axes, order: Difficulty) -> None:
    """Write the number of each world below its rank, where there is room for all of them."""
    if len(order.worlds) > NAMED_WORLDS:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        return
    axes.set_xticks(range(1, len(order.worlds) + 1), list(map(str, order.worlds)), fontsize=9)
    axes.set_xlabel("world, from easy to difficult [number]")


def _known(measure: Measure, entry: Entry) -> npt.NDArray[np.float64]:
    values = measure.values(entry.results)
    known: npt.NDArray[np.float64] = np.sort(values[np.isfinite(values)])
    return known


def _difference(axes: Axes, place: int, found: Interval, *, clear: bool) -> None:
    if found.low is not None and found.high is not None:
        axes.plot([found.low, found.high], [place, place], color=palette.INK, linewidth=1.6)
    inside = palette.INK if clear else palette.WHITE
    axes.plot(found.estimate, place, "o", color=palette.INK, markerfacecolor=inside)
