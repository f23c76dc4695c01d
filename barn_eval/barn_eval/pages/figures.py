"""The figures of a report but for those on maps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from barn_eval.analysis.compare import Comparison, Value
from barn_eval.analysis.difficulty import Band, Difficulty, by_world
from barn_eval.analysis.sources import Entry
from barn_eval.pages import drawing
from barn_eval.trials.outcome import Outcome
from barn_metrics.bootstrap import Interval

_OUTCOMES = tuple(Outcome)


def worlds_figure(entries: Sequence[Entry], order: Difficulty, predicted: Sequence[float] = ()) -> Figure:
    """Draw the counted time per metre of each world, worlds from easy to difficult (the paper's Fig. 6).

    predicted: that of the difficulty model for each world, if it is to be drawn.
    """
    figure = drawing.new_figure(4.4)
    axes = figure.add_subplot()
    rank = np.arange(1, len(order.worlds) + 1)
    mean, spread = np.array(order.mean_s_per_m), np.array(order.spread_s_per_m)
    axes.fill_between(rank, mean - spread, mean + spread, color=drawing.FAINT, alpha=0.3, linewidth=0)
    axes.plot(rank, mean, color=drawing.INK, linewidth=1.6)
    handles = [axes.lines[0], axes.collections[0]]
    names = ["mean over planners", "± standard deviation of its trials"]
    if np.isfinite(predicted).any():
        handles += axes.plot(rank, predicted, color=drawing.INK, linewidth=0.9, linestyle=":")
        names.append("predicted")
    for index, entry in enumerate(entries):
        groups = by_world(entry.results)
        values = np.array(
            [
                np.mean([one.scores.normalised_time_s_per_m for one in groups[world]]) if world in groups else np.nan
                for world in order.worlds
            ]
        )
        size = 16 if len(rank) > 60 else 34
        handles.append(
            axes.scatter(
                rank, values, s=size, color=drawing.colour_of(index), marker=drawing.marker_of(index), alpha=0.8, lw=0
            )
        )
    drawing.label_axes(axes, "world, from easy to difficult [rank]", "time per metre as counted [s/m]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(bottom=0)
    drawing.legend_below(figure, handles, [*names, *(entry.label for entry in entries)])
    return figure


def bands_figure(entries: Sequence[Entry], bands: Sequence[Band]) -> Figure:
    """Draw success and time by band of difficulty, with 95 % intervals."""
    figure = drawing.new_figure(3.9)
    panels = figure.subplots(1, 2)
    places = np.arange(len(bands))
    handles = []
    for index, _ in enumerate(entries):
        shift = (index - (len(entries) - 1) / 2) * min(0.16, 0.6 / len(entries))
        rows = [band.rows[index] for band in bands]
        handles.append(_points(panels[0], places + shift, [row.success_rate for row in rows], index, 100.0))
        _points(panels[1], places + shift, [row.normalised_time_s_per_m for row in rows], index)
    for axes, unit, title in (
        (panels[0], "success [%]", "Success"),
        (panels[1], "time per metre [s/m]", "Time per metre as counted"),
    ):
        drawing.label_axes(axes, "worlds by difficulty [band]", unit, title)
        axes.set_xticks(places, [f"{band.name}\n({len(band.worlds)})" for band in bands])
        axes.set_ylim(bottom=0)
    panels[0].set_ylim(0, 104)
    drawing.legend_below(figure, handles, [entry.label for entry in entries])
    return figure


def strip_figure(entries: Sequence[Entry], order: Difficulty) -> Figure:
    """Draw the outcome of every trial: worlds across from easy to difficult, an entry per strip, a trial per line."""
    heights = [max(one.repetition for one in entry.results) + 1 for entry in entries]
    figure = drawing.new_figure(1.4 + sum(0.28 + min(0.15 * height, 1.2) for height in heights))
    panels = figure.subplots(len(entries), 1, sharex=True, squeeze=False)[:, 0]
    colours = [drawing.NO_TRIAL, *(drawing.outcome_colour(outcome) for outcome in _OUTCOMES)]
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
    panels[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    panels[-1].set_xlabel("world, from easy to difficult [rank]")
    names = ["no trial", *(outcome.value.replace("_", " ") for outcome in _OUTCOMES)]
    shown = sorted(there)
    drawing.legend_below(figure, [Patch(color=colours[one]) for one in shown], [names[one] for one in shown])
    return figure


def paired_figure(comparisons: Sequence[Comparison]) -> Figure:
    """Draw differences of pairs of entries with their 95 % intervals; what leaves out zero is filled."""
    figure = drawing.new_figure(1.3 + 0.36 * len(comparisons))
    panels = figure.subplots(1, 3, sharey=True)
    chosen = (
        ("success", "difference in success [percentage points]", 100.0, False),
        ("time per metre as counted", "difference in time per metre [s/m]", 1.0, False),
        ("time per metre as counted", "probability that the first is faster", 1.0, True),
    )
    for axes, (measure, title, factor, improvement) in zip(panels, chosen, strict=True):
        neutral = 0.5 if improvement else 0.0
        for place, one in enumerate(comparisons):
            row = next(row for row in one.rows if row.measure == measure)
            _difference(axes, place, row.paired.improvement if improvement else row.paired.difference, factor, neutral)
        axes.axvline(neutral, color=drawing.INK, linewidth=1.0, linestyle="--")
        drawing.label_axes(axes, title, "")
    panels[0].set_yticks(
        range(len(comparisons)), [f"{drawing.plain(one.a)} - {drawing.plain(one.b)}" for one in comparisons]
    )
    panels[0].set_ylim(len(comparisons) - 0.4, -0.6)
    return figure


def distributions_figure(entries: Sequence[Entry]) -> Figure:
    """Draw the share of trials up to each value of time per metre, clearance, speed and jerk."""
    figure = drawing.new_figure(3.6)
    panels = figure.subplots(1, 4)
    chosen: tuple[tuple[str, Value], ...] = (
        ("time per metre as counted [s/m]", lambda one: one.scores.normalised_time_s_per_m),
        ("smallest clearance [m]", lambda one: one.measures.min_clearance_m),
        ("mean speed [m/s]", lambda one: one.measures.mean_speed_mps),
        ("rms jerk [m/s³]", lambda one: one.measures.rms_jerk_mps3),
    )
    handles = {}
    for axes, (title, value) in zip(panels, chosen, strict=True):
        for index, entry in enumerate(entries):
            found = [value(one) for one in entry.results]
            known = np.sort([one for one in found if one is not None])
            if len(known):
                style = ("-", "--", "-.", ":")[index % 4]
                handles[index] = axes.ecdf(known, color=drawing.colour_of(index), linewidth=1.8, linestyle=style)
        drawing.label_axes(axes, title, "")
        axes.set_ylim(0, 1.02)
    panels[0].set_ylabel("share of trials up to")
    drawing.legend_below(figure, list(handles.values()), [entries[index].label for index in handles])
    return figure


def compute_figure(entries: Sequence[Entry]) -> Figure | None:
    """Draw the planner's time per cycle: of each trial its median, 95th percentile and largest; None if not known."""
    kinds: tuple[tuple[str, Value], ...] = (
        ("median", lambda one: one.wall_clock.compute_p50_ms),
        ("95th percentile", lambda one: one.wall_clock.compute_p95_ms),
        ("largest", lambda one: one.wall_clock.compute_max_ms),
    )
    found = [[[kind(one) for one in entry.results] for entry in entries] for _, kind in kinds]
    values = [[np.array([one for one in group if one is not None]) for group in groups] for groups in found]
    if not any(len(group) for groups in values for group in groups):
        return None
    figure = drawing.new_figure(1.3 + 0.42 * len(entries))
    panels = figure.subplots(1, 3, sharey=True, sharex=True)
    for axes, (title, _), groups in zip(panels, kinds, values, strict=True):
        boxes = axes.boxplot(groups, orientation="horizontal", widths=0.6, whis=(5, 95), showfliers=False)
        for parts in ("boxes", "whiskers", "caps", "medians"):
            for index, line in enumerate(boxes[parts]):
                entry = index // (len(boxes[parts]) // len(entries))
                line.set(color=drawing.colour_of(entry), linewidth=1.8 if parts != "medians" else 2.6)
        axes.set_xscale("log")
        drawing.label_axes(axes, "time per cycle [ms]", "", title)
    panels[0].set_yticks(range(1, len(entries) + 1), [drawing.plain(entry.label) for entry in entries])
    panels[0].set_ylim(len(entries) + 0.6, 0.4)
    return figure


def _points(
    axes: Axes, places: npt.NDArray[Any], intervals: Sequence[Interval], index: int, factor: float = 1.0
) -> object:
    middle = np.array([one.estimate for one in intervals]) * factor
    low, high = (
        np.array([np.nan if limit is None else limit for limit in limits]) * factor
        for limits in ([one.low for one in intervals], [one.high for one in intervals])
    )
    return axes.errorbar(
        places,
        middle,
        np.array([np.maximum(middle - low, 0.0), np.maximum(high - middle, 0.0)]),
        color=drawing.colour_of(index),
        marker=drawing.marker_of(index),
        linestyle="",
        capsize=3,
        markersize=6,
    )


def _difference(axes: Axes, place: int, found: Interval, factor: float, neutral: float) -> None:
    clear = found.low is not None and found.high is not None and (found.low > neutral or found.high < neutral)
    if found.low is not None and found.high is not None:
        axes.plot([found.low * factor, found.high * factor], [place, place], color=drawing.INK, linewidth=1.6)
    axes.plot(
        found.estimate * factor, place, "o", color=drawing.INK, markerfacecolor=drawing.INK if clear else "#ffffff"
    )
