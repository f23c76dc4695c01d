"""A leaderboard as a table, as Markdown and as an HTML page."""

import html
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from barn_eval.analysis.leaderboard import Board
from barn_eval.analysis.measures import MEASURES, SHOWN
from barn_eval.analysis.text_table import TextTable, count_noun, one_line
from barn_eval.analysis.verdict import conclude_ranking
from barn_eval.pages.template import render, write_page
from barn_eval.results.bags import BAGS
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.files import markdown_table

_TIME = "normalised_time_s_per_m"
_ORIGIN_COLUMNS = ("trials", "folder", "configuration", "bags")
# The columns between rank and planner, and "clearly better than".
_FIGURES = slice(2, -1 - len(_ORIGIN_COLUMNS))


def write_boards(boards: Sequence[Board], path: Path) -> None:
    """Write all boards into one file, .md or .html; ConfigError for other endings.

    Args:
        boards: One per protocol, class and set of worlds, from `make_boards`.
        path: A file ending in .md or .html.

    Raises:
        ConfigError: The file has another ending.
    """
    if path.suffix not in (".md", ".html"):
        raise ConfigError(f"out {str(path)!r}: must end in .md or .html")
    write_page(path, markdown(boards) if path.suffix == ".md" else page(boards))


def markdown(boards: Sequence[Board]) -> str:
    """Return boards with conclusions and notes as Markdown text; nothing is written.

    Text from results files is escaped, so that it is no markup.
    """
    parts = ["# Leaderboard"]
    for board in boards:
        table = board_table(board)
        rows = []
        for row in table.rows:
            cells = [_escape_markdown(cell) for cell in row]
            # The brackets of intervals are no links.
            cells[_FIGURES] = row[_FIGURES]
            rows.append(cells)

        names = tuple(_escape_markdown(name) for name in board.ranking.names)
        ranking = replace(board.ranking, names=names)
        conclusion = conclude_ranking(ranking, board.measure)
        parts.append(f"## {_escape_markdown(table.title)}")
        parts += [text for text in conclusion if text]
        parts += [_escape_markdown(note) for note in board.notes]
        parts += [table.caption, markdown_table(table.columns, rows)]
    return "\n\n".join(parts) + "\n"


def page(boards: Sequence[Board]) -> str:
    """Return boards with conclusions as the text of an HTML page; nothing is written."""
    content = [
        (board, conclude_ranking(board.ranking, board.measure), board_table(board))
        for board in boards
    ]
    return render("leaderboard.html", boards=content)


def board_table(board: Board) -> TextTable:
    """Return a board as a table, a row per planner, the best first.

    A rank that is shared begins with an equals sign.
    """
    keys = [board.measure.key]
    if board.measure.key == _TIME:
        # Contact costs nothing in time, so the table shows it.
        keys.append("contact_s")
    keys += [key for key in SHOWN["boards"] if key != board.measure.key]
    measures = [MEASURES[key] for key in keys]

    rows = []
    for number, place in enumerate(board.places, 1):
        summary = place.summary
        below = len(board.places) - number
        # Long lists of names would hide the usual case.
        better_than = ", ".join(place.better_than) or "-"
        if 0 < len(place.better_than) == below:
            better_than = "all below"
        trials = count_noun(summary.trials, "trial")
        worlds = count_noun(summary.worlds, "world")
        rows.append(
            (
                f"={place.rank}" if place.tied else str(place.rank),
                place.entry.label,
                *(measure.text(summary[measure.key]) for measure in measures),
                better_than,
                f"{trials} in {worlds}",
                str(place.entry.source.path),
                place.configuration,
                f"{place.bags} in {BAGS}/" if place.bags else "none kept",
            )
        )

    headings = [measure.heading for measure in measures]
    columns = ("rank", "planner", *headings, "clearly better than", *_ORIGIN_COLUMNS)
    caption = f"Ranked by {board.measure.title}, with 95% intervals."
    if len(rows) > 1:
        caption += (
            " Planners share a rank (=) unless all above are clearly better than all "
            "below: by a test over whole worlds, at 5% after Holm for all pairs."
        )
    return TextTable("leaderboard", board.title, columns, rows, 2, caption)


def _escape_markdown(text: str) -> str:
    """Return text on one line, with Markdown and HTML escaped."""
    # Names come from folders of strangers, and many viewers of Markdown render HTML.
    escaped = html.escape(one_line(text), quote=False)
    return re.sub(r"([\\*_`\[\]#])", r"\\\1", escaped)
