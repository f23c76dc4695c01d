"""`barn report`: experiments as one page."""

from pathlib import Path

import click

from barn_eval.commands.options import PATH, progress, say
from barn_eval.pages import DIFFICULTIES
from barn_eval.pages.report.page import write_report


@click.command("report")
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option("--out", default="report.html", type=PATH, help="The page.")
@click.option("--assets/--no-assets", default=True, help="Write figures and tables into OUT_assets as well.")
@click.option("--title", default="", show_default=False, help="Title of the page.")
@click.option("--hardest", default=8, type=click.IntRange(0, 40), help="Worlds drawn as maps.")
@click.option(
    "--difficulty",
    type=click.Choice(DIFFICULTIES),
    default=DIFFICULTIES[0],
    help="What worlds are ordered by: the trials themselves, or the model's prediction.",
)
@click.option("--replays", is_flag=True, help="Draw the replay of each bag into OUT_replays and link to it.")
def command(
    folders: tuple[Path, ...], out: Path, assets: bool, title: str, hardest: int, difficulty: str, replays: bool
) -> None:
    """Write the report of FOLDERS of experiments, finished or not.

    Figures go beside the page as SVG and PDF, tables as CSV and LaTeX.
    """
    if out.is_dir():
        raise click.UsageError(f"--out {out}: is a folder, name a file")
    beside = out.with_name(f"{out.stem}_assets") if assets else None
    with progress("making the report") as share:
        write_report(
            folders,
            out,
            assets=beside,
            title=title,
            hardest=hardest,
            difficulty=difficulty,
            replays=out.with_name(f"{out.stem}_replays") if replays else None,
            progress=share,
        )
    say(out)
    if beside is not None:
        say(f"figures and tables in {beside}")
