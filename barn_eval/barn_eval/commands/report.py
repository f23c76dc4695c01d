"""`barn report`: write a page on one or several runs."""

import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from barn_eval.api.folders import report
from barn_eval.commands.options import (
    flag_option,
    folders_argument,
    parameters_option,
    path_option,
    print_notes,
    progress_bar,
    split_names,
)
from barn_eval.pages.report.page import DEFAULT_HARDEST
from barn_worlds.base.config import Checked, from_dict, quantity


@dataclass(frozen=True)
class ReportSettings(Checked):
    """Settings of a report that are seldom changed."""

    columns: str = quantity(
        "", "measures in the tables: columns of the results, such as success,challenge"
    )
    hardest: int = quantity(
        DEFAULT_HARDEST,
        "number of worlds in the figure of the hardest worlds",
        "",
        0,
        40,
    )
    title: str = quantity("", "title of the page")
    width_mm: float = quantity(
        0.0, "width of figures in OUT_assets; 0: as in the page", "mm", minimum=0.0
    )


@click.command("report")
@folders_argument
@path_option(
    "-o",
    "--out",
    help="File for the page [default: report.html in FOLDER or, for several folders, in the current folder].",
)
@flag_option("--open", "is_opened", help="Open the page in a browser.")
@click.option(
    "--assets/--no-assets",
    default=True,
    help="Also write figures and tables to OUT_assets.",
)
@flag_option(
    "--replays", help="Write a replay of each bag to OUT_replays and link to it."
)
@parameters_option(
    "--set", "parameters", "Setting of the page or its figures", ReportSettings()
)
def command(
    folders: tuple[Path, ...],
    out: Path | None,
    is_opened: bool,
    assets: bool,
    replays: bool,
    parameters: dict[str, Any],
) -> None:
    """Write one report on the runs in FOLDERS, finished or not.

    The command also writes figures as SVG and PDF, and tables as CSV and LaTeX, beside
    the page. To fit figures to a column of a paper, use --set width_mm=88.
    """
    if out is None:
        out = Path("report.html")
        if len(folders) == 1 and folders[0].is_dir():
            out = folders[0] / out
    # Before the report is computed, which takes minutes for a large run.
    if out.is_dir():
        raise click.UsageError(f"--out {out}: is a folder; name a file")
    settings = from_dict(ReportSettings, parameters, "--set")
    assets_folder = None
    if assets:
        assets_folder = out.with_name(f"{out.stem}_assets")
    replays_folder = None
    if replays:
        replays_folder = out.with_name(f"{out.stem}_replays")
    with progress_bar("making the report") as progress:
        report(
            folders,
            out,
            title=settings.title,
            assets=assets_folder,
            hardest=settings.hardest,
            replays=replays_folder,
            columns=split_names(settings.columns),
            # None lets figures keep the width of the page.
            width_mm=settings.width_mm or None,
            progress=progress,
        )
    print_notes(out)
    if assets:
        print_notes(f"figures and tables in {assets_folder}")
    if is_opened and not webbrowser.open(out.absolute().as_uri()):
        print_notes(f"no browser found to show {out}")
