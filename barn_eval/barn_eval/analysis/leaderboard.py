"""Rank the planners of many runs, or the settings of a sweep; ties share a rank."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from barn_eval.analysis.entries import (
    BoardClass,
    Entry,
    board_class,
    label_entries,
    read_entries,
)
from barn_eval.analysis.measures import MEASURES, SCORED, Measure, ranking_measure
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import Source, planner_choices, require_same_task
from barn_eval.analysis.summary import Summary, summarize
from barn_eval.analysis.text_table import TextTable, count_noun, join_names
from barn_eval.analysis.verdict import Ranking, list_cautions, rank_results
from barn_eval.results.bags import BAGS
from barn_eval.results.row_table import column, row_keys
from barn_eval.running.setting_folders import LATENCY, format_setting_value
from barn_eval.trials.identity import fingerprint
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.datasets.dataset import select_worlds

# Measures that can rank planners: value of the option, and key of the measure.
RANKINGS = {
    "challenge": "challenge",
    "challenge_2022": "challenge_2022",
    "efficiency": "efficiency",
    "success": "success",
    "time": "normalised_time_s_per_m",
}
# A run may lack a tenth of a board's trials; the board then ranks the rest of them.
_LEAST_SHARE = 0.9
_SWEEP_MEASURES = ("success", "normalised_time_s_per_m")


# Values that are equal for trials that can be compared.
TrialKey = tuple[int, str, int, int]
_KEY_PATHS = ("world", "world_checksum", "campaign_seed", "repetition")


@dataclass(frozen=True)
class Place:
    """A place on a board."""

    rank: int

    tied: bool
    """Whether another place has the same rank."""

    better_than: Sequence[str]
    """Labels of the planners below that it is significantly better than."""

    entry: Entry
    summary: Summary

    configuration: str
    """Checksum of the configuration."""

    bags: int
    """Number of bags that the run kept."""


@dataclass(frozen=True)
class Board:
    """Planners that can be ranked together, by a measure."""

    title: str
    measure: Measure
    places: Sequence[Place]

    ranking: Ranking
    """The tests of all pairs."""

    notes: Sequence[str]
    """Cautions for readers."""


@dataclass
class TrialGroup:
    """Entries that share trials, and the trials that all of them have."""

    entries: list[Entry]
    common_trials: set[TrialKey]

    def accepts(self, trials: set[TrialKey], least_share: float) -> bool:
        """Tell whether enough common trials stay if an entry with `trials` joins.

        Args:
            trials: Trials of another entry.
            least_share: Share of the largest entry's trials that must stay; at least one
                trial must.
        """
        shared = len(self.common_trials & trials)
        return shared >= max(1, least_share * len(self.entries[0].results))

    def common_entries(self) -> list[Entry]:
        """Return copies of the entries, restricted to the trials that all of them have."""
        entries = []
        for entry in self.entries:
            keys = row_keys(entry.results, _KEY_PATHS)
            is_common = [key in self.common_trials for key in keys]
            entries.append(entry.select(np.array(is_common, np.bool_)))
        return entries


def make_boards(
    paths: Sequence[Path], ranking: str = "", worlds: str = "all"
) -> list[Board]:
    """Rank planners of folders, a board per comparable group; ConfigError if tasks mix.

    There is a board for each protocol, system, speed class, compute mode and set of
    worlds. Planners are in the order of their means. Planners share a rank if their
    difference, adjusted by Holm for all pairs of the board, is not significant.

    Args:
        paths: Results folders, or folders of sweeps.
        ranking: A key of `RANKINGS`. Default: the ranking measure of the protocol.
        worlds: Worlds that count, such as "0-49".

    Raises:
        ConfigError: If the ranking is unknown, or two tasks name the same protocol.
        BarnError: If a folder cannot be read.
    """
    if ranking and ranking not in RANKINGS:
        raise ConfigError(f"unknown ranking {ranking!r}{suggest(ranking, RANKINGS)}")
    entries = read_entries(paths)
    world_numbers: set[int] = set()
    for entry in entries:
        world_numbers.update(column(entry.results, "world").tolist())
    selected_worlds = select_worlds(worlds, world_numbers)

    classes: dict[BoardClass, list[Entry]] = {}
    for entry in entries:
        is_selected = np.isin(column(entry.results, "world"), selected_worlds)
        selection = entry.select(is_selected)
        if selection.results:
            classes.setdefault(board_class(entry), []).append(selection)
    _require_one_task_per_protocol(classes)

    boards: list[Board] = []
    # Sorted, so that the order of boards does not depend on that of the folders.
    for _, class_entries in sorted(classes.items()):
        for group in group_by_common_trials(class_entries):
            # A group has one protocol, so any of its results names the measure.
            measure = ranking_measure(group.entries[0].results)
            if ranking:
                measure = MEASURES[RANKINGS[ranking]]
            board = make_board(label_entries(group.common_entries()), measure)
            if worlds != "all":
                text = f"Only trials in the selected worlds are ranked: {worlds}."
                board = replace(board, notes=[text, *board.notes])
            boards.append(board)
    return [
        replace(board, notes=[*board.notes, *_name_other_boards(board, boards)])
        for board in boards
    ]


def _name_other_boards(board: Board, boards: Sequence[Board]) -> Iterator[str]:
    """Yield a sentence that names planners of other boards, and why, if there are any."""
    classes = board_class(board.places[0].entry)
    planners = []
    for other in boards:
        if other is board:
            continue
        labels = join_names([place.entry.label for place in other.places])
        difference = board_class(other.places[0].entry).difference(classes)
        planners.append(f"{labels} ({difference or 'other trials'})")
    if planners:
        yield f"On other boards: {'; '.join(planners)}."


def _require_one_task_per_protocol(classes: Mapping[BoardClass, list[Entry]]) -> None:
    """Raise ConfigError if entries with common trials and one protocol differ in task.

    Entries of all classes are compared: a protocol's name means one set of rules.
    """
    # Otherwise a changed protocol under an old name would look like a comparable board.
    entries_by_rules: dict[tuple[str, str], list[Entry]] = {}
    for shared, entries in classes.items():
        rules = (shared.protocol, shared.system)
        entries_by_rules.setdefault(rules, []).extend(entries)
    for entries in entries_by_rules.values():
        for group in group_by_common_trials(entries, least_share=0.0):
            require_same_task([entry.source.path for entry in group.entries])


def board_rows(boards: Sequence[Board]) -> list[dict[str, Any]]:
    """Return a dict per place of all boards: board, rank, planner, summary columns."""
    rows: list[dict[str, Any]] = []
    for board in boards:
        for place in board.places:
            rows.append(
                {
                    "board": board.title,
                    "rank": place.rank,
                    "tied": place.tied,
                    "planner": place.entry.label,
                    "better_than": list(place.better_than),
                    **place.summary.columns(),
                }
            )
    return rows


def make_board(entries: Sequence[Entry], measure: Measure) -> Board:
    """Rank entries by a measure, with cautions and bags; ConfigError if tasks differ.

    Args:
        entries: At least one, with distinct labels.
        measure: Measure to rank by.

    Raises:
        ConfigError: If two entries cannot be ranked together.
    """
    results = {entry.label: entry.results for entry in entries}
    ranking = rank_results(results, measure)
    entry_by_label = {entry.label: entry for entry in entries}
    # Computed once, because it compares all pairs.
    ranks = ranking.ranks
    places = []
    for position, label in enumerate(ranking.names):
        entry = entry_by_label[label]
        better_than = []
        for below in range(position + 1, len(ranking.names)):
            if ranking.is_clear(position, below):
                better_than.append(ranking.names[below])
        bags = {path.name for path in (entry.source.path / BAGS).glob("*")}
        places.append(
            Place(
                rank=ranks[position],
                tied=ranks.count(ranks[position]) > 1,
                better_than=better_than,
                entry=entry,
                summary=summarize(entry.results, (*SCORED, "contact_s")),
                # It shows readers whether two boards rank the same settings.
                configuration=configuration_hash(entry.source, entry.planner),
                bags=len(bags.intersection(column(entry.results, "trial_id"))),
            )
        )

    notes = list_cautions(ranking.worlds, entries)
    larger = []
    for entry in entries:
        planners = column(entry.source.results, "planner")
        if len(entry.results) < np.count_nonzero(planners == entry.planner):
            larger.append(entry.label)
    if larger:
        worlds = count_noun(ranking.worlds, "world")
        notes.insert(
            0,
            f"Ranked by the {worlds} that all planners have;"
            f" {join_names(larger)} have more.",
        )
    return Board(_title(entries), measure, places, ranking, notes)


def configuration_hash(source: Source, planner: str) -> str:
    """Return a hash (12 hex digits) of a run's configuration with only this planner.

    Args:
        source: The results folder.
        planner: Name of the planner in it.
    """
    choices = planner_choices(source.configuration, planner)
    # Other planners of the run do not affect this one.
    return fingerprint({**source.configuration, "planners": choices})


def group_by_common_trials(
    entries: Iterable[Entry], least_share: float = _LEAST_SHARE
) -> list[TrialGroup]:
    """Group entries by common trials; each joins the first group that keeps enough.

    Args:
        entries: Results of one planner each, under one protocol.
        least_share: Share of a group's largest entry that must stay common to all.

    Returns:
        Groups in the order of their largest entries. An entry joins the first group that
        keeps enough trials with it, so that a small run does not shrink a board.
    """
    groups: list[TrialGroup] = []
    # Largest first, so that a group's common trials start as wide as possible.
    for entry in sorted(entries, key=lambda entry: -len(entry.results)):
        trials = set(row_keys(entry.results, _KEY_PATHS))
        for group in groups:
            if group.accepts(trials, least_share):
                group.entries.append(entry)
                group.common_trials &= trials
                break
        else:
            groups.append(TrialGroup([entry], trials))
    return groups


def _title(entries: Sequence[Entry]) -> str:
    """Return a board's title: protocol, worlds, seed, classes, robot and task."""
    first = entries[0]
    results = first.results
    worlds = count_noun(len(set(column(results, "world"))), "world")
    datasets = ", ".join(sorted(set(column(results, "dataset"))))
    seeds = ", ".join(map(str, sorted(set(column(results, "campaign_seed")))))
    parts = [
        f"{results[0].protocol} protocol",
        f"{worlds} of {datasets}",
        f"seed {seeds}",
    ]
    # The settings of a sweep may be of several classes.
    classes = sorted({board_class(entry) for entry in entries})
    parts += dict.fromkeys(item.speed_text for item in classes if item.speed_text)
    if first.source.robot:
        parts.append(f"robot {first.source.robot}")
    if first.source.system.is_observed:
        parts.append(f"{first.source.system.label}, observed, not driven again")
    parts.append(f"task {results[0].task}")
    parts += dict.fromkeys(item.computing for item in classes if item.computing)
    return ", ".join(parts)


def sweep_parameters(entries: Sequence[Entry]) -> list[str]:
    """Return the names of parameters that entries sweep, or [] if they are no sweep.

    A sweep varies parameters of one planner, or one parameter, the delay, of several.
    """
    planners = {entry.planner for entry in entries}
    parameters = list(entries[0].setting)
    is_one_sweep = all(entry.setting.keys() == set(parameters) for entry in entries)
    # Several planners are swept by the delay alone.
    is_one_question = len(planners) == 1 or len(parameters) == 1
    if is_one_sweep and is_one_question and len(entries) > len(planners):
        return parameters
    return []


def make_sweep_board(folder: Path) -> Board:
    """Read the folder of a sweep; rank its settings on one board by the ranking measure.

    Settings with different speed caps share the board; a note then says so.

    Raises:
        BarnError: As for `read_entries`.
    """
    entries = read_entries([folder])
    return make_board(entries, ranking_measure(entries[0].results))


def sweep_rows(board: Board) -> list[dict[str, Any]]:
    """Return a dict per setting, best first; in a latency study, by planner and delay.

    Keys: level_with_best, planner, each parameter, the summary's columns, folder.
    """
    return [
        {
            "level_with_best": position in board.ranking.leaders,
            "planner": place.entry.planner,
            **place.entry.setting,
            **place.summary.columns(),
            "folder": str(place.entry.source.path),
        }
        for position, place in _order_settings(board)
    ]


def sweep_table(board: Board) -> TextTable:
    """Return a sweep as a text table, a setting per row, ordered as `sweep_rows`."""
    # All settings of a sweep have the same parameters.
    parameters = list(board.places[0].entry.setting)
    keys = dict.fromkeys((board.measure.key, *_SWEEP_MEASURES))
    measures = [MEASURES[key] for key in keys]
    rows = []
    for position, place in _order_settings(board):
        level = "worse"
        if position == 0:
            level = "best"
        elif position in board.ranking.leaders:
            level = "level"
        rows.append(
            (
                spelling(place.entry.planner),
                *map(format_setting_value, place.entry.setting.values()),
                level,
                *(measure.text(place.summary[measure.key]) for measure in measures),
            )
        )

    headings = [measure.heading for measure in measures]
    columns = ("planner", *parameters, "against the best", *headings)
    caption = (
        f"Ranked by {board.measure.title}, with 95% intervals. All pairs of settings are"
        " tested, adjusted by Holm. Level: not clearly worse than the best."
    )
    texts = 2 + len(parameters)
    return TextTable("sweep", board.title, columns, rows, texts, caption)


def _order_settings(board: Board) -> list[tuple[int, Place]]:
    """Return (rank position, place) pairs, best first; delays by planner and delay.

    A sweep over the delay is ordered by planner and delay instead.
    """
    # Tests refer to positions in the ranking.
    places = list(enumerate(board.places))
    if list(board.places[0].entry.setting) == [LATENCY]:
        places.sort(key=lambda p: (p[1].entry.planner, p[1].entry.setting[LATENCY]))
    return places
