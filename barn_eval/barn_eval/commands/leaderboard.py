"""`barn leaderboard`: planners of many experiments, ranked."""

from pathlib import Path

import click

from barn_eval.analysis.leaderboard import RANKINGS, board_rows, make_boards
from barn_eval.analysis.verdict import conclude_ranking
from barn_eval.commands.options import PATH, json_option, notes, say, tell
from barn_eval.commands.tables import rich_table
from barn_eval.pages.report.leaderboard import board_table, write_boards


@click.command("leaderboard")
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option(
    "--by",
    type=click.Choice(tuple(RANKINGS)),
    help="What is ranked by [default: the protocol's metric].",
)
@click.option(
    "--out",
    type=PATH,
    multiple=True,
    help="File ending in .md or .html, repeatable [default: printed].",
)
@click.option("--worlds", default="all", help="Only these, such as 0-49.")
@json_option
def command(
    folders: tuple[Path, ...],
    by: str | None,
    out: tuple[Path, ...],
    worlds: str,
    as_json: bool,
) -> None:
    """Rank the planners of FOLDERS of experiments.

    Planners that cannot be told apart share a rank. Each protocol and set of worlds has a board of its own.
    """
    with notes.status("ranking"):
        boards = make_boards(folders, by or "", worlds)
    told = [conclude_ranking(board.ranking, board.measure) for board in boards]
    if as_json or not out:
        shown: list[object] = []
        for said, one in zip(told, boards, strict=True):
            shown += [*filter(None, said), *one.notes, rich_table(board_table(one))]
        tell(
            as_json,
            {"verdicts": list(map(str, told)), "places": board_rows(boards)},
            *shown,
        )
    for path in out:
        write_boards(boards, path)
        say(path)
