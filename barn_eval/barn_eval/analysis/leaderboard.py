"""Planners of many campaigns in one order, with intervals, in which those that cannot be told apart share a rank."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from barn_eval.analysis.compare import compare
from barn_eval.analysis.measures import MEASURES, Measure
from barn_eval.analysis.sources import Entry, Source, read_entries, told_apart
from barn_eval.analysis.summary import Summary, summarise
from barn_eval.analysis.text_table import counted
from barn_worlds.errors import BarnError, ConfigError, suggest

# What planners may be ranked by: the name of the option, and the key of its measure.
RANKINGS = {
    "challenge": "challenge",
    "challenge_2022": "challenge_2022",
    "success": "success",
    "time": "normalised_time_s_per_m",
}


@dataclass(frozen=True)
class Place:
    """A place on the board.

    tied: whether others share the rank. configuration: its checksum. bags: how many are kept.
    """

    rank: int
    tied: bool
    entry: Entry
    summary: Summary
    configuration: str
    bags: int


@dataclass(frozen=True)
class Board:
    """The planners of one protocol and set of worlds, which alone can be ranked against each other, by a measure."""

    title: str
    measure: Measure
    places: tuple[Place, ...]


def leaderboard(paths: Sequence[Path], ranking: str = "challenge") -> list[Board]:
    """Return a board for each protocol and set of worlds; BarnError in one line for what cannot be read.

    Planners are ordered by the mean of what is ranked by. One shares the rank of the one above if the interval of their
    paired difference includes zero; so it does with all of that rank, or it begins a new one.
    """
    if ranking not in RANKINGS:
        raise ConfigError(f"unknown ranking {ranking!r}{suggest(ranking, RANKINGS)}")
    groups: dict[tuple[str, str], list[Entry]] = {}
    for entry in read_entries(paths):
        groups.setdefault(_kind(entry), []).append(entry)
    measure = MEASURES[RANKINGS[ranking]]
    ordered = sorted(groups.items(), key=_size)
    return [_board(told_apart(entries), protocol, measure) for (protocol, _), entries in ordered]


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


def _board(entries: Sequence[Entry], protocol: str, measure: Measure) -> Board:
    summaries = {entry.label: summarise(entry.results) for entry in entries}
    sign = -1.0 if measure.better == "larger" else 1.0
    ordered = sorted(entries, key=lambda entry: (sign * summaries[entry.label][measure.key].estimate, entry.label))
    ranks = _ranks(ordered, measure)
    places = tuple(
        Place(
            rank,
            ranks.count(rank) > 1,
            entry,
            summaries[entry.label],
            configuration_hash(entry.source),
            sum(entry.source.bag(result.trial_id).exists() for result in entry.results),
        )
        for rank, entry in zip(ranks, ordered, strict=True)
    )
    results = entries[0].results
    worlds = counted(summaries[entries[0].label].worlds, "world")
    dataset = ", ".join(sorted({result.dataset for result in results}))
    seeds = ", ".join(map(str, sorted({result.campaign_seed for result in results})))
    return Board(f"{protocol} protocol, {worlds} of {dataset}, seed {seeds}", measure, places)


def _ranks(ordered: Sequence[Entry], measure: Measure) -> list[int]:
    """Return the rank of each entry, ties sharing the first of theirs."""
    ranks: list[int] = []
    leader = 0
    for place, entry in enumerate(ordered):
        tied = place > 0 and all(_tied(ordered[other], entry, measure) for other in range(leader, place))
        if not tied:
            leader = place
        ranks.append(leader + 1)
    return ranks


def _tied(a: Entry, b: Entry, measure: Measure) -> bool:
    """Tell whether the interval of the paired difference includes zero, or cannot be given."""
    try:
        found = compare(a.results, b.results, a.label, b.label, (measure.key,))
    except BarnError as error:
        raise ConfigError(f"{a.label} and {b.label} cannot be ranked against each other: {error}") from None
    return not found.row(measure.key).paired.difference.excludes(0.0)
