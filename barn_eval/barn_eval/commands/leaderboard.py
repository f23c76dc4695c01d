"""`barn leaderboard`: the planners of many runs, ranked."""

from pathlib import Path

import click

from barn_eval.analysis.leaderboard import RANKINGS, board_rows, make_boards
from barn_eval.analysis.verdict import conclude_ranking
from barn_eval.commands.options import (
    folders_argument,
    json_option,
    notes,
    path_option,
    print_notes,
    print_output,
)
from barn_eval.commands.tables import rich_table
from barn_eval.pages.report.leaderboard import board_table, write_boards


@click.command("leaderboard")
@folders_argument
@click.option(
    "--by",
    type=click.Choice(tuple(RANKINGS)),
    help="What is ranked by [default: the protocol's metric].",
)
@path_option(
    "--out",
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
    """Rank the planners of FOLDERS of runs.

    Planners that cannot be told apart share a rank. Each protocol and set of worlds has
    a board of its own.
    """
    with notes.status("ranking"):
        boards = make_boards(folders, by or "", worlds)
    # With --out, a table is for the file and not for the terminal as well.
    if as_json or not out:
        conclusions = []
        renderables: list[object] = []
        for board in boards:
            conclusion = conclude_ranking(board.ranking, board.measure)
            conclusions.append(str(conclusion))
            renderables += filter(None, conclusion)
            renderables += board.notes
            renderables.append(rich_table(board_table(board)))
        content = {"verdicts": conclusions, "places": board_rows(boards)}
        print_output(as_json, content, *renderables)
    for path in out:
        write_boards(boards, path)
        print_notes(path)
