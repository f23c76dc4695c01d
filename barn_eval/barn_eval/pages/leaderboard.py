"""A leaderboard as Markdown and as an HTML page."""

from collections.abc import Callable, Sequence
from pathlib import Path

from barn_eval.analysis.leaderboard import Board, Place
from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.sources import BAGS
from barn_eval.analysis.text_table import counted, one_line
from barn_eval.pages.page import render, write_page
from barn_worlds.errors import ConfigError

_BESIDE = ("success", "traversal_time_s", "normalised_time_s_per_m")
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
        lines += [f"## {_escaped(board.title)}", "", _about(board), ""]
        lines += ["| " + " | ".join(row) + " |" for row in rows]
        lines.append("")
    return "\n".join(lines)


def page(boards: Sequence[Board]) -> str:
    """Return the boards as an HTML page."""
    shown = [
        (board, _about(board), _columns(board), [(place, _cells(board, place)) for place in board.places])
        for board in boards
    ]
    return render("leaderboard.html", boards=shown)


def _columns(board: Board) -> list[str]:
    beside = (MEASURES[key].heading for key in _BESIDE if key != board.measure.key)
    return ["rank", "planner", board.measure.heading, *beside, *_TRACE]


def _cells(board: Board, place: Place, escape: Callable[[str], str] = str) -> list[str]:
    """Return a place as texts; ranks that are shared have a sign of equality in front.

    escape: what to do to texts that come from files.
    """
    summary = place.summary
    measures = [board.measure, *(MEASURES[key] for key in _BESIDE if key != board.measure.key)]
    return [
        f"={place.rank}" if place.tied else str(place.rank),
        escape(place.entry.label),
        *(measure.text(summary[measure.key]) for measure in measures),
        f"{counted(summary.trials, 'trial')} in {counted(summary.worlds, 'world')}",
        escape(str(place.entry.source.path)),
        place.configuration,
        f"{place.bags} in {BAGS}/" if place.bags else "none kept",
    ]


def _about(board: Board) -> str:
    if len(board.places) == 1:
        return f"There is one planner only. Ranked by {board.measure.title}, with its 95 % interval."
    return (
        f"Ranked by {board.measure.title}, with 95 % intervals. Planners that share a rank (=) cannot be told"
        " apart: the interval of their paired difference, over the same worlds and seeds, includes zero."
    )


def _escaped(text: str) -> str:
    """Return a text in which nothing is Markdown or HTML."""
    plain = one_line(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    for character in "\\|*_`[]#":
        plain = plain.replace(character, "\\" + character)
    return plain
