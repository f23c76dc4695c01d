"""A leaderboard as Markdown and as an HTML page."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from barn_eval.analysis.leaderboard import Board, Place
from barn_eval.analysis.measures import MEASURES, Measure
from barn_eval.analysis.text_table import TextTable, counted, one_line
from barn_eval.analysis.verdict import verdict
from barn_eval.bags import BAGS
from barn_eval.pages.template import render, write_page
from barn_worlds.base.errors import ConfigError

_BESIDE = ("success", "traversal_time_s", "normalised_time_s_per_m")
_TIME = "normalised_time_s_per_m"  # contact costs nothing by it, so that it is shown what there was
_TRACE = ("trials", "folder", "configuration", "bags")


def write_boards(boards: Sequence[Board], path: Path) -> None:
    """Write the boards to a file as its ending says, .md or .html; ConfigError for another."""
    if path.suffix not in (".md", ".html"):
        raise ConfigError(f"out {str(path)!r}: must end in .md or .html")
    write_page(path, markdown(boards) if path.suffix == ".md" else page(boards))


def markdown(boards: Sequence[Board]) -> str:
    """Return the boards as Markdown; texts from files are text in it."""
    lines = ["# Leaderboard", ""]
    for board in boards:
        columns = _columns(board)
        rows = [columns, ["---" for _ in columns], *(_cells(board, place, _escaped) for place in board.places)]
        lines += [f"## {_escaped(board.title)}", ""]
        named = replace(board.ranking, names=tuple(map(_escaped, board.ranking.names)))
        texts = (verdict(named, board.measure), *map(_escaped, board.notes), _about(board))
        lines += [line for text in texts for line in (text, "")]
        lines += ["| " + " | ".join(row) + " |" for row in rows]
        lines.append("")
    return "\n".join(lines)


def board_table(board: Board) -> TextTable:
    """Return a board as a table for the terminal."""
    rows = tuple(tuple(_cells(board, place)) for place in board.places)
    return TextTable("leaderboard", board.title, tuple(_columns(board)), rows, texts=2, caption=_about(board))


def page(boards: Sequence[Board]) -> str:
    """Return the boards as an HTML page."""
    shown = [
        (
            board,
            verdict(board.ranking, board.measure),
            _about(board),
            _columns(board),
            [(place, _cells(board, place)) for place in board.places],
        )
        for board in boards
    ]
    return render("leaderboard.html", boards=shown)


def _columns(board: Board) -> list[str]:
    return ["rank", "planner", *(measure.heading for measure in _measures(board)), "clearly better than", *_TRACE]


def _measures(board: Board) -> list[Measure]:
    """Return what is ranked by, and what is shown beside it."""
    beside = [MEASURES[key] for key in _BESIDE if key != board.measure.key]
    return [board.measure, *([MEASURES["contact_s"]] if board.measure.key == _TIME else []), *beside]


def _cells(board: Board, place: Place, escape: Callable[[str], str] = str) -> list[str]:
    """Return a place as texts; ranks that are shared have a sign of equality in front.

    escape: what to do to texts that come from files.
    """
    summary, below = place.summary, len(board.places) - board.places.index(place) - 1
    better_than = "all below" if 0 < len(place.better_than) == below else ", ".join(place.better_than)
    return [
        f"={place.rank}" if place.tied else str(place.rank),
        escape(place.entry.label),
        *(measure.text(summary[measure.key]) for measure in _measures(board)),
        escape(better_than) or "-",
        f"{counted(summary.trials, 'trial')} in {counted(summary.worlds, 'world')}",
        escape(str(place.entry.source.path)),
        place.configuration,
        f"{place.bags} in {BAGS}/" if place.bags else "none kept",
    ]


def _about(board: Board) -> str:
    about = f"Ranked by {board.measure.title}, with 95 % intervals."
    if len(board.places) == 1:
        return about
    return (
        f"{about} Planners share a rank (=) unless all above are clearly better than all below: by a test over whole"
        " worlds, at 5 % after Holm for all pairs."
    )


def _escaped(text: str) -> str:
    """Return a text in which nothing is Markdown or HTML."""
    plain = one_line(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    for character in "\\|*_`[]#":
        plain = plain.replace(character, "\\" + character)
    return plain
