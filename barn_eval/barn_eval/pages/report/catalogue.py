"""The catalogue of figures: what each shows and how it is laid out, for pages, files and notebooks alike."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from barn_eval.analysis.difficulty import difficulty
from barn_eval.analysis.overview import analyse
from barn_eval.analysis.sources import Entry
from barn_eval.pages.figures import ReportFigure, finished, legend_below, new_figure, plain, style
from barn_eval.pages.report import charts, maps
from barn_eval.pages.report.charts import ChartData, Legend
from barn_eval.pages.report.trials import driven_trials, worlds_by_number
from barn_worlds.base.errors import ConfigError, suggest

DEFAULT_HARDEST = 8  # worlds that are drawn as maps


class Panels(NamedTuple):
    """The panels of a figure that makes its own: height in inches, rows and columns, what they share."""

    height_in: float
    columns: int = 1
    rows: int = 1
    sharex: bool = False
    sharey: bool = False
    widths: Sequence[float] | None = None


@dataclass(frozen=True)
class Chart:
    """A figure by its name. layout: None where there is nothing to show in it. on_page: whether reports have it."""

    name: str
    about: str
    draw: Callable[[Sequence[Axes], ChartData], Legend]
    layout: Callable[[ChartData], Panels | None]
    on_page: bool = True


# Those that take longest to draw first.
_CHARTS = (
    Chart(
        "hardest",
        "The hardest worlds with all trajectories that were recorded",
        maps.hardest,
        lambda data: Panels(4.9 * maps.rows(data) + 0.5, maps.PER_ROW, maps.rows(data)) if data.hardest else None,
    ),
    Chart(
        "distributions",
        "Cumulative distributions over trials of time per metre, clearance, speed and jerk",
        charts.distributions,
        lambda _: Panels(3.6, 4),
    ),
    Chart(
        "worlds",
        "Time per metre as counted of each planner in each world, worlds from easy to difficult",
        charts.worlds,
        lambda _: Panels(4.4),
    ),
    Chart(
        "compute",
        "Planner's computing time per cycle over trials: box from quartile to quartile, whiskers 5 to 95 %",
        charts.compute,
        lambda data: (
            Panels(1.3 + 0.42 * len(data.entries), 3, sharex=True, sharey=True) if charts.computed(data) else None
        ),
    ),
    Chart(
        "outcomes",
        "Outcome of every trial in every world",
        charts.outcomes,
        lambda data: Panels(
            1.4 + sum(0.28 + min(0.15 * height, 1.2) for height in charts.strip_heights(data)),
            rows=len(data.entries),
            sharex=True,
        ),
    ),
    Chart(
        "trade",
        "Speed against safety: mean time per metre as counted over smallest clearance, and over time in contact"
        " where there was any, with 95 % intervals of both",
        charts.trade,
        lambda data: Panels(4.2, len(charts.safety(data)), sharey=True),
    ),
    Chart(
        "bands",
        "Metric, success and time per metre by band of difficulty, with 95 % intervals",
        charts.bands,
        lambda data: Panels(3.9, len(charts.banded(data))) if data.overview().bands else None,
    ),
    Chart(
        "paired",
        "Paired differences between planners with 95 % intervals; filled where the difference is clear",
        charts.paired,
        lambda data: (
            Panels(1.3 + 0.36 * len(data.overview().comparisons), 3, sharey=True)
            if data.overview().comparisons
            else None
        ),
    ),
    Chart(
        "overview",
        "Metric and success of each planner, and its time per metre in each world",
        charts.overview,
        lambda data: Panels(2.4 + 0.3 * len(data.entries), 3, widths=(1, 1, 2)),
        on_page=False,
    ),
)
CHARTS = {chart.name: chart for chart in _CHARTS}


def draw(chart: Chart, data: ChartData, ax: Axes | Sequence[Axes] | None = None) -> list[Axes]:
    """Draw a figure of the catalogue and return its axes, none where it has nothing to show.

    ax: what to draw onto, as many as the figure has panels; without, a figure of its own.
    """
    layout = chart.layout(data)
    if layout is None:
        return []
    count = layout.rows * layout.columns
    if ax is None:
        height_in, columns, rows, sharex, sharey, widths = layout
        grid = new_figure(height_in).subplots(
            rows, columns, sharex=sharex, sharey=sharey, squeeze=False, width_ratios=widths
        )
        panels = list(grid.ravel())
    else:
        panels = [ax] if isinstance(ax, Axes) else list(ax)
        if len(panels) != count:
            raise ConfigError(f"ax: the figure {chart.name!r} has {count} panels, got {len(panels)} axes")
    legend = chart.draw(panels, data)
    if legend.handles and ax is None:
        legend_below(figure_of(panels), *legend)
    elif legend.handles:
        panels[0].legend(legend.handles, [plain(text) for text in legend.labels])
    return panels


def figure_of(panels: Sequence[Axes]) -> Figure:
    """Return the figure that axes are in."""
    figure = panels[0].get_figure(root=True)
    assert figure is not None
    return figure


def plot(name: str, entries: Sequence[Entry], ax: Axes | Sequence[Axes] | None = None) -> list[Axes]:
    """Draw the figure of that name of planners' results and return its axes.

    Args:
        name: of a figure of the catalogue, such as "worlds".
        entries: the planners, as `read_entries` returns them.
        ax: axes to draw onto, as many as the figure has panels [a figure of its own].

    Raises:
        ConfigError: for an unknown name, a wrong number of axes, and where there is nothing to draw.
    """
    if name not in CHARTS:
        raise ConfigError(f"unknown figure {name!r}{suggest(name, CHARTS)}")
    order, shown = difficulty(entries), {}
    if name == "hardest":
        drives, worlds = driven_trials(entries)
        shown = maps.hardest_maps(order, drives, worlds_by_number(drives, worlds), DEFAULT_HARDEST)
    overview = cache(lambda: analyse(entries, order, lambda jobs: [job() for job in jobs]))
    with style():
        panels = draw(CHARTS[name], ChartData(entries, order, overview, hardest=shown), ax)
    if not panels:
        raise ConfigError(f"figure {name!r}: these results have nothing to show in it")
    return panels


def finish(chart: Chart, data: ChartData, *, pdf: bool) -> ReportFigure | None:
    """Return a figure of the catalogue as pages have it, None where it has nothing to show."""
    with style():
        panels = draw(chart, data)
        return finished(figure_of(panels), chart.name, chart.about, pdf=pdf) if panels else None
