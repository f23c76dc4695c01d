"""Planners of results folders, with labels, colors and the class of their board."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from barn_eval.analysis.planners import assign_colors, spelling
from barn_eval.analysis.sources import (
    Source,
    group_by_planner,
    planner_choices,
    read_source,
)
from barn_eval.results.row_table import column, take
from barn_eval.running.setting_folders import expand_sweeps, parse_folder_name
from barn_eval.trials.result import COMPUTE_MODE_LABELS, Rows, describe_computer
from barn_worlds.base.arrays import Bools
from barn_worlds.base.errors import ConfigError, find_duplicates

# The slowest class of speed caps; each class is twice as fast as the one before.
_SLOWEST_CLASS_MPS = 0.5
_SLOW_QUANTILE = 0.9


@dataclass(frozen=True, eq=False)
class Entry:
    """The trials of one planner in one folder, with a label and a color."""

    label: str
    color: str
    source: Source
    planner: str
    results: Rows

    @property
    def setting(self) -> dict[str, float | str]:
        """Swept parameter values from the folder's name; empty for other folders."""
        return parse_folder_name(self.source.path)

    def select(self, mask: Bools) -> "Entry":
        """Return a copy of the entry with the results where a mask (n,) is true."""
        return replace(self, results=take(self.results, mask))


class BoardClass(NamedTuple):
    """What planners must share, besides their task, to be ranked together."""

    protocol: str
    system: str
    speed_class_mps: float
    computing: str

    @property
    def speed_text(self) -> str:
        """The speed class in words; empty for rows of versions without caps."""
        if not self.speed_class_mps:
            return ""
        return f"up to {self.speed_class_mps:g} m/s"

    def difference(self, other: "BoardClass") -> str:
        """Return this class's first value that differs from another's, in words, or ""."""
        if self.protocol != other.protocol:
            return f"{self.protocol} protocol"
        if self.system != other.system:
            return self.system or "the suite's simulator"
        if self.speed_class_mps != other.speed_class_mps:
            return self.speed_text or "unknown speed"
        if self.computing != other.computing:
            return self.computing or "unknown computing"
        return ""


def board_class(entry: Entry) -> BoardClass:
    """Return the class in which an entry is ranked; ConfigError for several protocols.

    Raises:
        ConfigError: If its trials have several protocols.
    """
    protocols = set(column(entry.results, "protocol").tolist())
    if len(protocols) > 1:
        raise ConfigError(
            f"{entry.source.path}: {entry.planner} has trials of several protocols"
        )
    return BoardClass(
        protocol=protocols.pop(),
        system=entry.source.system.label,
        speed_class_mps=_speed_class_mps(entry.results),
        computing=computing_of(entry.results).class_name,
    )


def _speed_class_mps(results: Rows) -> float:
    """Return the upper end [m/s] of one planner's speed class, 0 if no cap is known.

    The classes end at 0.5 m/s times a power of two.
    """
    # The highest cap counts, because a planner may be faster in some worlds.
    caps_mps = column(results, "speed_cap_mps").astype(np.float64)
    cap_mps = float(np.nan_to_num(caps_mps).max())
    if not cap_mps:
        return 0.0
    # A cap at the end of a class belongs to that class, despite rounding.
    doublings = math.ceil(math.log2(cap_mps / _SLOWEST_CLASS_MPS) - 1e-9)
    return _SLOWEST_CLASS_MPS * 2.0**doublings


@dataclass(frozen=True)
class Computing:
    """How trials of a planner charge its computing."""

    modes: tuple[str, ...]
    """Labels of the compute modes; none for rows of versions without them."""

    computer: float
    """Speed of the computer that the scores assume; 1 is the reference computer.

    A tenth of the trials with free or declared computing need a faster one. 0 if there
    are no such trials.
    """

    @property
    def is_too_slow(self) -> bool:
        """Whether scores assume a computer faster than the reference computer."""
        return self.computer > 1.0

    @property
    def text(self) -> str:
        """The faster computer that scores assume, in words, or else the compute modes.

        Empty if neither is known. A computer no faster than the reference is not named.
        """
        return describe_computer(self.computer) or " and ".join(self.modes)

    @property
    def class_name(self) -> str:
        """Class of a board: a faster computer, or the compute modes in words."""
        if self.is_too_slow:
            return "computing on a faster computer"
        return self.text


def computing_of(results: Rows) -> Computing:
    """Return the compute modes, and the computer speed that 90% of the rows do with."""
    # Rows of one planner may differ if a folder was resumed with another option.
    names = set(column(results, "compute").tolist()) - {""}
    modes = {COMPUTE_MODE_LABELS[name] for name in names}
    computers = column(results, "wall_clock.computer").astype(np.float64)
    computers = computers[~np.isnan(computers)]
    computer = 0.0
    if len(computers):
        # Not the highest, because single trials may have run on a busy machine.
        computer = float(np.quantile(computers, _SLOW_QUANTILE))
    return Computing(tuple(sorted(modes)), computer)


def read_entries(paths: Sequence[Path]) -> list[Entry]:
    """Return a labeled entry per planner and folder; ConfigError if a folder repeats.

    The folder of a sweep stands for the folders of its settings.

    Raises:
        ConfigError: If a folder is named twice, holds no run or mixes tasks.
        BarnError: If a file cannot be read.
    """
    folders = expand_sweeps(paths)
    # The same trials twice would look like twice the evidence.
    for path in find_duplicates(path.resolve() for path in folders):
        raise ConfigError(f"{path}: is named twice")
    return entries_of([read_source(path) for path in folders])


def entries_of(sources: Sequence[Source]) -> list[Entry]:
    """Return an entry per planner of each folder, with distinct labels and colors."""
    entries = []
    for source in sources:
        for planner, results in group_by_planner(source.comparable_results).items():
            entries.append(Entry("", "", source, planner, results))
    return label_entries(entries)


def label_entries(entries: Sequence[Entry]) -> list[Entry]:
    """Return copies with colors and distinct labels: planner and setting, folder or path.

    Entries of one planner are labeled by the settings in which they differ, or else by
    their folders.
    """
    by_setting = []
    by_name = []
    by_path = []
    for entry in entries:
        name = spelling(entry.planner)
        same_planner = [other for other in entries if other.planner == entry.planner]
        by_setting.append(name + _distinct_settings(entry, same_planner))
        folder = f" ({entry.source.path.resolve().name})"
        by_name.append(name + folder if len(same_planner) > 1 else name)
        by_path.append(f"{name} ({entry.source.path})")

    # Paths are distinct in any case; the shorter labels are tried first.
    for labels in (by_setting, by_name, by_path):
        if len(set(labels)) == len(entries):
            break
    colors = assign_colors([entry.planner for entry in entries])
    return [
        replace(entry, label=label, color=color)
        for entry, label, color in zip(entries, labels, colors, strict=True)
    ]


def _distinct_settings(entry: Entry, same_planner: Sequence[Entry]) -> str:
    """Return " (KEY=VALUE, ...)" of settings that differ among a planner's entries."""
    settings = _planner_settings(entry)
    other_settings = [_planner_settings(other) for other in same_planner]
    texts = []
    for key, value in settings.items():
        # Settings that all entries share do not distinguish them.
        if any(other.get(key) != value for other in other_settings):
            texts.append(f"{key.rpartition('.')[2]}={value}")
    return f" ({', '.join(texts)})" if texts else ""


def _planner_settings(entry: Entry) -> dict[str, Any]:
    """Return preset, max_speed_mps and overrides of an entry's planner by key.

    Anything missing or malformed in run.json is left out.
    """
    choices = planner_choices(entry.source.configuration, entry.planner)
    choice: dict[str, Any] = next(iter(choices), {})
    settings = {
        key: choice[key] for key in ("preset", "max_speed_mps") if choice.get(key)
    }
    overrides = choice.get("overrides")
    if isinstance(overrides, dict):
        settings |= overrides
    return settings
