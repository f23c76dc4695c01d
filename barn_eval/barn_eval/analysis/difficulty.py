"""Worlds from easy to difficult, and bands of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from barn_eval.analysis.sources import Entry
from barn_eval.analysis.summary import Summary, summarise
from barn_eval.trials.result import Rows, TrialResult

IN_BANDS = ("success", "traversal_time_s", "normalised_time_s_per_m", "challenge")
MOST_BANDS = 4
_FEWEST_WORLDS = 3  # of a band


@dataclass(frozen=True)
class Difficulty:
    """Worlds from easy to difficult.

    worlds: their numbers; mean_s_per_m: counted time per metre, averaged over all trials of the world, each entry
    weighing the same (the paper's measure, Sec. IV-B).
    left_out: worlds that some entry has no trial of.
    """

    worlds: tuple[int, ...]
    mean_s_per_m: tuple[float, ...]
    left_out: int


@dataclass(frozen=True)
class Band:
    """Neighbouring worlds of the order, and what each entry did there, in the order of entries."""

    name: str
    worlds: tuple[int, ...]
    limits_s_per_m: tuple[float, float]
    summaries: tuple[Summary, ...]


def by_world(results: Rows) -> dict[int, list[TrialResult]]:
    """Return results by world, worlds ascending."""
    ordered = sorted(results, key=lambda one: (one.world, one.repetition))
    return {
        world: list(group) for world, group in groupby(ordered, lambda one: one.world)
    }


def difficulty(entries: Sequence[Entry]) -> Difficulty:
    """Return the order of the worlds that all entries have trials of; of all worlds, if there is none such."""
    groups = [by_world(entry.results) for entry in entries]
    known = set().union(*groups)
    shared = set.intersection(*map(set, groups)) or known
    rows = []
    for world in shared:
        there = (group[world] for group in groups if world in group)
        times = [
            np.array([one.scores.normalised_time_s_per_m for one in trials])
            for trials in there
        ]
        rows.append((float(np.mean([part.mean() for part in times])), world))
    rows.sort()
    means, worlds = zip(*rows, strict=True)
    return Difficulty(worlds, means, len(known) - len(shared))


def bands(entries: Sequence[Entry], order: Difficulty) -> list[Band]:
    """Return up to four bands of equally many worlds; none where there are too few worlds for two."""
    count = min(MOST_BANDS, len(order.worlds) // _FEWEST_WORLDS)
    if count < 2:
        return []
    groups = [by_world(entry.results) for entry in entries]
    names = [
        "easiest",
        *(f"{number} of {count}" for number in range(2, count)),
        "hardest",
    ]
    made = []
    for name, part in zip(
        names, np.array_split(np.arange(len(order.worlds)), count), strict=True
    ):
        worlds = tuple(order.worlds[index] for index in part)
        limits = order.mean_s_per_m[part[0]], order.mean_s_per_m[part[-1]]
        results = (
            [one for world in worlds for one in group.get(world, [])]
            for group in groups
        )
        made.append(
            Band(
                name, worlds, limits, tuple(summarise(one, IN_BANDS) for one in results)
            )
        )
    return made
