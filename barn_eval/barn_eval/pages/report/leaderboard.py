"""A leaderboard as a table, as Markdown and as an HTML page."""

import html
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from barn_eval.analysis.leaderboard import Board
from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.text_table import TextTable, count_noun, one_line
from barn_eval.analysis.verdict import conclude_ranking
from barn_eval.pages.template import render, write_page
from barn_eval.results.bags import BAGS
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.text_files import markdown_table

_TIME = "normalised_time_s_per_m"  # contact costs nothing by it, so that it is shown what there was
_BESIDE = ("success", "efficiency", "traversal_time_s", _TIME)
_TRACE = ("trials", "folder", "configuration", "bags")
_FIGURES = slice(2, -1 - len(_TRACE))  # columns


def write_boards(boards: Sequence[Board], path: Path) -> None:
    """Write the boards to a file as its ending says, .md or .html; ConfigError for another."""
    if path.suffix not in (".md", ".html"):
        raise ConfigError(f"out {str(path)!r}: must end in .md or .html")
    write_page(path, markdown(boards) if path.suffix == ".md" else page(boards))


def markdown(boards: Sequence[Board]) -> str:
    """Return the boards as Markdown; texts from files are text in it."""
    parts = ["# Leaderboard"]
    for board in boards:
        table = board_table(board)
        rows = [list(map(_escaped, row)) for row in table.rows]
        for cells, row in zip(rows, table.rows, strict=True):
            cells[_FIGURES] = row[_FIGURES]  # whose brackets are no links
        named = replace(board.ranking, names=tuple(map(_escaped, board.ranking.names)))
        parts += [
            f"## {_escaped(table.title)}",
            *filter(None, conclude_ranking(named, board.measure)),
        ]
        parts += map(_escaped, board.notes)
        parts += [table.caption, markdown_table(table.columns, rows)]
    return "\n\n".join(parts) + "\n"


def page(boards: Sequence[Board]) -> str:
    """Return the boards as an HTML page."""
    shown = [
        (board, conclude_ranking(board.ranking, board.measure), board_table(board))
        for board in boards
    ]
    return render("leaderboard.html", boards=shown)


def board_table(board: Board) -> TextTable:
    """Return a board as a table; ranks that are shared have a sign of equality in front."""
    measures = [
        board.measure,
        *([MEASURES["contact_s"]] if board.measure.key == _TIME else []),
    ]
    measures += [MEASURES[key] for key in _BESIDE if key != board.measure.key]
    rows = []
    for number, place in enumerate(board.places, 1):
        summary, below = place.summary, len(board.places) - number
        better_than = (
            "all below"
            if 0 < len(place.better_than) == below
            else ", ".join(place.better_than)
        )
        trace = (
            f"{count_noun(summary.trials, 'trial')} in {count_noun(summary.worlds, 'world')}",
            str(place.entry.source.path),
            place.configuration,
            f"{place.bags} in {BAGS}/" if place.bags else "none kept",
        )
        figures = (measure.text(summary[measure.key]) for measure in measures)
        rows.append(
            (
                f"{'=' * place.tied}{place.rank}",
                place.entry.label,
                *figures,
                better_than or "-",
                *trace,
            )
        )
    columns = (
        "rank",
        "planner",
        *(measure.heading for measure in measures),
        "clearly better than",
        *_TRACE,
    )
    about = f"Ranked by {board.measure.title}, with 95 % intervals."
    if len(rows) > 1:
        about += (
            " Planners share a rank (=) unless all above are clearly better than all below: by a test over whole"
            " worlds, at 5 % after Holm for all pairs."
        )
    return TextTable(
        "leaderboard", board.title, columns, tuple(rows), texts=2, caption=about
    )


def _escaped(text: str) -> str:
    """Return a text in which nothing is Markdown or HTML."""
    return re.sub(r"([\\*_`\[\]#])", r"\\\1", html.escape(one_line(text), quote=False))
