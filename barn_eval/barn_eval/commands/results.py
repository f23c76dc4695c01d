"""`barn compare`, `leaderboard`, `report` and `replay`: what the results and bags of trials say."""

from pathlib import Path

import click

from barn_eval.commands.options import FILE, PATH, console, json_option, notes, print_json, rich_table, say
from barn_worlds.config import as_dict

RANKINGS = ("challenge", "challenge_2022", "success", "time")  # of barn_eval.analysis.leaderboard, which takes long


@click.command()
@click.argument("a", type=PATH)
@click.argument("b", type=PATH)
@json_option
def compare(a: Path, b: Path, as_json: bool) -> None:
    """Compare A with B: folders of runs or campaigns, finished or not.

    FOLDER:PLANNER chooses one of several planners. Where both folders hold several and none is chosen, planners of
    the same name are compared.
    """
    from barn_eval.analysis.compare import compare_folders  # noqa: PLC0415 (scipy)
    from barn_eval.analysis.tables import comparison_table  # noqa: PLC0415

    found = compare_folders(a, b)
    if as_json:
        print_json([as_dict(one) for one in found])
        return
    console.print(*(rich_table(comparison_table(one)) for one in found))


@click.command()
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option("--by", default="challenge", show_default=True, type=click.Choice(RANKINGS), help="What is ranked by.")
@click.option("--out", type=PATH, help="File ending in .md or .html [default: Markdown, printed].")
@click.option("--html", type=FILE, help="Write it as HTML as well.")
def leaderboard(folders: tuple[Path, ...], by: str, out: Path | None, html: Path | None) -> None:
    """Rank the planners of FOLDERS of runs or campaigns.

    Planners whose paired difference is not clear share a rank. Each protocol and set of worlds has a board of its own.
    """
    from barn_eval.analysis.leaderboard import leaderboard as rank  # noqa: PLC0415 (scipy)
    from barn_eval.pages.leaderboard import markdown, page, write_boards  # noqa: PLC0415
    from barn_eval.pages.page import write_page  # noqa: PLC0415

    if out is not None and out.suffix not in (".md", ".html"):
        raise click.UsageError(f"--out {out}: must end in .md or .html")
    boards = rank(folders, by)
    if out is None:
        click.echo(markdown(boards))
    else:
        write_boards(boards, out)
    if html is not None:
        write_page(html, page(boards))
    for path in filter(None, (out, html)):
        say(path)


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


@click.command()
@click.argument("bag", type=PATH)
@click.option("--html", type=FILE, help="A page with play, pause, scrub and speed [default: NAME.html].")
@click.option("--png", type=FILE, help="A picture of the end of the trial.")
@click.option("--gif", type=FILE, help="An animation.")
@click.option("--mp4", type=FILE, help="A film; needs ffmpeg.")
@click.option("--fps", default=10.0, show_default=True, type=click.FloatRange(1.0, 60.0), help="Frames per second.")
@click.option("--speed", default=2.0, show_default=True, type=click.FloatRange(0.1, 100.0), help="Of GIF and film.")
def replay(
    bag: Path, html: Path | None, png: Path | None, gif: Path | None, mp4: Path | None, fps: float, speed: float
) -> None:
    """Draw the trial of a BAG: a rosbag2 folder (MCAP or SQLite) or an .mcap file.

    Nothing but the bag is needed. One that is cut off is shown as far as it goes.
    """
    from barn_eval.pages.replay_page import write_replay  # noqa: PLC0415 (scipy and message types)

    for path in write_replay(bag, html=html, png=png, gif=gif, mp4=mp4, frames_per_s=fps, speed=speed, note=say):
        say(path)
