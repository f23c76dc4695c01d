"""A report from its folders to the page, and the figures and tables beside it."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from textwrap import fill
from typing import Any
from urllib.parse import quote

from matplotlib.axes import Axes

from barn_eval.analysis.difficulty import order_worlds as order_of
from barn_eval.analysis.measures import ranking_measure, require_measures
from barn_eval.analysis.overview import Overview, analyze, make_tables, reproduce
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import Entry, read_entries, require_same_task
from barn_eval.analysis.summary import make_bars
from barn_eval.analysis.text_table import TextTable
from barn_eval.analysis.verdict import list_cautions
from barn_eval.pages import Progress
from barn_eval.pages.figures import (
    ReportFigure,
    figure_of,
    finished,
    new_figure,
    plain,
    style,
)
from barn_eval.pages.replay.page import replay_page
from barn_eval.pages.report.charts import CHARTS, Chart, ChartData
from barn_eval.pages.report.maps import hardest_maps
from barn_eval.pages.report.processes import run_forked
from barn_eval.pages.report.trials import (
    DrivenTrial,
    driven_trials,
    trial_data,
    worlds_by_number,
)
from barn_eval.pages.template import render, write_page
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.folder import REPLAYS
from barn_eval.running.sweep import expanded
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.worlds.world import World

Onto = Axes | Sequence[Axes] | None
DEFAULT_HARDEST = 8  # worlds that are drawn as maps


def draw(
    chart: Chart, data: ChartData, ax: Onto = None, width_mm: float | None = None
) -> list[Axes]:
    """Draw a figure of the catalogue and return its axes, none where it has nothing to show.

    ax: what to draw onto, as many as the figure has panels; without, a figure of its own. width_mm: of that.
    """
    layout = chart.layout(data)
    if layout is None:
        return []
    count = layout.rows * layout.columns
    if ax is None:
        height_in, columns, rows, sharex, sharey, width_in = (
            layout.fitted(width_mm / 25.4) if width_mm else layout
        )
        figure = new_figure(height_in, width_in)
        grid = figure.subplots(
            rows, columns, sharex=sharex, sharey=sharey, squeeze=False
        )
        panels, spare = list(grid.ravel()[:count]), grid.ravel()[count:]
        for axes in spare:
            axes.remove()
    else:
        panels = [ax] if isinstance(ax, Axes) else list(ax)
        if len(panels) != count:
            raise ConfigError(
                f"ax: the figure {chart.name!r} has {count} panels, got {len(panels)} axes"
            )
    legend = chart.draw(panels, data)
    for axes in panels if width_mm else ():
        axes.set_ylabel(fill(axes.get_ylabel(), 25))
    texts = [plain(text) for text in legend.labels]
    if legend.handles and ax is None:
        figure = figure_of(panels)
        most = min(6, int(figure.get_figwidth() / 1.1))
        figure.legend(
            legend.handles,
            texts,
            loc="outside lower center",
            ncols=min(most, len(texts)),
        )
    elif legend.handles:
        panels[0].legend(legend.handles, texts)
    return panels


def plot(
    name: str, entries: Sequence[Entry], ax: Onto = None, width_mm: float | None = None
) -> list[Axes]:
    """Draw the figure of that name of planners' results, onto axes or a figure of its own, and return its axes.

    width_mm: as of `draw`. ConfigError for an unknown name, a wrong number of axes, and where there is nothing to draw.
    """
    if name not in CHARTS:
        raise ConfigError(f"unknown figure {name!r}{suggest(name, CHARTS)}")
    order, shown = order_of(entries), {}
    if name == "hardest":
        drives, worlds = driven_trials(entries)
        shown = hardest_maps(
            order, drives, worlds_by_number(drives, worlds), DEFAULT_HARDEST
        )
    overview = cache(
        lambda: analyze(entries, order, lambda jobs: [job() for job in jobs])
    )
    with style(checked_width(width_mm)):
        panels = draw(
            CHARTS[name], ChartData(entries, order, overview, shown), ax, width_mm
        )
    if not panels:
        raise ConfigError(f"figure {name!r}: these results have nothing to show in it")
    return panels


def checked_width(width_mm: float | None) -> float | None:
    """Return the width of a figure in a paper; ConfigError for one that no paper has."""
    if width_mm is not None and not 60.0 <= width_mm <= 400.0:
        raise ConfigError(f"width_mm: must lie in 60 to 400, got {width_mm!r}")
    return width_mm


def finish(
    chart: Chart, data: ChartData, *, pdf: bool, width_mm: float | None = None
) -> ReportFigure | None:
    """Return a figure of the catalogue as pages have it, or papers; None where it has nothing to show."""
    with style(width_mm):
        panels = draw(chart, data, width_mm=width_mm)
        return (
            finished(figure_of(panels), chart.name, chart.about, pdf=pdf)
            if panels
            else None
        )


@dataclass(frozen=True, eq=False)
class Report:
    """All that a report shows.

    data: what its figures are drawn of. columns: keys of the measures of its tables, those usual without any. pdf:
    whether figures are drawn as PDF too. progress: gets the share that is done.
    """

    entries: Sequence[Entry]
    overview: Overview
    data: ChartData
    drives: Sequence[DrivenTrial]
    worlds: Mapping[str, World]
    columns: Sequence[str]
    pdf: bool
    progress: Progress

    @property
    def names(self) -> list[str]:
        """Its planners, by which many settings of few are summed up."""
        return list(dict.fromkeys(spelling(entry.planner) for entry in self.entries))

    @cached_property
    def tables(self) -> list[TextTable]:
        """All tables, the headline first."""
        return make_tables(self.entries, self.overview, self.columns)

    @cached_property
    def figures(self) -> dict[str, ReportFigure]:
        """Its figures by name, each drawn in the process that finishes it: figures of matplotlib change by pickling."""
        jobs = [
            partial(finish, chart, self.data, pdf=self.pdf)
            for chart in reversed(CHARTS.values())
        ]
        made = run_forked(jobs, lambda share: self.progress(0.5 + 0.5 * share))
        return {one.name: one for one in made if one is not None}


def build_report(
    paths: Sequence[Path],
    hardest: int = DEFAULT_HARDEST,
    *,
    columns: Sequence[str] = (),
    progress: Progress = lambda _: None,
    pdf: bool = True,
) -> Report:
    """Read folders and compute what their report shows; BarnError in one line for what is no run or campaign.

    columns: keys of the measures of its tables. progress: gets the share that is done.
    """
    keys = require_measures(columns)
    entries = tuple(read_entries(paths))
    require_same_task(expanded(paths))
    drives, worlds = driven_trials(entries)
    numbered, order = worlds_by_number(drives, worlds), order_of(entries)
    found = analyze(
        entries,
        order,
        lambda jobs: run_forked(jobs, lambda share: progress(0.5 * share)),
        keys,
    )
    shown = hardest_maps(order, drives, numbered, hardest)
    data = ChartData(entries, order, lambda: found, shown)
    return Report(entries, found, data, drives, worlds, keys, pdf, progress)


def replay_links(
    report: Report, out: Path, replays: Path | None = None
) -> dict[Path, str]:
    """Return the address of each trial's replay as seen from a page, by its bag; draw those that are wanted.

    Pages that lie in the folder of a source, in replays/, are linked to wherever there are any.
    """
    links = {}
    for drive in report.drives:
        source, trial_id = drive.entry.source, drive.result.trial_id
        bag, page = source.bag(trial_id), source.path / REPLAYS / f"{trial_id}.html"
        if replays is not None and bag.exists():
            page = replays / f"{source.path.resolve().name}_{trial_id}.html"
            write_page(page, replay_page(read_recorded_trial(bag)))
        if page.is_file():
            links[bag] = quote(os.path.relpath(page, out.parent))
    return links


def report_page(
    report: Report, title: str, links: Mapping[Path, str] | None = None
) -> str:
    """Return the page of a report; texts from files are text in it. links: of `replay_links`."""
    sources = list(dict.fromkeys(entry.source for entry in report.entries))
    first, leaders = report.entries[0].results[0], make_bars(report.entries)
    return render(
        "report.html",
        title=title,
        report=report,
        tables={table.name: table for table in report.tables},
        paired=[table for table in report.tables if table.name.startswith("paired_")],
        sources=[(source, reproduce(source)) for source in sources],
        robot=sources[0].robot or "Jackal",
        first=first,
        leaders=leaders,
        metric=ranking_measure(report.entries[0].results).heading,
        notes=list_cautions(leaders.worlds, sources),
        tracks=sum(drive.track is not None for drive in report.drives),
        moving=any(world.moving or world.walls for world in report.worlds.values()),
        flatten=flatten,
        data=trial_data(
            report.entries, report.drives, report.worlds, links, report.columns
        )
        | {
            "bands": [
                {"name": band.name, "worlds": band.worlds}
                for band in report.overview.bands
            ]
        },
    )


def write_assets(report: Report, folder: Path, width_mm: float | None = None) -> None:
    """Write figures as SVG and PDF, of a paper's width if it is given, and tables as CSV and LaTeX into a folder."""
    for table in report.tables:
        write_page(folder / f"{table.name}.csv", table.csv())
        write_page(folder / f"{table.name}.tex", table.latex())
    figures = list(report.figures.values())
    if width_mm is not None:
        jobs = [
            partial(finish, CHARTS[one.name], report.data, pdf=True, width_mm=width_mm)
            for one in figures
        ]
        figures = run_forked(jobs, lambda _: None)
    for picture in figures:
        picture.write(folder)


def flatten(content: object, name: str = "") -> list[tuple[str, str]]:
    """Return the leaves of nested data as dotted names and texts."""
    inner: Mapping[Any, object] = content if isinstance(content, Mapping) else {}
    if isinstance(content, (list, tuple)):
        if not any(isinstance(one, (Mapping, list, tuple)) for one in content):
            return [(name, ", ".join(map(str, content)))]
        inner = dict(enumerate(content))
    if not inner:
        return [(name, "" if content is None else str(content))]
    return [
        row
        for key, value in inner.items()
        for row in flatten(value, f"{name}.{key}".removeprefix("."))
    ]
