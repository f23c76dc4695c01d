"""`barn leaderboard`: planners of many experiments, ranked."""

from pathlib import Path

import click

from barn_eval.analysis.leaderboard import RANKINGS, board_rows, leaderboard
from barn_eval.analysis.verdict import verdict
from barn_eval.commands.options import PATH, console, json_option, notes, print_json, say
from barn_eval.commands.tables import rich_table
from barn_eval.pages.report.leaderboard import board_table, write_boards


@click.command("leaderboard")
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option("--by", type=click.Choice(tuple(RANKINGS)), help="What is ranked by [default: the protocol's metric].")
@click.option("--out", type=PATH, multiple=True, help="File ending in .md or .html, repeatable [default: printed].")
@click.option("--worlds", default="all", help="Only these, such as 0-49.")
@json_option
def command(folders: tuple[Path, ...], by: str | None, out: tuple[Path, ...], worlds: str, as_json: bool) -> None:
    """Rank the planners of FOLDERS of experiments.

    Planners that cannot be told apart share a rank. Each protocol and set of worlds has a board of its own.
    """
    with notes.status("ranking"):
        boards = leaderboard(folders, by or "", worlds)
    if as_json:
        verdicts = [str(verdict(board.ranking, board.measure)) for board in boards]
        print_json({"verdicts": verdicts, "places": board_rows(boards)})
    elif not out:
        for board in boards:
            for line in (*filter(None, verdict(board.ranking, board.measure)), *board.notes):
                console.print(line, markup=False, highlight=False)
            console.print(rich_table(board_table(board)))
    for path in out:
        write_boards(boards, path)
        say(path)
