"""`barn report`: runs as one page."""

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
    """Seldom used settings of a report."""

    columns: str = quantity(
        "", "measures of the tables, columns of the results, such as success,challenge"
    )
    hardest: int = quantity(
        DEFAULT_HARDEST, "hardest worlds in their figure", "", 0, 40
    )
    title: str = quantity("", "title of the page")
    width_mm: float = quantity(
        0.0, "width of figures in OUT_assets, 0 for that of the page", "mm", minimum=0.0
    )


@click.command("report")
@folders_argument
@path_option(
    "-o",
    "--out",
    help="The page [default: report.html in FOLDER; of several, in this folder].",
)
@flag_option("--open", "is_opened", help="Show the page in a browser.")
@click.option(
    "--assets/--no-assets",
    default=True,
    help="Write figures and tables into OUT_assets as well.",
)
@flag_option(
    "--replays",
    help="Draw the replay of each bag into OUT_replays and link to it.",
)
@parameters_option(
    "--set", "parameters", "Of the page and its figures", ReportSettings()
)
def command(
    folders: tuple[Path, ...],
    out: Path | None,
    is_opened: bool,
    assets: bool,
    replays: bool,
    parameters: dict[str, Any],
) -> None:
    """Write the report of FOLDERS of runs, finished or not.

    Figures go beside the page as SVG and PDF, tables as CSV and LaTeX. --set
    width_mm=88 fits a column.
    """
    if out is None:
        out = Path("report.html")
        if len(folders) == 1 and folders[0].is_dir():
            out = folders[0] / out
    # Before the report is computed, which takes minutes for a large run.
    if out.is_dir():
        raise click.UsageError(f"--out {out}: is a folder, name a file")
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
