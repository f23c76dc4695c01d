"""Make a report from folders: the page, and figures and tables beside it."""

import os
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from textwrap import fill
from types import MappingProxyType
from urllib.parse import quote

from matplotlib.axes import Axes

from barn_eval.analysis.difficulty import order_worlds
from barn_eval.analysis.entries import Entry, label_entries, read_entries
from barn_eval.analysis.measured import pair_by_world
from barn_eval.analysis.measures import ranking_measure, require_measures
from barn_eval.analysis.overview import analyze, make_tables, reproduce
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import require_same_task
from barn_eval.analysis.summary import make_bars
from barn_eval.analysis.text_table import TextTable
from barn_eval.analysis.verdict import list_cautions
from barn_eval.pages import Progress
from barn_eval.pages.figures import (
    ReportFigure,
    figure_of,
    finish_figure,
    new_figure,
    plain_text,
    style,
)
from barn_eval.pages.latex import latex_table
from barn_eval.pages.replay.page import replay_page
from barn_eval.pages.report.charts import CHARTS, Chart, ChartData, Panels
from barn_eval.pages.report.maps import order_by_contrast
from barn_eval.pages.report.processes import run_forked
from barn_eval.pages.report.trials import (
    page_data,
    positions_by_world,
    world_part,
)
from barn_eval.pages.template import render, script_json, write_page
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.folder import REPLAYS
from barn_eval.running.setting_folders import expand_sweeps
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.worlds.world import World

TargetAxes = Axes | Sequence[Axes] | None
# Number of worlds that are drawn as maps.
DEFAULT_HARDEST = 8
# A page with more trials has its data in scripts beside it.
MAX_TRIALS_IN_PAGE = 2000
_MAX_LEGEND_COLUMNS = 6
_MM_PER_IN = 25.4


def draw(
    chart: Chart, data: ChartData, ax: TargetAxes = None, width_mm: float | None = None
) -> list[Axes]:
    """Draw a chart and legend onto axes or a new figure; return the axes, [] if empty.

    Args:
        chart: One of `CHARTS`.
        data: What it is drawn from.
        ax: What to draw onto, as many axes as the chart has panels. By default a figure
            of its own.
        width_mm: Width of that figure in a paper. By default it is for a page.

    Returns:
        The axes, none if the chart has nothing to show.

    Raises:
        ConfigError: The number of axes is wrong.
    """
    panels: list[Axes] = []
    layouts: list[Panels] = []

    def make_panels(layout: Panels) -> list[Axes]:
        """Return the caller's axes, ConfigError if miscounted, or a new figure's."""
        count = layout.rows * layout.columns
        if ax is not None:
            panels.extend([ax] if isinstance(ax, Axes) else ax)
            if len(panels) != count:
                raise ConfigError(
                    f"ax: the figure {chart.name!r} needs one axes per panel: {count}, "
                    f"got {len(panels)}"
                )
            return panels

        layouts.append(layout)
        panels.extend(_new_panels(layout, width_mm))
        return panels

    handles = chart.draw(data, make_panels)
    if width_mm:
        for axes in panels:
            # In a narrow figure a long label would be higher than its panel.
            axes.set_ylabel(fill(axes.get_ylabel(), 25))
    if not handles:
        return panels
    labels = [plain_text(str(handle.get_label())) for handle in handles]
    if ax is not None:
        # The figure is the user's, so the legend stays inside of the axes.
        panels[0].legend(handles, labels)
        return panels
    figure = figure_of(panels)
    if layouts[0].is_legend_beside:
        figure.legend(handles, labels, loc="outside right upper")
        return panels
    columns = min(_MAX_LEGEND_COLUMNS, int(figure.get_figwidth() / 1.1), len(labels))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)
    return panels


def _new_panels(layout: Panels, width_mm: float | None) -> list[Axes]:
    """Return the axes of a new figure, for a paper if it has a width."""
    count = layout.rows * layout.columns
    if width_mm:
        layout = layout.fit_to(width_mm / _MM_PER_IN)
    figure = new_figure(layout.height_in, layout.width_in)
    # A map that keeps its ratio needs room for the label that it moves.
    if layout.is_legend_beside:
        figure.set_layout_engine("constrained", w_pad=0.14)
    grid = figure.subplots(
        layout.rows,
        layout.columns,
        sharex=layout.sharex,
        sharey=layout.sharey,
        squeeze=False,
    ).ravel()
    # In a paper, more columns may leave some places empty.
    for axes in grid[count:]:
        axes.remove()
    return list(grid[:count])


def plot(
    name: str,
    entries: Sequence[Entry],
    ax: TargetAxes = None,
    width_mm: float | None = None,
) -> list[Axes]:
    """Draw a chart of the catalog by name; return its axes; ConfigError if nothing.

    Args:
        name: Name of the chart in the catalog.
        entries: The planners.
        ax: As for `draw`.
        width_mm: As for `draw`.

    Returns:
        The axes.

    Raises:
        ConfigError: The name is unknown, the number of axes or the width is wrong, or
            there is nothing to draw.
    """
    if name not in CHARTS:
        raise ConfigError(f"unknown figure {name!r}{suggest(name, CHARTS)}")
    require_width(width_mm)
    order = order_worlds(entries)
    data = ChartData(
        entries=entries,
        order=order,
        # Most charts need no comparisons, which take seconds.
        compute_overview=lambda: analyze(
            entries, order, lambda jobs: [job() for job in jobs]
        ),
        hardest=DEFAULT_HARDEST,
    )
    with style(width_mm):
        panels = draw(CHARTS[name], data, ax, width_mm)
    if not panels:
        raise ConfigError(f"figure {name!r}: these results have no data for it")
    return panels


def require_width(width_mm: float | None) -> None:
    """Raise ConfigError unless a width is None or 60 to 400 mm."""
    if width_mm is not None and not 60.0 <= width_mm <= 400.0:
        raise ConfigError(f"width_mm: must lie in 60 to 400, got {width_mm!r}")


def finish_chart(
    chart: Chart, data: ChartData, *, width_mm: float | None = None
) -> ReportFigure | None:
    """Return a chart drawn as SVG and PDF; None if it has nothing to show.

    Args:
        chart: One of `CHARTS`.
        data: What it is drawn from.
        width_mm: Width in a paper. By default the chart is for a page.

    Returns:
        The figure, None if the chart has nothing to show.
    """
    with style(width_mm):
        panels = draw(chart, data, width_mm=width_mm)
        if not panels:
            return None
        return finish_figure(figure_of(panels), chart.name, chart.about)


@dataclass(frozen=True, eq=False, kw_only=True)
class Report(ChartData):
    """Everything that a report shows."""

    columns: Sequence[str]
    """Keys of the measures in its tables; the usual ones if empty."""

    simulated: Sequence[Entry]
    """Simulated trials that stand beside observed ones, in one table alone."""

    pairs: TextTable | None
    """That table; None without such trials."""

    progress: Progress
    """Receives the share that is done, from 0 to 1."""

    @property
    def worlds(self) -> dict[str, World]:
        """Available worlds by checksum."""
        worlds = {}
        for trial in self.trials:
            if isinstance(trial.world, World):
                worlds[trial.result.world_checksum] = trial.world
        return worlds

    @property
    def names(self) -> list[str]:
        """Names of the report's planners, each once however many settings it has."""
        return list(dict.fromkeys(spelling(entry.planner) for entry in self.entries))

    @cached_property
    def tables(self) -> list[TextTable]:
        """All tables of the report, the headline table first."""
        tables = make_tables(self.entries, self.overview, self.columns)
        if self.pairs is not None:
            tables.append(self.pairs)
        return tables

    @cached_property
    def figures(self) -> dict[str, ReportFigure]:
        """All charts that have something to show by name, drawn in forked processes.

        Each is drawn in the process that finishes it, since pickling changes figures of
        matplotlib.
        """
        jobs = [
            partial(finish_chart, chart, self)
            # Maps take longest and are registered last.
            for chart in reversed(CHARTS.values())
        ]
        figures = run_forked(jobs, lambda share: self.progress(0.5 + 0.5 * share))
        return {figure.name: figure for figure in figures if figure is not None}


def build_report(
    paths: Sequence[Path],
    hardest: int = DEFAULT_HARDEST,
    *,
    columns: Sequence[str] = (),
    progress: Progress = lambda _: None,
) -> Report:
    """Read results folders and compute what their report shows; nothing is written.

    Args:
        paths: Results folders of one task; beside those of an observed system, also
            folders of the suite's simulator.
        hardest: Number of the hardest worlds that are drawn as maps.
        columns: Keys of the measures in its tables. By default the usual ones.
        progress: Receives the share that is done, from 0 to 1.

    Raises:
        BarnError: A folder holds no run, or the tasks of folders differ.
    """
    keys = require_measures(columns)
    entries = tuple(read_entries(paths))
    observed = [entry for entry in entries if entry.source.system.is_observed]
    simulated = [entry for entry in entries if entry not in observed]
    pairs = None
    if observed and simulated:
        entries = tuple(label_entries(observed))
        for group in (observed, simulated):
            folders = dict.fromkeys(entry.source.path for entry in group)
            require_same_task(list(folders))
        # Before what takes minutes: they may have nothing in common.
        pairs = pair_by_world(entries, simulated)
    else:
        require_same_task(expand_sweeps(paths))
        simulated = []
    order = order_worlds(entries)
    overview = analyze(
        entries,
        order,
        lambda jobs: run_forked(jobs, lambda share: progress(0.5 * share)),
        keys,
    )
    return Report(
        entries=entries,
        order=order,
        compute_overview=lambda: overview,
        hardest=hardest,
        columns=keys,
        simulated=simulated,
        pairs=pairs,
        progress=progress,
    )


def replay_links(
    report: Report, out: Path, replays: Path | None = None
) -> dict[Path, str]:
    """Return replays' addresses relative to `out` by bag; draw them into any `replays`.

    With `replays`, the replay of each bag is drawn there first. Pages in the folder
    replays/ of a results folder are linked too.

    Args:
        report: Its trials are linked if a replay or a bag exists.
        out: Its page.
        replays: Folder into which replays are drawn. By default none is drawn.
    """
    links = {}
    for trial in report.trials:
        source = trial.entry.source
        trial_id = trial.result.trial_id
        bag = source.bag(trial_id)
        page = source.path / REPLAYS / f"{trial_id}.html"
        # Two folders may have trials of one name.
        if replays is not None and bag.exists():
            page = replays / f"{source.path.resolve().name}_{trial_id}.html"
            write_page(page, replay_page(read_recorded_trial(bag)))
        if page.is_file():
            # A relative address survives when page and replays are moved together.
            links[bag] = quote(os.path.relpath(page, out.parent))
    return links


def report_page(
    report: Report,
    title: str,
    links: Mapping[Path, str] = MappingProxyType({}),
    data_folder: Path | None = None,
) -> str:
    """Return the HTML page of a report; write its data to `data_folder` if given.

    Args:
        report: What `build_report` has computed.
        title: Title of the page.
        links: What `replay_links` returns.
        data_folder: Folder beside the page into which the data of trials are written,
            as scripts. By default the page has them in it.
    """
    entries = (*report.entries, *report.simulated)
    sources = list(dict.fromkeys(entry.source for entry in entries))
    bars = make_bars(report.entries)
    results = report.entries[0].results
    data, rows = page_data(report.entries, report.trials, report.columns)
    groups = list(positions_by_world(report.trials).values())
    if data_folder is None:
        data["parts"] = {"trials": rows}
        for place, positions in enumerate(groups):
            part = world_part(report.trials, positions, links)
            data["parts"][f"world_{place}"] = part
    else:
        data["folder"] = quote(data_folder.name)
        _write_part(data_folder, "trials", rows)
        jobs = [
            partial(_write_world, data_folder, report, place, positions, links)
            for place, positions in enumerate(groups)
        ]
        run_forked(jobs, lambda _: None)
    # The page's filters need the worlds of each band.
    data["bands"] = [
        {"name": band.name, "worlds": band.worlds} for band in report.overview.bands
    ]
    data["orders"] = {
        "hardest": report.order.worlds[::-1],
        "contrast": order_by_contrast(report.entries, report.order),
    }
    data["pdf"] = {
        figure.name: b64encode(figure.pdf).decode()
        for figure in report.figures.values()
        # The page's script draws the maps of all worlds.
        if figure.name != "hardest"
    }
    return render(
        "report.html",
        title=title,
        report=report,
        tables={table.name: table for table in report.tables},
        sources=[(source, reproduce(source)) for source in sources],
        robot=sources[0].robot or "Jackal",
        first=results[0],
        leaders=bars,
        metric=ranking_measure(results).heading,
        notes=list_cautions(bars.worlds, report.entries),
        data=data,
    )


def _write_world(
    folder: Path,
    report: Report,
    place: int,
    positions: Sequence[int],
    links: Mapping[Path, str],
) -> None:
    """Write a world and its trials as the script FOLDER/world_PLACE.js."""
    part = world_part(report.trials, positions, links)
    _write_part(folder, f"world_{place}", part)


def _write_part(folder: Path, name: str, content: object) -> None:
    """Write a part of a page's data as FOLDER/NAME.js, a script that the page can load."""
    write_page(folder / f"{name}.js", f'receive("{name}",{script_json(content)});\n')


def write_report(
    report: Report, out: Path, title: str, links: Mapping[Path, str]
) -> None:
    """Write a report's page, data in OUT_data if many; remove an earlier one's data.

    Args:
        report: What `build_report` has computed.
        out: The page.
        title: Title of the page.
        links: What `replay_links` returns.
    """
    folder = out.with_name(f"{out.stem}_data")
    # An earlier report's data would be taken for this one's.
    for path in folder.glob("world_*.js"):
        path.unlink()
    data_folder = folder if len(report.trials) > MAX_TRIALS_IN_PAGE else None
    write_page(out, report_page(report, title, links, data_folder))


def write_assets(report: Report, folder: Path, width_mm: float | None = None) -> None:
    """Write each figure as NAME.svg and NAME.pdf, each table as NAME.csv and NAME.tex.

    Args:
        report: Its tables and figures.
        folder: Folder of the files.
        width_mm: Width of the figures in a paper. By default they are those of the
            page.
    """
    for table in report.tables:
        write_page(folder / f"{table.name}.csv", table.csv())
        write_page(folder / f"{table.name}.tex", latex_table(table))
    figures = list(report.figures.values())
    if width_mm is not None:
        jobs = [
            partial(finish_chart, CHARTS[figure.name], report, width_mm=width_mm)
            for figure in figures
        ]
        figures = run_forked(jobs, lambda _: None)
    for figure in figures:
        figure.write(folder)
