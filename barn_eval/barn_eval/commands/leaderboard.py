"""`barn leaderboard`: the planners of many runs, ranked."""

from pathlib import Path

import click

from barn_eval.analysis.conventions import (
    CONVENTIONS,
    convention_table,
    rank_by_convention,
)
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
from barn_worlds.base.config import as_dict


@click.command("leaderboard")
@folders_argument
@click.option(
    "--by",
    type=click.Choice(tuple(RANKINGS)),
    help="Measure to rank by [default: the protocol's metric].",
)
@path_option(
    "--out",
    multiple=True,
    help="File ending in .md or .html, repeatable [default: printed].",
)
@click.option(
    "--worlds", default="all", help="Rank by these worlds only, such as 0-49."
)
@click.option(
    "--convention",
    type=click.Choice(tuple(CONVENTIONS)),
    help="Rank physical trials as this event counts them, without tests.",
)
@json_option
def command(
    folders: tuple[Path, ...],
    by: str | None,
    out: tuple[Path, ...],
    worlds: str,
    convention: str | None,
    as_json: bool,
) -> None:
    """Rank the planners of FOLDERS of runs.

    Planners whose difference is not significant share a rank. Each protocol and set of worlds has
    a board of its own.
    """
    if convention is not None:
        if by or out or worlds != "all":
            raise click.UsageError("--convention takes no --by, --out or --worlds")
        rules = CONVENTIONS[convention]
        places = rank_by_convention(folders, rules)
        table = convention_table(places, convention)
        content = {"convention": as_dict(rules), "places": list(map(as_dict, places))}
        print_output(as_json, content, rich_table(table))
        return
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
