"""Write warnings about results that are compared."""

from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path

import numpy as np

from barn_eval.analysis.entries import Entry, board_class, computing_of
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import Source, group_by_planner
from barn_eval.results.commands import count_equal_commands
from barn_eval.results.row_table import column, join, row_keys, systems, take
from barn_eval.results.run_file import (
    CLAIMED,
    SUBMISSION_FILE,
    read_commit,
    shorten_commit,
)
from barn_eval.trials.result import MAX_MISSED_SHARE, Rows
from barn_worlds.base.errors import list_names

# Values that drives with equal commands share.
_DRIVE_PATHS = ("world_checksum", "simulator_seed", "scores.duration_s")


def find_mixture(entries: Sequence[Entry]) -> Iterator[str]:
    """Yield a sentence each if compared entries differ in class or in commits."""
    classes = {entry.label: board_class(entry) for entry in entries}
    if len(set(classes.values())) > 1:
        texts = []
        for label, shared in classes.items():
            words = filter(None, (shared.speed_text, shared.computing))
            texts.append(f"{label} {', '.join(words)}")
        yield f"Compared across classes that boards rank separately: {'; '.join(texts)}."

    folders: dict[str, Path] = {}
    for entry in entries:
        for session in entry.source.sessions:
            folders.setdefault(read_commit(session), entry.source.path)
    if len(folders) > 1:
        texts = [f"{shorten_commit(name)} in {path}" for name, path in folders.items()]
        yield f"Commits differ: {', '.join(texts)}."


def list_notes(entries: Sequence[Entry]) -> list[str]:
    """Return all warnings on entries that are compared."""
    notes = list(find_mixture(entries))
    parts: dict[Source, list[Rows]] = {}
    for entry in entries:
        parts.setdefault(entry.source, []).append(entry.results)
    for source, groups in parts.items():
        notes += notes_on(source, join(groups))
    notes += _find_equal_planners(entries)
    # One folder may have been read twice.
    return list(dict.fromkeys(notes))


def _find_equal_planners(entries: Sequence[Entry]) -> Iterator[str]:
    """Yield a sentence for each pair of entries with equal commands in some trials.

    They may be copies, which would make other differences less significant.
    """
    # Drives with equal commands take equally long, so the large files of commands are
    # only opened for such suspects.
    labels: dict[Hashable, str] = {}
    suspects = set()
    for entry in entries:
        has_driven = column(entry.results, "measures.driven_m") > 0.0
        for key in row_keys(take(entry.results, has_driven), _DRIVE_PATHS):
            if labels.setdefault(key, entry.label) != entry.label:
                suspects.add(key)

    trials = []
    for entry in entries:
        commands = entry.source.commands
        trial_ids = column(entry.results, "trial_id")
        keys = row_keys(entry.results, _DRIVE_PATHS)
        for trial_id, key in zip(trial_ids, keys, strict=True):
            if key in suspects and trial_id in commands:
                trials.append((key, entry.label, commands[trial_id]))
    for pair, count in count_equal_commands(trials).items():
        yield f"{' and '.join(pair)} have equal commands in {count} trials."


def notes_on(source: Source, results: Rows) -> list[str]:
    """Return warnings on one folder's results, such as missing trials or late commands.

    Args:
        source: The folder.
        results: Some or all of its results.
    """
    notes = []
    trials = len(source.results)
    if source.planned and source.planned > trials:
        notes.append(f"{source.path} is partial: {trials} of {source.planned} trials")
    checksums = set(column(results, "world_checksum"))
    copies = len(set(column(results, "world"))) - len(checksums)
    # Trials in copies of a world are no independent evidence.
    if copies > 0 and "" not in checksums:
        notes.append(f"{copies} worlds in {source.path} are copies of others")
    notes += _describe_observations(source.path, results)
    notes.append("; ".join(_find_disturbances(source.path, results)))
    for planner in group_by_planner(results):
        if planner in source.commanded_mps:
            notes.append(source.describe_commanded(planner))
    notes.append(assumption_text(source.path, results))
    if (source.path / SUBMISSION_FILE).exists():
        notes.append(f"{source.path} only claims {', '.join(CLAIMED)}.")
    return list(filter(None, notes))


def _describe_observations(path: Path, results: Rows) -> Iterator[str]:
    """Yield a sentence per system that was observed, and one on unknown contacts."""
    for system in systems(results):
        yield f"{path}: trials of {system} were observed, not driven again"
    contacts = column(results, "measures.contacts").astype(np.float64)
    unknown = np.count_nonzero(np.isnan(contacts))
    if unknown:
        yield (
            f"{path}: contacts of {unknown} of {len(results)} trials are unknown, because"
            " nothing reported them, so a success may have touched an obstacle"
        )


def _find_disturbances(path: Path, results: Rows) -> Iterator[str]:
    """Yield a clause on trials with late commands, and one on repeated attempts, if any."""
    # Over ROS, a busy machine delays commands like a slow planner, and scores cannot tell
    # which it was.
    missed_shares = column(results, "wall_clock.missed_share")
    late = np.count_nonzero(missed_shares > MAX_MISSED_SHARE)
    if late:
        yield (
            f"{late} of {len(results)} trials in {path} are marked: more than "
            f"{MAX_MISSED_SHARE:.0%} of their control periods had no command in time, "
            "so their scores depend on the machine as well as on the planner"
        )

    repeated = take(results, column(results, "wall_clock.attempts") > 1)
    if repeated:
        names = list_names(
            f"{result.trial_id}: {result.wall_clock.retry_note}" for result in repeated
        )
        yield (
            f"{len(repeated)} of {len(results)} trials in {path} took more than one "
            f"attempt: {names}"
        )


def assumption_text(path: Path, results: Rows) -> str:
    """Return a text that lists planners whose scores assume a faster computer, or "".

    Args:
        path: Folder of the results.
        results: Results of any planners.
    """
    notes = []
    for planner, rows in group_by_planner(results).items():
        computing = computing_of(rows)
        if computing.is_too_slow:
            notes.append(f"{spelling(planner)} in {path}: {computing.text}")
    return "; ".join(notes)
