"""The charts of a report, each drawn onto axes that it is given."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from barn_eval.analysis.compare import PairedMeasure
from barn_eval.analysis.difficulty import WorldOrder, results_by_world
from barn_eval.analysis.leaderboard import sweep_parameters
from barn_eval.analysis.measures import (
    MEASURES,
    Measure,
    clearance_measure,
    ranking_measure,
)
from barn_eval.analysis.overview import Overview
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import ALPHA
from barn_eval.analysis.sources import Entry
from barn_eval.pages.figures import (
    OUTCOME_COLOURS,
    WIDTH_IN,
    figure_of,
    label_axes,
    marker_of,
    plain,
    points,
    small,
)
from barn_eval.pages.report.trials import DrivenTrial
from barn_eval.running.sweep import LATENCY, value_text, values_of
from barn_eval.trials.outcome import Outcome
from barn_metrics.bootstrap import Interval
from barn_worlds.base.arrays import Floats
from barn_worlds.drawing.palette import BROKEN, INK, WHITE
from barn_worlds.worlds.world import World

_OUTCOMES = tuple(Outcome)
_TIME = MEASURES["normalised_time_s_per_m"]
_RANK = "world, from easy to difficult [rank]"
_NAMED_PER_IN = 2.4  # worlds, up to which each has its number below it
_DISTRIBUTED = (
    "normalised_time_s_per_m",
    "min_clearance_m",
    "mean_speed_mps",
    "rms_jerk_mps3",
)
_COMPUTE = {
    "median": "compute_p50_ms",
    "95th percentile": "compute_p95_ms",
    "largest": "compute_max_ms",
}
_NARROW_IN, _NARROWEST_IN = 2.2, 1.6  # panels of a paper
_IN_PAPERS, _STRIPS = 0.55, 0.9  # their height to that on a page
_WINDOWS = 15  # of a line of running means
_DASHES = ("-", "--", "-.", ":")


@dataclass(frozen=True, eq=False)
class ChartData:
    """What charts are drawn of.

    overview: the intervals and comparisons, which take time and some charts do without. hardest: worlds with the trials
    in each, by number, hardest first.
    """

    entries: Sequence[Entry]
    order: WorldOrder
    overview: Callable[[], Overview]
    hardest: Mapping[int, tuple[World, Sequence[DrivenTrial]]] = field(
        default_factory=dict
    )

    @property
    def labels(self) -> list[str]:
        """Names of the entries."""
        return [entry.label for entry in self.entries]

    @property
    def metric(self) -> Measure:
        """What the protocol ranks planners by."""
        return ranking_measure(self.entries[0].results)


class Legend(NamedTuple):
    """What a chart's legend shows, and the names."""

    handles: Sequence[Any] = ()
    labels: Sequence[str] = ()


class Panels(NamedTuple):
    """The panels of a figure that makes its own: height in inches, columns and rows, what they share."""

    height_in: float
    columns: int = 1
    rows: int = 1
    sharex: bool = False
    sharey: bool = False
    width_in: float = WIDTH_IN

    def fitted(self, width_in: float) -> "Panels":
        """Return the same panels in a figure of a paper, in as many columns as there is room for."""
        maps = min(self.rows, self.columns) > 1  # as high as they are wide
        columns = max(
            1,
            min(
                self.columns,
                int(width_in / (_NARROWEST_IN if self.sharey or maps else _NARROW_IN)),
            ),
        )
        rows = -(-self.rows * self.columns // columns)
        flatter = _IN_PAPERS if self.rows == 1 else _STRIPS
        kept = width_in * self.columns / (columns * self.width_in) if maps else flatter
        height_in = kept * self.height_in * rows / self.rows
        return self._replace(
            height_in=height_in, columns=columns, rows=rows, width_in=width_in
        )


Drawing = Callable[[Sequence[Axes], ChartData], Legend]
Layout = Callable[[ChartData], Panels | None]


class Chart(NamedTuple):
    """A figure by its name. layout: None where there is nothing to show in it."""

    name: str
    about: str
    layout: Layout
    draw: Drawing


CHARTS: dict[str, Chart] = {}


def chart(about: str, layout: Layout) -> Callable[[Drawing], Drawing]:
    """Return what enters a function into the catalogue as the figure of its name."""

    def entered(draw: Drawing) -> Drawing:
        name = draw.__name__.removeprefix("_")
        CHARTS[name] = Chart(name, about, layout, draw)
        return draw

    return entered


@chart(
    "Time per metre as counted in each world, from easy to difficult; from 30 worlds on lines are running means",
    lambda _: Panels(4.4),
)
def _worlds(panels: Sequence[Axes], data: ChartData) -> Legend:
    (axes,), order = panels, data.order
    rank = np.arange(1.0, len(order.worlds) + 1)
    handles: list[Any] = []
    window = max(1, len(rank) // _WINDOWS)
    look: dict[str, Any] = (
        {"alpha": 0.3, "markersize": 3} if window > 1 else {"markersize": 5}
    )
    for index, (entry, dashes) in enumerate(
        zip(data.entries, cycle(_DASHES), strict=False)
    ):
        groups = results_by_world(entry.results)
        times = [_TIME.values(groups.get(world, [])) for world in order.worlds]
        values = np.array([part.mean() if len(part) else np.nan for part in times])
        own: dict[str, Any] = {"color": entry.color, "marker": marker_of(index)}
        axes.plot(rank, values, linestyle="", markeredgewidth=0, **own, **look)
        middle = _running(values, window)
        line: dict[str, Any] = {
            "linestyle": dashes,
            "linewidth": 1.6,
            "markevery": max(1, len(middle) // 12),
        }
        handles += axes.plot(
            _running(rank, window), middle, markersize=5, **own, **line
        )
    label_axes(axes, _RANK, _TIME.heading)
    _world_ticks(axes, order)
    axes.set_ylim(bottom=0)
    return Legend(handles, data.labels)


def _running(values: Floats, window: int) -> Floats:
    """Return the means of so many neighbours (n - window + 1,)."""
    found: Floats = np.lib.stride_tricks.sliding_window_view(values, window).mean(
        axis=1
    )
    return found


def _differing(data: ChartData) -> list[Measure]:
    """Return what is drawn by band of difficulty, and of pairs of planners."""
    return [
        MEASURES[key] for key in dict.fromkeys((data.metric.key, "success", _TIME.key))
    ]


@chart(
    "Metric, success and time per metre by band of difficulty, with 95 % intervals",
    lambda data: Panels(3.9, len(_differing(data))) if data.overview().bands else None,
)
def _bands(panels: Sequence[Axes], data: ChartData) -> Legend:
    found, count = data.overview().bands, len(data.entries)
    places = np.arange(len(found), dtype=np.float64)
    handles = []
    for axes, measure in zip(panels, _differing(data), strict=True):
        for index, entry in enumerate(data.entries):
            shift = (index - (count - 1) / 2) * min(0.16, 0.6 / count)
            means = [
                measure.in_heading_unit(band.summaries[index][measure.key])
                for band in found
            ]
            handles.append(
                points(axes, places + shift, means, entry.color, marker_of(index))
            )
        label_axes(
            axes,
            "worlds by difficulty [band]",
            measure.heading,
            measure.title.capitalize(),
        )
        axes.set_xticks(
            places, [f"{band.name}\n({len(band.worlds)})" for band in found]
        )
        axes.set_ylim(0, 104 if measure.percent else None)
    return Legend(handles[:count], data.labels)


def _strip_heights(data: ChartData) -> list[int]:
    """Return the number of lines of each entry's strip."""
    return [max(one.repetition for one in entry.results) + 1 for entry in data.entries]


@chart(
    "Outcome of every trial in every world",
    lambda data: Panels(
        1.4 + sum(0.28 + min(0.15 * high, 1.2) for high in _strip_heights(data)),
        rows=len(data.entries),
        sharex=True,
    ),
)
def _outcomes(panels: Sequence[Axes], data: ChartData) -> Legend:
    order, colours = data.order, [WHITE, *OUTCOME_COLOURS.values()]
    column = {world: index for index, world in enumerate(order.worlds)}
    there: set[int] = set()
    for axes, entry, height in zip(
        panels, data.entries, _strip_heights(data), strict=True
    ):
        cells = np.zeros((height, len(order.worlds)), np.int64)
        for one in entry.results:
            if one.world in column:
                cells[one.repetition, column[one.world]] = 1 + _OUTCOMES.index(
                    one.outcome
                )
        there |= set(np.unique(cells).tolist())
        look: dict[str, Any] = {
            "cmap": ListedColormap(colours),
            "vmin": -0.5,
            "vmax": len(colours) - 0.5,
        }
        extent = (0.5, len(order.worlds) + 0.5, height, 0)
        axes.imshow(cells, aspect="auto", interpolation="none", extent=extent, **look)
        axes.set_title(plain(entry.label))
        axes.set_yticks(
            [0.5, height - 0.5] if height > 1 else [0.5],
            ["1", str(height)] if height > 1 else ["1"],
        )
        axes.set_ylabel("trial")
    panels[-1].set_xlabel(_RANK)
    _world_ticks(panels[-1], order)
    names = [
        one.value.replace("_", " ") if hue != BROKEN else "other failure"
        for one, hue in OUTCOME_COLOURS.items()
    ]
    shown = {["no trial", *names][one]: colours[one] for one in sorted(there)}
    return Legend(
        [Patch(facecolor=one, edgecolor=INK, linewidth=0.5) for one in shown.values()],
        list(shown),
    )


@chart(
    "Differences between planners in the same worlds with 95 % intervals, filled where clear. To the left of the dashed"
    " line the planner named on the left is better, to the right the one on the right",
    lambda data: (
        Panels(1.3 + 0.3 * pairs, len(_differing(data)) + 1, sharey=True)
        if (pairs := len(data.overview().comparisons))
        else None
    ),
)
def _paired(panels: Sequence[Axes], data: ChartData) -> Legend:
    comparisons = data.overview().comparisons
    for axes, measure in zip(panels, _differing(data), strict=False):
        rows = [one.row(measure.key) for one in comparisons]
        _draw_differences(
            axes,
            rows,
            [measure.in_heading_unit(row.paired.difference) for row in rows],
            0.0,
        )
        unit = "% points" if measure.percent else measure.unit
        label_axes(
            axes,
            f"difference [{unit}]" if unit else "difference",
            "",
            fill(measure.title, 16),
        )
        if measure.better == "smaller":
            axes.invert_xaxis()  # right is always in favour of the same planner
    rows = [one.row(data.metric.key) for one in comparisons]
    _draw_differences(panels[-1], rows, [row.paired.improvement for row in rows], 0.5)
    label_axes(panels[-1], "probability", "", "better in a trial")
    names = [f"{plain(one.b)} \u25c2 \u25b8 {plain(one.a)}" for one in comparisons]
    panels[0].set_yticks(range(len(comparisons)), names)
    panels[0].set_ylim(len(comparisons) - 0.4, -0.6)
    return Legend()


@chart(
    "Metric, success and time per metre over a parameter of a sweep or the delay of commands, with 95 % intervals",
    lambda data: (
        Panels(3.8, len(_differing(data)))
        if len(sweep_parameters(data.entries)) in (1, 2)
        else None
    ),
)
def _sweep(panels: Sequence[Axes], data: ChartData) -> Legend:
    names, lines, handles = (
        sweep_parameters(data.entries),
        dict[str, list[int]](),
        dict[str, Any](),
    )
    places = [tuple(values_of(entry.source.path).values()) for entry in data.entries]
    for index, (entry, place) in enumerate(zip(data.entries, places, strict=True)):
        line = (
            f"{names[1]} = {value_text(place[1])}"
            if len(names) > 1
            else spelling(entry.planner)
        )
        lines.setdefault(line, []).append(index)
    values = sorted(
        {place[0] for place in places}, key=lambda value: (str(type(value)), value)
    )
    numeric = all(isinstance(value, float) for value in values)
    at = np.array(values if numeric else range(len(values)), np.float64)
    for axes, measure in zip(panels, _differing(data), strict=True):
        for index, (line, entries) in enumerate(lines.items()):
            own = sorted((values.index(places[one][0]), one) for one in entries)
            means = [
                measure.in_heading_unit(data.overview().summaries[one][measure.key])
                for _, one in own
            ]
            along = at[[place for place, _ in own]] + 0.01 * index * np.ptp(
                at
            )  # beside those of other lines
            colour = data.entries[entries[0]].color
            axes.plot(
                along, [one.estimate for one in means], color=colour, linewidth=1.2
            )
            handles[line] = points(axes, along, means, colour, marker_of(index))
        if not numeric or len(at) <= 12:
            axes.set_xticks(at, [value_text(value) for value in values])
        name = "delay of commands [s]" if names == [LATENCY] else names[0]
        label_axes(axes, name, measure.heading, measure.title.capitalize())
        axes.set_ylim(0, 104 if measure.percent else None)
    return (
        Legend(list(handles.values()), list(handles)) if len(handles) > 1 else Legend()
    )


def _draw_differences(
    axes: Axes, rows: Sequence[PairedMeasure], found: Sequence[Interval], neutral: float
) -> None:
    for place, (row, interval) in enumerate(zip(rows, found, strict=True)):
        if interval.low is not None and interval.high is not None:
            axes.plot(
                [interval.low, interval.high], [place, place], color=INK, linewidth=1.6
            )
        axes.plot(
            interval.estimate,
            place,
            "o",
            color=INK,
            markerfacecolor=INK if row.p_holm <= ALPHA else "none",
        )
    axes.axvline(neutral, color=INK, linewidth=1.0, linestyle="--")


@chart(
    "Cumulative distributions over trials of time per metre, clearance, speed and jerk",
    lambda _: Panels(3.6, 4),
)
def _distributions(panels: Sequence[Axes], data: ChartData) -> Legend:
    handles = {}
    safety = clearance_measure([one for entry in data.entries for one in entry.results])
    measures = (
        MEASURES[key] if key != "min_clearance_m" else safety for key in _DISTRIBUTED
    )
    for axes, measure in zip(panels, measures, strict=True):
        for entry, dashes in zip(data.entries, cycle(_DASHES), strict=False):
            known = _known(measure, entry)
            if len(known):
                handles[entry.label] = axes.ecdf(
                    known, color=entry.color, linewidth=1.8, linestyle=dashes
                )
        label_axes(axes, measure.heading, "")
        axes.set_ylim(0, 1.02)
    panels[0].set_ylabel("share of trials up to")
    return Legend(list(handles.values()), list(handles))


def _safety(data: ChartData) -> list[Measure]:
    """Return what speed is drawn against: clearance, and contact where there was any."""
    measures = [
        clearance_measure([one for entry in data.entries for one in entry.results])
    ]
    touched = any(
        summary["contact_s"].estimate > 0.0 for summary in data.overview().summaries
    )
    return [*measures, MEASURES["contact_s"]] if touched else measures


@chart(
    "Speed against safety: mean time per metre as counted over smallest clearance, and over time in contact"
    " where there was any, with 95 % intervals of both",
    lambda data: Panels(4.2, len(_safety(data)), sharey=True),
)
def _trade(panels: Sequence[Axes], data: ChartData) -> Legend:
    handles: list[Any] = []
    for axes, measure in zip(panels, _safety(data), strict=True):
        handles = [
            points(
                axes,
                [summary[measure.key]],
                [summary[_TIME.key]],
                entry.color,
                marker_of(index),
                8,
            )
            for index, (entry, summary) in enumerate(
                zip(data.entries, data.overview().summaries, strict=True)
            )
        ]
        larger = measure.better == "larger"
        label_axes(
            axes, measure.heading, "" if axes is not panels[0] else _TIME.heading
        )
        corner = "faster and safer ↘" if larger else "↙ faster and safer"
        x, side = (0.99, "right") if larger else (0.01, "left")
        axes.text(
            x,
            0.02,
            corner,
            transform=axes.transAxes,
            ha=side,
            va="bottom",
            fontsize=small(),
        )
        axes.margins(0.15)
        axes.locator_params(
            "x", nbins=max(3, int(figure_of(panels).get_figwidth() / len(panels)))
        )
    return Legend(handles, data.labels)


@chart(
    "Planner's computing time per cycle over trials: box from quartile to quartile, whiskers 5 to 95 %",
    lambda data: (
        Panels(1.3 + 0.42 * len(data.entries), 3, sharex=True, sharey=True)
        if any(
            len(_known(MEASURES[key], entry))
            for key in _COMPUTE.values()
            for entry in data.entries
        )
        else None
    ),
)
def _compute(panels: Sequence[Axes], data: ChartData) -> Legend:
    entries = data.entries
    for axes, (title, key) in zip(panels, _COMPUTE.items(), strict=True):
        groups = [_known(MEASURES[key], entry) for entry in entries]
        boxes = axes.boxplot(
            groups, orientation="horizontal", widths=0.6, whis=(5, 95), showfliers=False
        )
        for parts in ("boxes", "whiskers", "caps", "medians"):
            for index, line in enumerate(boxes[parts]):
                entry = entries[index // (len(boxes[parts]) // len(entries))]
                line.set(
                    color=entry.color, linewidth=1.8 if parts != "medians" else 2.6
                )
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        axes.xaxis.set_major_locator(
            LogLocator(subs=(1.0, 3.0) if high < 300.0 * low else (1.0,), numticks=6)
        )
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        label_axes(axes, "time per cycle [ms]", "", title)
    panels[0].set_yticks(
        range(1, len(entries) + 1), [plain(name) for name in data.labels]
    )
    panels[0].set_ylim(len(entries) + 0.6, 0.4)
    return Legend()


def _world_ticks(axes: Axes, order: WorldOrder) -> None:
    """Write the number of each world below its rank, where there is room for all of them."""
    if len(order.worlds) > _NAMED_PER_IN * figure_of([axes]).get_figwidth():
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        return
    axes.set_xticks(
        range(1, len(order.worlds) + 1), list(map(str, order.worlds)), fontsize=small()
    )
    axes.set_xlabel("world, from easy to difficult [number]")


def _known(measure: Measure, entry: Entry) -> Floats:
    values = measure.values(entry.results)
    known: Floats = np.sort(values[np.isfinite(values)])
    return known
