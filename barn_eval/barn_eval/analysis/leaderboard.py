"""Planners of many campaigns in one order, with intervals, in which those that cannot be told apart share a rank."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from barn_eval.analysis.compare import MEASURES, Comparison, compare
from barn_eval.analysis.sources import Entry, Source, read_entries
from barn_eval.analysis.summary import Summary, summarise
from barn_eval.analysis.tables import one_line
from barn_eval.pages.page import render
from barn_metrics.bootstrap import Interval
from barn_worlds.errors import BarnError, ConfigError, suggest

# What a leaderboard may be ranked by: name of an option, measure, whether larger is better.
RANKINGS = {
    "challenge": "challenge metric",
    "challenge_2022": "challenge metric of 2022",
    "success": "success",
    "time": "time per metre as counted",
}


@dataclass(frozen=True)
class Row:
    """A place on the board. tied: whether others share the rank; score: what is ranked by."""

    rank: int
    tied: bool
    entry: Entry
    summary: Summary
    score: Interval
    configuration: str
    bags: int


@dataclass(frozen=True)
class Board:
    """The rows of one protocol and set of worlds, which alone can be ranked against each other."""

    title: str
    ranking: str
    rows: tuple[Row, ...]


def leaderboard(paths: Sequence[Path], ranking: str = "challenge") -> list[Board]:
    """Return a board for each protocol and set of worlds; BarnError in one line for what cannot be read.

    Rows are ordered by the mean of what is ranked by. A row shares the rank of the one above if the interval of their
    paired difference includes zero; so it does with all rows of that rank, or it begins a new one.
    """
    if ranking not in RANKINGS:
        raise ConfigError(f"unknown ranking {ranking!r}{suggest(ranking, RANKINGS)}")
    groups: dict[tuple[str, str], list[Entry]] = {}
    for entry in read_entries(paths):
        groups.setdefault(_kind(entry), []).append(entry)
    return [_board(entries, protocol, ranking) for (protocol, _), entries in sorted(groups.items(), key=_size)]


def markdown(boards: Sequence[Board]) -> str:
    """Return the boards as Markdown; texts from files are text in it."""
    lines = ["# Leaderboard", ""]
    for board in boards:
        lines += [f"## {_escaped(board.title)}", "", _about(board), ""]
        lines += ["| " + " | ".join(map(_escaped, columns(board))) + " |"]
        lines += ["| " + " | ".join("---" for _ in columns(board)) + " |"]
        lines += ["| " + " | ".join(map(_escaped, cells(row))) + " |" for row in board.rows]
        lines.append("")
    return "\n".join(lines)


def page(boards: Sequence[Board]) -> str:
    """Return the boards as an HTML page."""
    shown = [(board, _about(board), columns(board), [(row, cells(row)) for row in board.rows]) for board in boards]
    return render("leaderboard.html", boards=shown)


def columns(board: Board) -> tuple[str, ...]:
    """Return the heads of a board's columns."""
    times = ("success [%]", "time of successes [s]", "time per metre as counted [s/m]")
    return ("rank", "planner", RANKINGS[board.ranking], *times, "trials", "folder", "configuration", "bags")


def cells(row: Row) -> tuple[str, ...]:
    """Return a row as texts; ranks that are shared have a sign of equality in front."""
    summary = row.summary
    return (
        f"={row.rank}" if row.tied else str(row.rank),
        row.entry.label,
        row.score.text(3),
        summary.success_rate.scaled(100.0).text(1),
        summary.success_time_s.text(),
        summary.normalised_time_s_per_m.text(),
        f"{summary.trials} in {summary.worlds} worlds",
        str(row.entry.source.path),
        row.configuration,
        f"{row.bags} in {row.entry.source.path / 'bags'}" if row.bags else "none kept",
    )


def configuration_hash(source: Source) -> str:
    """Return a short name of a configuration: equal ones have equal names."""
    text = json.dumps(source.configuration, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _kind(entry: Entry) -> tuple[str, str]:
    """Return protocol and worlds of an entry; ConfigError if its trials follow several protocols."""
    protocols = {result.protocol for result in entry.results}
    if len(protocols) > 1:
        raise ConfigError(f"{entry.source.path}: {entry.planner} has trials of several protocols")
    worlds = sorted({(result.world, result.world_checksum) for result in entry.results})
    seeds = sorted({(result.campaign_seed, result.repetition) for result in entry.results})
    return protocols.pop(), hashlib.sha256(repr((worlds, seeds)).encode()).hexdigest()


def _size(item: tuple[tuple[str, str], list[Entry]]) -> tuple[str, int, str]:
    (protocol, worlds), entries = item
    return protocol, -len(entries[0].results), worlds


def _board(entries: Sequence[Entry], protocol: str, ranking: str) -> Board:
    summaries = {id(entry): summarise(entry.results) for entry in entries}
    larger = next(one.larger_is_better for one in MEASURES if one.name == RANKINGS[ranking])
    scores = {id(entry): _score(summaries[id(entry)], ranking) for entry in entries}
    sign = -1.0 if larger else 1.0
    ordered = sorted(entries, key=lambda entry: (sign * scores[id(entry)].estimate, entry.label))
    ranks = _ranks(ordered, RANKINGS[ranking])
    rows = tuple(
        Row(
            rank,
            ranks.count(rank) > 1,
            entry,
            summaries[id(entry)],
            scores[id(entry)],
            configuration_hash(entry.source),
            sum(entry.source.bag(result.trial_id).exists() for result in entry.results),
        )
        for rank, entry in zip(ranks, ordered, strict=True)
    )
    first = summaries[id(entries[0])]
    dataset = ", ".join(sorted({result.dataset for result in entries[0].results}))
    seeds = ", ".join(map(str, sorted({result.campaign_seed for result in entries[0].results})))
    return Board(f"{protocol} protocol, {first.worlds} worlds of {dataset}, seed {seeds}", ranking, rows)


def _ranks(ordered: Sequence[Entry], measure: str) -> list[int]:
    """Return the rank of each entry, ties sharing the first of theirs."""
    ranks: list[int] = []
    leader = 0
    for place, entry in enumerate(ordered):
        tied = place > 0 and all(_tied(ordered[other], entry, measure) for other in range(leader, place))
        if not tied:
            leader = place
        ranks.append(leader + 1)
    return ranks


def _tied(a: Entry, b: Entry, measure: str) -> bool:
    """Tell whether the interval of the paired difference includes zero, or cannot be given."""
    found = _compared(a, b)
    row = next(row for row in found.rows if row.measure == measure)
    low, high = row.paired.difference.low, row.paired.difference.high
    return low is None or high is None or low <= 0.0 <= high


def _compared(a: Entry, b: Entry) -> Comparison:
    try:
        return compare(a.results, b.results, a.label, b.label)
    except BarnError as error:
        raise ConfigError(f"{a.label} and {b.label} cannot be ranked against each other: {error}") from None


def _score(summary: Summary, ranking: str) -> Interval:
    return {
        "challenge": summary.challenge,
        "challenge_2022": summary.challenge_2022,
        "success": summary.success_rate,
        "time": summary.normalised_time_s_per_m,
    }[ranking]


def _about(board: Board) -> str:
    if len(board.rows) == 1:
        return f"There is one planner only. Ranked by {RANKINGS[board.ranking]}, with its 95 % interval."
    return (
        f"Ranked by {RANKINGS[board.ranking]}, with 95 % intervals. Planners that share a rank (=) cannot be told"
        " apart: the interval of their paired difference, over the same worlds and seeds, includes zero."
    )


def _escaped(text: str) -> str:
    """Return a text in which nothing is Markdown or HTML."""
    plain = one_line(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    for character in "\\|*_`[]#":
        plain = plain.replace(character, "\\" + character)
    return plain
