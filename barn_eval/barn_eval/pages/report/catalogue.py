"""The catalogue of figures: what each shows and how it is laid out, for pages, files and notebooks alike."""

from collections.abc import Sequence
from functools import cache

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from barn_eval.analysis.difficulty import difficulty
from barn_eval.analysis.overview import analyse
from barn_eval.analysis.sources import Entry
from barn_eval.pages.figures import ReportFigure, finished, legend_below, new_figure, plain, style
from barn_eval.pages.report.charts import CHARTS, Chart, ChartData
from barn_eval.pages.report.maps import hardest_maps
from barn_eval.pages.report.trials import driven_trials, worlds_by_number
from barn_worlds.base.errors import ConfigError, suggest

DEFAULT_HARDEST = 8  # worlds that are drawn as maps


def draw(chart: Chart, data: ChartData, ax: Axes | Sequence[Axes] | None = None) -> list[Axes]:
    """Draw a figure of the catalogue and return its axes, none where it has nothing to show.

    ax: what to draw onto, as many as the figure has panels; without, a figure of its own.
    """
    layout = chart.layout(data)
    if layout is None:
        return []
    count = layout.rows * layout.columns
    if ax is None:
        height_in, columns, rows, sharex, sharey = layout
        grid = new_figure(height_in).subplots(rows, columns, sharex=sharex, sharey=sharey, squeeze=False)
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
        shown = hardest_maps(order, drives, worlds_by_number(drives, worlds), DEFAULT_HARDEST)
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
