"""Draw the charts of a report onto given axes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from barn_eval.analysis.compare import PairedMeasure
from barn_eval.analysis.difficulty import TIME, WorldOrder, means_by_world
from barn_eval.analysis.entries import Entry
from barn_eval.analysis.leaderboard import sweep_parameters
from barn_eval.analysis.measures import (
    MEASURES,
    SHOWN,
    Measure,
    clearance_measure,
    ranking_measure,
)
from barn_eval.analysis.overview import Overview
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.significance import ALPHA
from barn_eval.pages.figures import (
    DASHES,
    MARKERS,
    OUTCOME_COLORS,
    WIDTH_IN,
    Tip,
    add_tips,
    draw_estimates,
    figure_of,
    label_axes,
    look_numbers,
    plain_text,
)
from barn_eval.pages.report.trials import DrivenTrial, read_trials
from barn_eval.results.row_table import column, join
from barn_eval.running.setting_folders import LATENCY, format_setting_value
from barn_eval.trials.result import Outcome, Rows
from barn_metrics.bootstrap import Interval
from barn_worlds.base.arrays import Floats
from barn_worlds.drawing.palette import BROKEN, INK

_RANK_LABEL = "world, from easy to difficult [rank]"
# Above so many worlds per inch their numbers do not fit below the axis.
_MAX_NUMBERS_PER_IN = 2.4
# A line of running means has about so many windows.
_WINDOWS = 15
# A line of a distribution has at most so many steps.
_MAX_STEPS = 400
_COMPUTE_MEASURES = {
    "median": "compute_p50_ms",
    "95th percentile": "compute_p95_ms",
    "largest": "compute_max_ms",
}
# Smallest width of a panel in a paper, with and without an axis of its own.
_PANEL_IN = 2.2
_SHARED_PANEL_IN = 1.6
# Height of panels in a paper as a share of their height on a page.
_PAPER_HEIGHT = 0.55
_PAPER_STRIP_HEIGHT = 0.9


@dataclass(frozen=True, eq=False, kw_only=True)
class ChartData:
    """What charts are drawn from."""

    entries: Sequence[Entry]
    order: WorldOrder

    compute_overview: Callable[[], Overview]
    """Computes what `overview` is."""

    hardest: int
    """Number of the hardest worlds that are drawn as maps."""

    @cached_property
    def overview(self) -> Overview:
        """Intervals and comparisons of the entries, computed on first access."""
        return self.compute_overview()

    @cached_property
    def trials(self) -> list[DrivenTrial]:
        """All trials in the order of the entries, read on first access."""
        return read_trials(self.entries)

    @property
    def look_numbers(self) -> list[int]:
        """Positions of each entry's marker and dashes."""
        return look_numbers([entry.color for entry in self.entries])

    @property
    def looks(self) -> list[dict[str, Any]]:
        """Color, marker and label of each entry, as keyword arguments of matplotlib."""
        return [
            {"color": entry.color, "marker": MARKERS[number], "label": entry.label}
            for entry, number in zip(self.entries, self.look_numbers, strict=True)
        ]

    @property
    def dashes(self) -> list[Any]:
        """Style of each entry's lines, as matplotlib takes it."""
        return [DASHES[number] for number in self.look_numbers]

    @property
    def difference_measures(self) -> list[Measure]:
        """Ranking measure, success and time per meter, each once."""
        keys = (ranking_measure(self.entries[0].results).key, "success", TIME.key)
        return [MEASURES[key] for key in dict.fromkeys(keys)]

    @property
    def clearance_measure(self) -> Measure:
        """Clearance to moving obstacles if all trials have some, else to all obstacles."""
        return clearance_measure(join([entry.results for entry in self.entries]))


class Panels(NamedTuple):
    """The panels of a chart."""

    height_in: float
    columns: int = 1
    rows: int = 1
    sharex: bool = False
    sharey: bool = False
    width_in: float = WIDTH_IN
    is_legend_beside: bool = False

    def fit_to(self, width_in: float) -> "Panels":
        """Return the panels for a paper of this width, in the columns that fit."""
        # Maps keep the ratio of their sides; other panels become flatter.
        are_maps = min(self.rows, self.columns) > 1
        panel_in = _SHARED_PANEL_IN if self.sharey or are_maps else _PANEL_IN
        columns = max(1, min(self.columns, int(width_in / panel_in)))
        rows = -(-self.rows * self.columns // columns)
        scale = _PAPER_HEIGHT if self.rows == 1 else _PAPER_STRIP_HEIGHT
        if are_maps:
            scale = width_in * self.columns / (columns * self.width_in)
        height_in = scale * self.height_in * rows / self.rows
        return self._replace(
            height_in=height_in, columns=columns, rows=rows, width_in=width_in
        )


MakePanels = Callable[[Panels], list[Axes]]
# What a legend shows, with labels. A chart that has nothing to show makes no panels.
Handles = Sequence[Any]
Drawing = Callable[[ChartData, MakePanels], Handles]


class Chart(NamedTuple):
    """A chart of the catalog."""

    name: str
    about: str
    draw: Drawing


CHARTS: dict[str, Chart] = {}


def chart(about: str) -> Callable[[Drawing], Drawing]:
    """Return a decorator that adds a drawing function to `CHARTS`.

    The chart has the function's name without its leading underscore.
    """

    def register(draw: Drawing) -> Drawing:
        """Add the function's chart to `CHARTS` and return the function unchanged."""
        name = draw.__name__.removeprefix("_")
        CHARTS[name] = Chart(name, about, draw)
        return draw

    return register


@chart(
    "Time per meter as counted in each world, from easy to difficult; from 30 worlds on"
    " lines are running means"
)
def _worlds(data: ChartData, make_panels: MakePanels) -> Handles:
    """Draw mean time per meter by world, easiest first, and lines of running means.

    Points are means over a planner's trials in a world.
    """
    (axes,) = make_panels(Panels(4.4))
    worlds = data.order.worlds
    rank = np.arange(1.0, len(worlds) + 1)
    window = max(1, len(rank) // _WINDOWS)
    # With many worlds the lines tell the trend, and points are only its ground.
    points: dict[str, Any] = {"markersize": 5}
    if window > 1:
        points = {"alpha": 0.3, "markersize": 3}

    handles: list[Any] = []
    lines = zip(data.entries, data.looks, data.dashes, strict=True)
    for number, (entry, look, dashes) in enumerate(lines):
        group = means_by_world(entry.results, TIME)
        means: Floats = np.full(len(worlds), np.nan)
        tips: list[Tip] = []
        for place, world in enumerate(worlds):
            if world in group:
                mean = group[world]
                means[place] = mean
                text = f"{entry.label}, world {world}: {mean:.2f} s/m"
                tips.append((text, number, world))
        (marks,) = axes.plot(
            rank, means, linestyle="", markeredgewidth=0, **look, **points
        )
        add_tips(marks, tips)
        running_means = _running_means(means, window)
        handles += axes.plot(
            _running_means(rank, window),
            running_means,
            markersize=5,
            linestyle=dashes,
            linewidth=1.6,
            markevery=max(1, len(running_means) // 12),
            **look,
        )
    label_axes(axes, _RANK_LABEL, TIME.heading)
    _label_worlds(axes, data.order)
    axes.set_ylim(bottom=0)
    return handles


def _running_means(values: Floats, window: int) -> Floats:
    """Return the mean of each `window` neighboring values (n - window + 1,)."""
    # A view, which costs no memory however many worlds there are.
    windows = np.lib.stride_tricks.sliding_window_view(values, window)
    means: Floats = windows.mean(axis=1)
    return means


@chart("Metric, success and time per meter by band of difficulty, with 95% intervals")
def _bands(data: ChartData, make_panels: MakePanels) -> Handles:
    """Draw planners' means by band of difficulty per measure; nothing without bands."""
    bands = data.overview.bands
    if not bands:
        return ()
    measures = data.difference_measures
    count = len(data.entries)
    places = np.arange(len(bands), dtype=np.float64)
    ticks = [f"{band.name}\n({len(band.worlds)})" for band in bands]
    panels = make_panels(Panels(3.9, len(measures)))
    for axes, measure in zip(panels, measures, strict=True):
        handles = []
        for position, look in enumerate(data.looks):
            # Side by side around the tick, apart from those of the next band.
            shift = (position - (count - 1) / 2) * min(0.16, 0.6 / count)
            means = []
            tips = []
            for band in bands:
                mean = band.summaries[position][measure.key]
                means.append(measure.in_heading_unit(mean))
                tips.append(_tip(f"{look['label']}, {band.name}", measure, mean))
            x = places + shift
            handles.append(draw_estimates(axes, x, means, tips=tips, **look))
        _label_measure(axes, "worlds by difficulty [band]", measure)
        axes.set_xticks(places, ticks)
    return handles


def _tip(name: str, measure: Measure, mean: Interval) -> Tip:
    """Return a tip, a tuple with one text: name, mean, limits and unit."""
    return (f"{name}: {measure.text(mean)}{measure.after}",)


def _label_measure(axes: Axes, x: str, measure: Measure) -> None:
    """Label axes with a measure along y, which begins at 0, and set the title."""
    label_axes(axes, x, measure.heading, measure.title.capitalize())
    # A marker at 100% must not be cut off.
    axes.set_ylim(0, 104 if measure.percent else None)


def _outcomes_by_world(results: Rows) -> dict[int, list[str]]:
    """Return the outcomes of trials by world number, worlds ascending."""
    worlds = column(results, "world")
    outcomes = column(results, "outcome")
    return {
        world: outcomes[worlds == world].tolist()
        for world in np.unique(worlds).tolist()
    }


@chart("Outcome of every trial in every world")
def _outcomes(data: ChartData, make_panels: MakePanels) -> Handles:
    """Draw outcomes, a strip per planner: worlds along x, repetitions along y."""
    worlds = data.order.worlds
    places = {world: position for position, world in enumerate(worlds)}
    # A strip grows with its trials up to eight; more of them become thinner.
    groups = [_outcomes_by_world(entry.results) for entry in data.entries]
    heights = [max(map(len, group.values())) for group in groups]
    heights_in = [0.28 + min(0.15 * height, 1.2) for height in heights]
    panels = make_panels(Panels(1.4 + sum(heights_in), rows=len(heights), sharex=True))
    patches = {}
    for number, (axes, group) in enumerate(zip(panels, groups, strict=True)):
        # Bars by outcome, each of the trials of one world that ended in it.
        bars: dict[Outcome, list[tuple[Any, Tip]]] = {}
        for world, outcomes in group.items():
            if world not in places:
                continue
            top = 0
            for outcome in OUTCOME_COLORS:
                count = outcomes.count(outcome)
                if not count:
                    continue
                left = places[world] + 0.5
                bar = [(left, top), (left + 1.0, top)]
                top += count
                bar += [(left + 1.0, top), (left, top)]
                text = f"world {world}: {count} of {len(outcomes)} {outcome.words}"
                tip = (text, number, world, outcome.value)
                bars.setdefault(outcome, []).append((bar, tip))
        for outcome, parts in bars.items():
            corners, tips = zip(*parts, strict=True)
            color = OUTCOME_COLORS[outcome]
            areas = PolyCollection(corners, color=color, linewidth=0.3)
            add_tips(areas, tips)
            axes.add_collection(areas)
            name = outcome.words if color != BROKEN else "other failure"
            # Outcomes of one name have one color, so the legend has them once.
            patches[name] = Patch(facecolor=color, label=name)
        axes.set_title(plain_text(data.entries[number].label))
        axes.set_xlim(0.5, len(worlds) + 0.5)
        axes.set_ylim(heights[number], 0)
        axes.set_yticks([0, heights[number]])
        axes.set_ylabel("trials")
    panels[-1].set_xlabel(_RANK_LABEL)
    _label_worlds(panels[-1], data.order)
    return list(patches.values())


@chart(
    "Differences between planners in the same worlds with 95% intervals, filled where"
    " clear. To the left of the dashed line the planner named on the left is better, to"
    " the right the one on the right"
)
def _paired(data: ChartData, make_panels: MakePanels) -> Handles:
    """Draw differences by pair, a panel per measure, and P(better); nothing if no pairs."""
    comparisons = data.overview.comparisons
    if not comparisons:
        return ()
    measures = data.difference_measures
    height_in = 1.3 + 0.3 * len(comparisons)
    # The last panel has a probability, whose axis is not that of a measure.
    *panels, last_panel = make_panels(Panels(height_in, len(measures) + 1, sharey=True))
    for axes, measure in zip(panels, measures, strict=True):
        rows = [comparison.row(measure.key) for comparison in comparisons]
        sizes = [measure.in_heading_unit(row.paired.difference) for row in rows]
        _draw_differences(axes, rows, sizes, 0.0)
        unit = "% points" if measure.percent else measure.unit
        label = f"difference [{unit}]" if unit else "difference"
        label_axes(axes, label, "", fill(measure.title, 16))
        if measure.better == "smaller":
            # Right is always in favor of the same planner.
            axes.invert_xaxis()

    rows = [comparison.row(comparison.metric) for comparison in comparisons]
    chances = [row.paired.improvement for row in rows]
    _draw_differences(last_panel, rows, chances, 0.5)
    label_axes(last_panel, "probability", "", "better in a trial")
    names = [
        f"{plain_text(comparison.b)} \u25c2 \u25b8 {plain_text(comparison.a)}"
        for comparison in comparisons
    ]
    panels[0].set_yticks(range(len(names)), names)
    panels[0].set_ylim(len(names) - 0.4, -0.6)
    return ()


def _draw_differences(
    axes: Axes,
    rows: Sequence[PairedMeasure],
    intervals: Sequence[Interval],
    neutral: float,
) -> None:
    """Draw an interval per pair, filled where significant, and a line at `neutral`."""
    for place, (row, interval) in enumerate(zip(rows, intervals, strict=True)):
        if interval.low is not None and interval.high is not None:
            limits = [interval.low, interval.high]
            axes.plot(limits, [place, place], color=INK, linewidth=1.6)
        fill_color = INK if row.p_holm <= ALPHA else "none"
        marks = axes.plot(
            interval.estimate, place, "o", color=INK, markerfacecolor=fill_color
        )
        add_tips(marks[0], [(f"{row.measure}: {interval.text()}",)])
    axes.axvline(neutral, color=INK, linewidth=1.0, linestyle="--")


@chart(
    "Metric, success and time per meter over a parameter of a sweep or the delay of"
    " commands, with 95% intervals"
)
def _sweep(data: ChartData, make_panels: MakePanels) -> Handles:
    """Draw means over a swept parameter or delay; nothing unless 1 or 2 vary.

    Lines are of the second parameter's values, else of planners.
    """
    parameters = sweep_parameters(data.entries)
    if len(parameters) not in (1, 2):
        return ()
    # Values may be numbers and texts, which cannot be compared with each other.
    values = sorted(
        {entry.setting[parameters[0]] for entry in data.entries},
        key=lambda value: (str(type(value)), value),
    )
    # The first parameter is along the axis; lines are of the second, or of planners.
    lines: dict[str, list[tuple[int, int]]] = {}
    for position, entry in enumerate(data.entries):
        name = spelling(entry.planner)
        for parameter in parameters[1:]:
            name = f"{parameter} = {format_setting_value(entry.setting[parameter])}"
        tick = values.index(entry.setting[parameters[0]])
        lines.setdefault(name, []).append((tick, position))

    # Texts such as names of maps stand at equal distances.
    is_numeric = all(isinstance(value, float) for value in values)
    ticks = np.array(values if is_numeric else range(len(values)), np.float64)
    label = "delay of commands [s]" if parameters == [LATENCY] else parameters[0]
    summaries = data.overview.summaries
    measures = data.difference_measures
    panels = make_panels(Panels(3.8, len(measures)))
    for axes, measure in zip(panels, measures, strict=True):
        handles = []
        for number, (name, points) in enumerate(lines.items()):
            ordered = sorted(points)
            means = []
            tips = []
            for _, position in ordered:
                mean = summaries[position][measure.key]
                means.append(measure.in_heading_unit(mean))
                tips.append(_tip(data.entries[position].label, measure, mean))
            # A small shift keeps the limits of several lines apart.
            shift = 0.01 * number * np.ptp(ticks)
            x = ticks[[tick for tick, _ in ordered]] + shift
            # Of the line's entry that was named first.
            color = data.entries[points[0][1]].color
            axes.plot(x, [mean.estimate for mean in means], color=color, linewidth=1.2)
            marker = MARKERS[number % len(MARKERS)]
            look: dict[str, Any] = {"color": color, "marker": marker, "label": name}
            handles.append(draw_estimates(axes, x, means, tips=tips, **look))
        if not is_numeric or len(ticks) <= 12:
            axes.set_xticks(ticks, [format_setting_value(value) for value in values])
        _label_measure(axes, label, measure)
    return handles if len(handles) > 1 else ()


@chart(
    "Cumulative distributions over trials of time per meter, clearance, speed and jerk"
)
def _distributions(data: ChartData, make_panels: MakePanels) -> Handles:
    """Draw cumulative distributions over trials, a panel per measure.

    Each planner that has values has a line.
    """
    keys = SHOWN["distributions"]
    panels = make_panels(Panels(3.6, len(keys)))
    handles = {}
    for axes, key in zip(panels, keys, strict=True):
        measure = MEASURES[key]
        if key == "min_clearance_m":
            measure = data.clearance_measure
        for entry, dashes in zip(data.entries, data.dashes, strict=True):
            # A planner none of whose trials has the measure has no line.
            values = _finite_values(measure, entry)
            count = len(values)
            if not count:
                continue
            # Of many trials a line of some shows the same.
            steps = np.linspace(0, count - 1, min(count, _MAX_STEPS)).astype(int)
            (line,) = axes.plot(
                [values[0], *values[steps]],
                [0.0, *(steps + 1) / count],
                drawstyle="steps-post",
                color=entry.color,
                linewidth=1.8,
                linestyle=dashes,
                label=entry.label,
            )
            middle, most = np.quantile(values, [0.5, 0.9])
            text = f"{entry.label}: half up to {middle:.3g}, 90% up to {most:.3g}"
            add_tips(line, [(f"{text} {measure.unit}",)])
            handles[entry.label] = line
        label_axes(axes, measure.heading, "")
        axes.set_ylim(0, 1.02)
    panels[0].set_ylabel("share of trials up to")
    return list(handles.values())


@chart(
    "Speed against safety: mean time per meter as counted over smallest clearance, and"
    " over time in contact where there was any, with 95% intervals of both"
)
def _trade(data: ChartData, make_panels: MakePanels) -> Handles:
    """Draw mean time per meter over clearance and, if there was any, time in contact."""
    summaries = data.overview.summaries
    measures = [data.clearance_measure]
    if any(summary["contact_s"].estimate > 0.0 for summary in summaries):
        measures.append(MEASURES["contact_s"])
    panels = make_panels(Panels(4.2, len(measures), sharey=True))
    ticks = max(3, int(figure_of(panels).get_figwidth() / len(panels)))
    for axes, measure in zip(panels, measures, strict=True):
        handles = []
        for summary, look in zip(summaries, data.looks, strict=True):
            safety = [summary[measure.key]]
            time = [summary[TIME.key]]
            tips = [_tip(look["label"], TIME, time[0])]
            handles.append(draw_estimates(axes, safety, time, 8, tips, **look))
        y_label = TIME.heading if axes is panels[0] else ""
        label_axes(axes, measure.heading, y_label)
        x = 0.01
        side = "left"
        text = "↙ faster and safer"
        if measure.better == "larger":
            x = 0.99
            side = "right"
            text = "faster and safer ↘"
        axes.text(
            x,
            0.02,
            text,
            transform=axes.transAxes,
            ha=side,
            va="bottom",
            fontsize=rcParams["legend.fontsize"],
        )
        # Limits of the outermost planners stay within the frame.
        axes.margins(0.15)
        axes.locator_params("x", nbins=ticks)
    return handles


@chart(
    "Planner's computing time per cycle over trials: box from quartile to quartile,"
    " whiskers 5 to 95%"
)
def _compute(data: ChartData, make_panels: MakePanels) -> Handles:
    """Draw a box per planner of time per cycle [ms]; nothing if none is known.

    Panels are of median, 95th percentile and largest time of each trial.
    """
    entries = data.entries
    times_ms = {}
    for title, key in _COMPUTE_MEASURES.items():
        times_ms[title] = [_finite_values(MEASURES[key], entry) for entry in entries]
    if not any(map(len, chain.from_iterable(times_ms.values()))):
        return ()

    height_in = 1.3 + 0.42 * len(entries)
    panels = make_panels(Panels(height_in, len(times_ms), sharex=True, sharey=True))
    for axes, (title, entry_times_ms) in zip(panels, times_ms.items(), strict=True):
        boxes = axes.boxplot(
            entry_times_ms,
            orientation="horizontal",
            widths=0.6,
            whis=(5, 95),
            # A single stall of the machine would squeeze all boxes.
            showfliers=False,
        )
        for part in ("boxes", "whiskers", "caps", "medians"):
            width = 2.6 if part == "medians" else 1.8
            # A box has two whiskers and two caps, but only one median.
            lines_per_entry = len(boxes[part]) // len(entries)
            for position, line in enumerate(boxes[part]):
                number = position // lines_per_entry
                entry = entries[number]
                line.set(color=entry.color, linewidth=width)
                if len(entry_times_ms[number]):
                    middle = np.median(entry_times_ms[number])
                    text = f"{entry.label}, {title}: half up to {middle:.3g} ms"
                    add_tips(line, [(text,)])

        # Planners differ by orders of magnitude.
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        # Over few decades there is room for ticks at 3, 30, 300.
        factors = (1.0, 3.0) if high < 300.0 * low else (1.0,)
        axes.xaxis.set_major_locator(LogLocator(subs=factors, numticks=6))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        label_axes(axes, "time per cycle [ms]", "", title)
    names = [plain_text(entry.label) for entry in entries]
    panels[0].set_yticks(range(1, len(entries) + 1), names)
    panels[0].set_ylim(len(entries) + 0.6, 0.4)
    return ()


def _label_worlds(axes: Axes, order: WorldOrder) -> None:
    """Name the ticks of x by world numbers instead of ranks if all have room."""
    # A paper has less room than a page, and a user's axes have their own.
    width_in = figure_of([axes]).get_figwidth()
    if len(order.worlds) > _MAX_NUMBERS_PER_IN * width_in:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        return
    ranks = range(1, len(order.worlds) + 1)
    numbers = [str(world) for world in order.worlds]
    axes.set_xticks(ranks, numbers, fontsize=rcParams["legend.fontsize"])
    axes.set_xlabel("world, from easy to difficult [number]")


def _finite_values(measure: Measure, entry: Entry) -> Floats:
    """Return the finite values of a measure over an entry's trials, ascending."""
    values = measure.values(entry.results)
    return np.sort(values[np.isfinite(values)])
