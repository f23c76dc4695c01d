"""`barn leaderboard`: planners of many campaigns, ranked."""

from pathlib import Path

import click

from barn_eval.commands.options import FILE, PATH, say

RANKINGS = ("challenge", "challenge_2022", "success", "time")  # of barn_eval.analysis.leaderboard, which takes long


@click.command()
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option("--by", type=click.Choice(RANKINGS), help="What is ranked by [default: the metric of the protocol].")
@click.option("--out", type=PATH, help="File ending in .md or .html [default: Markdown, printed].")
@click.option("--html", type=FILE, help="Write it as HTML as well.")
def leaderboard(folders: tuple[Path, ...], by: str | None, out: Path | None, html: Path | None) -> None:
    """Rank the planners of FOLDERS of runs or campaigns.

    Planners that cannot be told apart share a rank. Each protocol and set of worlds has a board of its own.
    """
    from barn_eval.analysis.leaderboard import leaderboard as rank  # noqa: PLC0415 (scipy)
    from barn_eval.pages.leaderboard import markdown, page, write_boards  # noqa: PLC0415
    from barn_eval.pages.page import write_page  # noqa: PLC0415

    if out is not None and out.suffix not in (".md", ".html"):
        raise click.UsageError(f"--out {out}: must end in .md or .html")
    boards = rank(folders, by or "")
    if out is None:
        click.echo(markdown(boards))
    else:
        write_boards(boards, out)
    if html is not None:
        write_page(html, page(boards))
    for path in filter(None, (out, html)):
        say(path)
