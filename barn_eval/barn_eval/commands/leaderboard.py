"""`barn leaderboard`: rank the planners of many runs."""

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
    help="Measure to rank by [default: the protocol's ranking measure].",
)
@path_option(
    "--out",
    multiple=True,
    help="File (.md or .html) to write instead of printing; repeatable.",
)
@click.option(
    "--worlds", default="all", help="Use only trials in these worlds, such as 0-49."
)
@click.option(
    "--convention",
    type=click.Choice(tuple(CONVENTIONS)),
    help="Rank trials of physical robots by the rules of this event, without statistical tests.",
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

    Planners share a rank if they do not differ significantly. The command prints a
    board for each protocol and each set of worlds.
    """
    if convention is not None:
        if by or out or worlds != "all":
            raise click.UsageError(
                "--convention cannot be used with --by, --out or --worlds"
            )
        rules = CONVENTIONS[convention]
        places = rank_by_convention(folders, rules)
        table = convention_table(places, convention)
        content = {"convention": as_dict(rules), "places": list(map(as_dict, places))}
        print_output(as_json, content, rich_table(table))
        return
    with notes.status("ranking"):
        boards = make_boards(folders, by or "", worlds)
    # With --out, boards go to the files and not to the terminal as well.
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
