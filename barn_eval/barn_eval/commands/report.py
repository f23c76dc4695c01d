"""`barn report`: experiments as one page."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from barn_eval.api.results.folders import report
from barn_eval.commands.options import (
    PATH,
    parameters_option,
    print_notes,
    progress_bar,
    split_names,
)
from barn_eval.pages.report.page import DEFAULT_HARDEST
from barn_worlds.base.config import Checked, as_dict, from_dict, quantity


@dataclass(frozen=True)
class Look(Checked):
    """What is chosen now and then."""

    columns: str = quantity(
        "", "measures of the tables, columns of the results, such as success,challenge"
    )
    hardest: int = quantity(DEFAULT_HARDEST, "worlds drawn as maps", "", 0, 40)
    title: str = quantity("", "title of the page")
    width_mm: float = quantity(
        0.0, "width of figures in OUT_assets, 0 for that of the page", "mm", minimum=0.0
    )


@click.command("report")
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option("--out", default="report.html", type=PATH, help="The page.")
@click.option(
    "--assets/--no-assets",
    default=True,
    help="Write figures and tables into OUT_assets as well.",
)
@click.option(
    "--replays",
    is_flag=True,
    help="Draw the replay of each bag into OUT_replays and link to it.",
)
@parameters_option("--set", "settings", "Of the page and its figures", Look())
def command(
    folders: tuple[Path, ...],
    out: Path,
    assets: bool,
    replays: bool,
    settings: dict[str, Any],
) -> None:
    """Write the report of FOLDERS of experiments, finished or not.

    Figures go beside the page as SVG and PDF, tables as CSV and LaTeX. --set width_mm=88 fits a column.
    """
    if out.is_dir():
        raise click.UsageError(f"--out {out}: is a folder, name a file")
    look = from_dict(Look, settings, "--set")
    chosen = as_dict(look) | {
        "columns": split_names(look.columns),
        "width_mm": look.width_mm or None,
    }
    beside = out.with_name(f"{out.stem}_assets") if assets else None
    drawn = out.with_name(f"{out.stem}_replays") if replays else None
    with progress_bar("making the report") as share:
        report(folders, out, assets=beside, replays=drawn, progress=share, **chosen)
    print_notes(out)
    if assets:
        print_notes(f"figures and tables in {beside}")
