"""A report from its folders to the page, and the figures and tables beside it."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from urllib.parse import quote

from barn_eval.analysis.difficulty import PREDICTED, by_prediction, predicted
from barn_eval.analysis.difficulty import difficulty as order_of
from barn_eval.analysis.measures import metric_of
from barn_eval.analysis.overview import Overview, analyse, repeat, tables
from barn_eval.analysis.sources import Entry, read_entries, require_same_task
from barn_eval.analysis.text_table import TextTable
from barn_eval.analysis.verdict import cautions
from barn_eval.bags.recorded import read_recorded
from barn_eval.experiments.folder import REPLAYS
from barn_eval.pages import DIFFICULTIES, Progress
from barn_eval.pages.figures import ReportFigure
from barn_eval.pages.replay.page import replay_page
from barn_eval.pages.report import maps
from barn_eval.pages.report.bars import bars
from barn_eval.pages.report.catalogue import CHARTS, DEFAULT_HARDEST, finish
from barn_eval.pages.report.charts import ChartData
from barn_eval.pages.report.processes import run_forked
from barn_eval.pages.report.trial_data import trial_data
from barn_eval.pages.report.trials import DrivenTrial, driven_trials, worlds_by_number
from barn_eval.pages.template import render, write_page
from barn_eval.trials.identity import task_line
from barn_worlds.base.errors import ConfigError
from barn_worlds.worlds.world import World

Note = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Report:
    """All that a report shows.

    data: what its figures are drawn of. pdf: whether they are drawn as PDF too. progress: gets the share that is done.
    """

    data: ChartData
    tables: tuple[TextTable, ...]
    drives: tuple[DrivenTrial, ...]
    worlds: Mapping[str, World]
    pdf: bool
    progress: Progress

    @property
    def entries(self) -> Sequence[Entry]:
        """The planners."""
        return self.data.entries

    @property
    def overview(self) -> Overview:
        """What it says in figures."""
        return self.data.overview()

    @cached_property
    def figures(self) -> dict[str, ReportFigure]:
        """Its figures by name, each drawn in the process that finishes it: figures of matplotlib change by pickling."""
        jobs = [partial(finish, chart, self.data, pdf=self.pdf) for chart in CHARTS.values() if chart.on_page]
        made = run_forked(jobs, lambda share: self.progress(0.5 + 0.5 * share))
        return {one.name: one for one in made if one is not None}


def build_report(
    paths: Sequence[Path],
    hardest: int = DEFAULT_HARDEST,
    note: Note = lambda _: None,
    *,
    difficulty: str = DIFFICULTIES[0],
    progress: Progress = lambda _: None,
    pdf: bool = True,
) -> Report:
    """Read folders and compute what their report shows; BarnError in one line for what is no run or campaign.

    note: gets a line at each step that takes time. difficulty: "trials" orders worlds by the trials themselves, "model"
    by the difficulty that the model predicts, so that no trial is used twice. progress: gets the share that is done.
    """
    if difficulty not in DIFFICULTIES:
        raise ConfigError(f"difficulty {difficulty!r}: must be one of {', '.join(DIFFICULTIES)}")
    entries = tuple(read_entries(paths))
    require_same_task(paths)
    drives, worlds = driven_trials(entries)
    numbered, order = worlds_by_number(drives, worlds), order_of(entries)
    if difficulty == "model":
        order = by_prediction(order, numbered)
    learned = entries[0].results[0].protocol == PREDICTED and difficulty == "trials"
    note(f"computing intervals and comparisons of {len(drives)} trials")
    found = analyse(entries, order, lambda jobs: run_forked(jobs, lambda share: progress(0.5 * share)))
    shown = maps.hardest_maps(order, drives, numbered, hardest)
    data = ChartData(entries, order, lambda: found, predicted(order, numbered) if learned else (), shown)
    return Report(data, tuple(tables(entries, found)), tuple(drives), worlds, pdf, progress)


def write_report(
    folders: Sequence[Path],
    out: Path,
    *,
    assets: Path | None = None,
    title: str = "",
    hardest: int = DEFAULT_HARDEST,
    difficulty: str = DIFFICULTIES[0],
    replays: Path | None = None,
    note: Note = lambda _: None,
    progress: Progress = lambda _: None,
) -> Report:
    """Write the report of folders of results as one page and return what it shows.

    Args:
        folders: runs and campaigns, finished or not.
        out: file of the page.
        assets: a folder that gets figures as SVG and PDF and tables as CSV and LaTeX.
        title: of the page [that of its planners].
        hardest: how many worlds are drawn as maps.
        difficulty: what worlds are ordered by, "trials" or "model".
        replays: a folder that gets a page for each bag, which the report links to.
        note: gets a line at each step that takes time.
        progress: gets the share that is done.

    Raises:
        BarnError: for what is no run or campaign, and for folders of different tasks.
        StoreError: for a file that cannot be written.
    """
    pdf = assets is not None
    made = build_report(folders, hardest, note, difficulty=difficulty, progress=progress, pdf=pdf)
    note("drawing figures and writing the page")
    named = title or "Navigation benchmark: " + ", ".join(entry.label for entry in made.entries)
    write_page(out, report_page(made, named, replay_links(made, out, replays, note)))
    if assets is not None:
        note("writing figures and tables")
        write_assets(made, assets)
    return made


def replay_links(
    report: Report, out: Path, replays: Path | None = None, note: Note = lambda _: None
) -> dict[Path, str]:
    """Return the address of each trial's replay as seen from a page, by its bag; draw those that are wanted.

    Pages that lie in the folder of a source, in replays/, are linked to wherever there are any.
    """
    links = {}
    for drive in report.drives:
        source, trial_id = drive.entry.source, drive.result.trial_id
        bag, page = source.bag(trial_id), source.path / REPLAYS / f"{trial_id}.html"
        if replays is not None and bag.exists():
            note(f"drawing the replay of {trial_id}")
            page = replays / f"{source.path.resolve().name}_{trial_id}.html"
            write_page(page, replay_page(read_recorded(bag)))
        if page.is_file():
            links[bag] = quote(os.path.relpath(page, out.parent))
    return links


def report_page(report: Report, title: str, links: Mapping[Path, str] | None = None) -> str:
    """Return the page of a report; texts from files are text in it. links: of `replay_links`."""
    sources = list(dict.fromkeys(entry.source for entry in report.entries))
    first = report.entries[0].results[0]
    return render(
        "report.html",
        title=title,
        report=report,
        tables={table.name: table for table in report.tables},
        paired=[table for table in report.tables if table.name.startswith("paired_")],
        sources=[(source, repeat(source)) for source in sources],
        task=task_line(first.protocol, first.task, sources[0].robot),
        leaders=bars(report.entries, report.overview.summaries),
        metric=metric_of(report.entries[0].results).heading,
        predicted=first.protocol == PREDICTED,
        notes=cautions(max(one.worlds for one in report.overview.summaries), sources),
        tracks=sum(drive.track is not None for drive in report.drives),
        moving=any(world.moving or world.walls for world in report.worlds.values()),
        flatten=flatten,
        data=trial_data(report.entries, report.drives, report.worlds, links)
        | {"bands": [{"name": band.name, "worlds": band.worlds} for band in report.overview.bands]},
    )


def write_assets(report: Report, folder: Path) -> None:
    """Write figures as SVG and PDF and tables as CSV and LaTeX into a folder."""
    for table in report.tables:
        write_page(folder / f"{table.name}.csv", table.csv())
        write_page(folder / f"{table.name}.tex", table.latex())
    for picture in report.figures.values():
        picture.write(folder)


def flatten(content: object, name: str = "") -> list[tuple[str, str]]:
    """Return the leaves of nested data as dotted names and texts."""
    if isinstance(content, Mapping) and content:
        return [row for key, value in content.items() for row in flatten(value, f"{name}.{key}" if name else str(key))]
    if isinstance(content, (list, tuple)) and any(isinstance(one, (Mapping, list, tuple)) for one in content):
        return [row for index, value in enumerate(content) for row in flatten(value, f"{name}.{index}")]
    if isinstance(content, (list, tuple)):
        return [(name, ", ".join(map(str, content)))]
    return [(name, "" if content is None else str(content))]
