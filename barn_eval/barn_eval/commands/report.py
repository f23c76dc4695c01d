"""`barn report`: runs and campaigns as one HTML page, with figures and tables beside it."""

from pathlib import Path

import click

from barn_eval.commands.options import PATH, notes, say


@click.command()
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option("--out", default="report.html", show_default=True, type=PATH, help="The page.")
@click.option("--assets", type=PATH, help="Folder of figures and tables [default: OUT_assets].")
@click.option("--no-assets", is_flag=True, help="Write the page only.")
@click.option("--title", help="Title of the page.")
@click.option("--hardest", default=8, show_default=True, type=click.IntRange(0, 40), help="Worlds drawn as maps.")
def report(
    folders: tuple[Path, ...], out: Path, assets: Path | None, no_assets: bool, title: str | None, hardest: int
) -> None:
    """Write the report of FOLDERS of runs or campaigns, finished or not.

    Figures go beside the page as SVG and PDF, tables as CSV and LaTeX.
    """
    from barn_eval.pages.report import write_report  # noqa: PLC0415 (matplotlib)

    if out.is_dir():
        raise click.UsageError(f"--out {out}: is a folder, name a file")
    beside = None if no_assets else assets or out.with_name(f"{out.stem}_assets")
    with notes.status("reading results") as status:
        write_report(folders, out, assets=beside, title=title or "", hardest=hardest, note=status.update)
    say(out)
    if beside is not None:
        say(f"figures and tables in {beside}")
