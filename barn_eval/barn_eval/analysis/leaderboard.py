"""Planners of many campaigns, or settings of a sweep, in one order with intervals; ties share a rank."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from barn_eval.analysis.measures import MEASURES, SCORED, Measure, metric_of
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import (
    Entry,
    Source,
    compute_way,
    labelled,
    read_entries,
    require_same_task,
)
from barn_eval.analysis.summary import Summary, summarise
from barn_eval.analysis.text_table import TextTable, counted, joined
from barn_eval.analysis.verdict import Ranking, cautions, rank_results
from barn_eval.running.setting_folders import (
    LATENCY,
    format_setting_value,
    parse_folder_name,
)
from barn_eval.trials.result import TrialResult
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.datasets.dataset import select_worlds

# What planners may be ranked by: the name of the option, and the key of its measure.
RANKINGS = {
    key: key for key in ("challenge", "challenge_2022", "efficiency", "success")
}
RANKINGS |= {"time": "normalised_time_s_per_m"}


@dataclass(frozen=True)
class Place:
    """A place on the board.

    tied: whether others share the rank. better_than: labels of those that it is clearly better than, which are all
    below where it has them all. configuration: its checksum. bags: how many are kept.
    """

    rank: int
    tied: bool
    better_than: tuple[str, ...]
    entry: Entry
    summary: Summary
    configuration: str
    bags: int


@dataclass(frozen=True)
class Board:
    """The planners that can be ranked together, by a measure: of one protocol, worlds, class of speed caps, computing.

    ranking: with the tests of all pairs. notes: what to be careful about.
    """

    title: str
    measure: Measure
    places: tuple[Place, ...]
    ranking: Ranking
    notes: tuple[str, ...]


def leaderboard(
    paths: Sequence[Path], ranking: str = "", worlds: str = "all"
) -> list[Board]:
    """Return a board for each protocol, set of worlds, class of speed caps and way of computing, of worlds as "0-49".

    Entries with trials of the same worlds and seeds stand on one board, which is of the trials that all of them have.
    Raises BarnError in one line for what cannot be read, and for two tasks under the name of one protocol.

    Planners are ordered by the mean of what is ranked by, without `ranking` the metric of the protocol. Those whose
    paired difference is not clear, after Holm for all pairs of the board, share a rank.
    """
    if ranking and ranking not in RANKINGS:
        raise ConfigError(f"unknown ranking {ranking!r}{suggest(ranking, RANKINGS)}")
    groups: dict[tuple[str, float, str], list[Entry]] = {}
    every = read_entries(paths)
    chosen = set(
        select_worlds(worlds, (one.world for entry in every for one in entry.results))
    )
    for entry in every:
        if own := tuple(one for one in entry.results if one.world in chosen):
            groups.setdefault(_kind(entry), []).append(replace(entry, results=own))
    for protocol in {
        kind[0] for kind in groups
    }:  # also where boards are apart for another reason
        for entries in _in_common(
            [one for kind in groups if kind[0] == protocol for one in groups[kind]]
        ):
            require_same_task([entry.source.path for entry in entries])
    made = []
    for _, several in sorted(groups.items()):
        for entries in _in_common(several):
            measure = (
                MEASURES[RANKINGS[ranking]]
                if ranking
                else metric_of(entries[0].results)
            )
            made.append(board(labelled(entries), measure))
    return made


def board_rows(boards: Sequence[Board]) -> list[dict[str, Any]]:
    """Return a row per place: board, rank, tied, planner, better_than, and the columns of the planner's summary."""
    return [
        {
            "board": board.title,
            "rank": one.rank,
            "tied": one.tied,
            "planner": one.entry.label,
        }
        | {"better_than": list(one.better_than)}
        | one.summary.columns()
        for board in boards
        for one in board.places
    ]


def board(entries: Sequence[Entry], measure: Measure) -> Board:
    """Return the board of at least one entry of the same task; ConfigError if two cannot be ranked together."""
    found = rank_results({entry.label: entry.results for entry in entries}, measure)
    places = []
    for place, entry in enumerate(
        sorted(entries, key=lambda one: found.names.index(one.label))
    ):
        better_than = (
            name
            for other, name in enumerate(found.names)
            if other > place and found.clear(place, other)
        )
        places.append(
            Place(
                found.ranks[place],
                found.ranks.count(found.ranks[place]) > 1,
                tuple(better_than),
                entry,
                summarise(entry.results, (*SCORED, "contact_s")),
                configuration_hash(entry.source, entry.planner),
                sum(
                    entry.source.bag(result.trial_id).exists()
                    for result in entry.results
                ),
            )
        )
    notes = cautions(found.worlds, dict.fromkeys(entry.source for entry in entries))
    trials = {
        entry: sum(one.planner == entry.planner for one in entry.source.results)
        for entry in entries
    }
    more = [entry.label for entry in entries if len(entry.results) < trials[entry]]
    if more:
        notes = (
            f"Ranked on the {counted(found.worlds, 'world')} that all have; {joined(more)} have more.",
            *notes,
        )
    return Board(_title(entries[0]), measure, tuple(places), found, notes)


def configuration_hash(source: Source, planner: str) -> str:
    """Return a short name of the configuration that a planner was run with: equal ones have equal names."""
    listed = source.configuration.get("planners", ())
    own = [
        one
        for one in listed
        if (one.get("name") if isinstance(one, Mapping) else one) == planner
    ]
    text = json.dumps({**source.configuration, "planners": own}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _in_common(entries: Sequence[Entry]) -> list[list[Entry]]:
    """Return entries by board, those with most trials first, with the trials that all of a board have."""
    boards: list[tuple[set[tuple[Any, ...]], list[Entry]]] = []
    for entry in sorted(entries, key=lambda one: -len(one.results)):
        own = {_trial(one) for one in entry.results}
        place = next(
            (at for at, (shared, _) in enumerate(boards) if shared & own), len(boards)
        )
        shared, members = boards[place] if place < len(boards) else (own, [])
        boards[place : place + 1] = [(shared & own, [*members, entry])]
    return [
        [
            replace(
                one, results=tuple(row for row in one.results if _trial(row) in shared)
            )
            for one in members
        ]
        for shared, members in boards
    ]


def _trial(result: TrialResult) -> tuple[Any, ...]:
    """Return what is equal for trials that can be compared."""
    return result.world, result.world_checksum, result.campaign_seed, result.repetition


def _kind(entry: Entry) -> tuple[str, float, str]:
    """Return what an entry shares with a board; ConfigError if its trials follow several protocols."""
    protocols = {result.protocol for result in entry.results}
    if len(protocols) > 1:
        raise ConfigError(
            f"{entry.source.path}: {entry.planner} has trials of several protocols"
        )
    way = compute_way(entry.results)
    return (
        protocols.pop(),
        speed_class_mps(entry),
        "too slow" if way.startswith("its score") else way,
    )


def speed_class_mps(entry: Entry) -> float:
    """Return the upper end of the class of an entry's speed cap: each class is twice the one before, 0.5 m/s is one.

    0 for rows of versions that had no caps.
    """
    cap_mps = max(result.speed_cap_mps or 0.0 for result in entry.results)
    return 0.5 * 2.0 ** math.ceil(math.log2(cap_mps / 0.5) - 1e-9) if cap_mps else 0.0


def _title(entry: Entry) -> str:
    results, robot = (
        entry.results,
        f"robot {entry.source.robot}, " if entry.source.robot else "",
    )
    worlds = counted(len({result.world for result in results}), "world")
    dataset = ", ".join(sorted({result.dataset for result in results}))
    seeds = ", ".join(map(str, sorted({result.campaign_seed for result in results})))
    fastest = speed_class_mps(entry)
    caps = f"up to {fastest:g} m/s, " if fastest else ""
    way = compute_way(results)
    way = "computing on a faster computer" if way.startswith("its score") else way
    shared = ", ".join(filter(None, (f"{caps}{robot}task {results[0].task}", way)))
    return (
        f"{results[0].protocol} protocol, {worlds} of {dataset}, seed {seeds}, {shared}"
    )


_BESIDE = ("success", "normalised_time_s_per_m")


def parameters_of(entries: Sequence[Entry]) -> list[str]:
    """Return the parameters by which all entries are settings of one sweep, of a planner or over the delay; or none."""
    found, planners = (
        [parse_folder_name(entry.source.path) for entry in entries],
        {entry.planner for entry in entries},
    )
    same = all(one.keys() == found[0].keys() for one in found) and (
        len(planners) == 1 or len(found[0]) == 1
    )
    return list(found[0]) if same and len(found) > len(planners) else []


def sweep_board(folder: Path) -> Board:
    """Return the settings of a sweep as one board, whatever their speed caps; BarnError as `read_entries`."""
    entries = read_entries([folder])
    return board(entries, metric_of(entries[0].results))


def sweep_rows(found: Board) -> list[dict[str, Any]]:
    """Return a row per setting, best first: whether it is level with the best, parameters, figures."""
    return [
        {
            "level_with_best": place in found.ranking.leaders,
            "planner": one.entry.planner,
        }
        | parse_folder_name(one.entry.source.path)
        | one.summary.columns()
        | {"folder": str(one.entry.source.path)}
        for place, one in _in_order(found)
    ]


def sweep_table(found: Board) -> TextTable:
    """Return the settings as a table, best first."""
    names = list(parse_folder_name(found.places[0].entry.source.path))
    measures = [
        found.measure,
        *(MEASURES[key] for key in _BESIDE if key != found.measure.key),
    ]
    rows = []
    for place, one in _in_order(found):
        texts = map(
            format_setting_value, parse_folder_name(one.entry.source.path).values()
        )
        level = (
            "best"
            if place == 0
            else "level"
            if place in found.ranking.leaders
            else "worse"
        )
        figures = (measure.text(one.summary[measure.key]) for measure in measures)
        rows.append((spelling(one.entry.planner), *texts, level, *figures))
    columns = (
        "planner",
        *names,
        "against the best",
        *(one.heading for one in measures),
    )
    about = (
        f"By {found.measure.title}, with 95 % intervals; all pairs of settings tested, corrected after Holm. Level: not"
        " clearly worse than the best."
    )
    return TextTable("sweep", found.title, columns, tuple(rows), 2 + len(names), about)


def _in_order(found: Board) -> list[tuple[int, Place]]:
    """Return places with their numbers, best first, or planner by planner over the delay."""
    places = list(enumerate(found.places))
    if list(parse_folder_name(found.places[0].entry.source.path)) != [LATENCY]:
        return places
    return sorted(
        places,
        key=lambda one: (
            one[1].entry.planner,
            parse_folder_name(one[1].entry.source.path)[LATENCY],
        ),
    )
