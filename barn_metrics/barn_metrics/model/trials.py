"""Trials as difficulty models are trained and judged by: which world, which planner, the time per metre."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.errors import ModelError, suggest
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.worlds.world import World

FEWEST_WORLDS = 10
RESERVED_DATASET = (
    "barn_test"  # judges models; nothing is trained on it or chosen by it
)


@dataclass(frozen=True, eq=False)
class Trials:
    """Trials in any order, each array (n,).

    worlds: number of the world; planners: name of the planner; normalised_s_per_m: time as it counts, failures
    included, by the path's arc length (the paper's normalised time, Sec. IV); succeeded: the goal was reached.
    Raises ModelError for arrays of different lengths, or times that are not finite and above zero.
    """

    worlds: Integers
    planners: tuple[str, ...]
    normalised_s_per_m: Floats
    succeeded: Bools

    def __post_init__(self) -> None:
        sizes = {
            len(self.worlds),
            len(self.planners),
            len(self.normalised_s_per_m),
            len(self.succeeded),
        }
        if sizes == {0} or len(sizes) > 1:
            raise ModelError(
                f"trials must be at least one and their columns equally long, got lengths {sorted(sizes)}"
            )
        times = self.normalised_s_per_m
        wrong = np.flatnonzero(~(np.isfinite(times) & (times > 0.0)))
        if len(wrong):
            raise ModelError(
                f"world {self.worlds[wrong[0]]}: time per metre must be above 0, got {times[wrong[0]]}"
            )

    def __len__(self) -> int:
        return len(self.worlds)

    @cached_property
    def planner_names(self) -> tuple[str, ...]:
        """The planners, sorted by name."""
        return tuple(sorted(set(self.planners)))

    @cached_property
    def world_numbers(self) -> tuple[int, ...]:
        """Numbers of the worlds that every planner has trials in, ascending: those whose difficulty is known."""
        return tuple(
            sorted(
                set.intersection(
                    *(set(self.of(name).worlds.tolist()) for name in self.planner_names)
                )
            )
        )

    def of(self, planner: str) -> Trials:
        """Return the trials of one planner; ModelError for one that has none."""
        if planner not in self.planner_names:
            raise ModelError(
                f"no trials of planner {planner!r}{suggest(planner, self.planner_names)}"
            )
        return self._where(np.array([name == planner for name in self.planners]))

    def only(self, worlds: Collection[int]) -> Trials:
        """Return the trials in some of the worlds."""
        return self._where(np.isin(self.worlds, sorted(worlds)))

    def times(self) -> Floats:
        """Return each planner's mean time per metre in each of `world_numbers`, (w, p)."""
        return self._means(self.normalised_s_per_m)

    def failures(self) -> Floats:
        """Return each planner's share of failures in each of `world_numbers`, (w, p)."""
        return 1.0 - self._means(self.succeeded.astype(np.float64))

    def difficulty(self) -> Floats:
        """Return the time in s/m of each of `world_numbers`, (w,): the mean over repetitions, then over planners."""
        mean: Floats = self.times().T.mean(axis=0)
        return mean

    def _means(self, values: Floats) -> Floats:
        names, numbers = np.array(self.planners), np.array(self.world_numbers)
        means = []
        for planner in self.planner_names:
            mine = (names == planner) & np.isin(self.worlds, numbers)
            at = np.searchsorted(numbers, self.worlds[mine])
            means.append(
                np.bincount(at, values[mine], len(numbers))
                / np.bincount(at, minlength=len(numbers))
            )
        return np.stack(means, axis=1)

    def _where(self, kept: Bools) -> Trials:
        planners = tuple(
            name for name, keep in zip(self.planners, kept, strict=True) if keep
        )
        return Trials(
            self.worlds[kept],
            planners,
            self.normalised_s_per_m[kept],
            self.succeeded[kept],
        )


def check_worlds(worlds: Mapping[int, World], numbers: Iterable[int]) -> None:
    """Raise ModelError if there are trials of a world that is not among the worlds."""
    missing = next((number for number in numbers if number not in worlds), None)
    if missing is not None:
        raise ModelError(
            f"there are trials of world {missing}, but not the world itself"
        )


def worlds_with_trials(worlds: Mapping[int, World], trials: Trials) -> list[World]:
    """Return the worlds in the order of the trials' `world_numbers`; ModelError if one is missing or they are few."""
    numbers = trials.world_numbers
    check_worlds(worlds, numbers)
    if (count := len(numbers)) < FEWEST_WORLDS:
        raise ModelError(
            f"a model needs at least {FEWEST_WORLDS} worlds with trials of every planner, got {count}"
        )
    return [worlds[number] for number in numbers]


def find_reserved_world(worlds: Iterable[World]) -> World | None:
    """Return the first world with the obstacles of a world of `RESERVED_DATASET`, None without any."""
    kept_apart = open_dataset(RESERVED_DATASET)
    grids = {
        kept_apart.load(index).grid.tobytes() for index in kept_apart.world_numbers
    }
    return next((world for world in worlds if world.grid.tobytes() in grids), None)


def fold_masks(worlds: int, folds: int, seed: int) -> Bools:
    """Return which worlds (folds, worlds) are trained on in each fold; each world is left out in exactly one."""
    order = np.random.default_rng(seed).permutation(worlds)
    kept = np.ones((folds, worlds), np.bool_)
    for fold, part in enumerate(np.array_split(order, folds)):
        kept[fold, part] = False
    return kept


def join_trials(
    parts: Sequence[tuple[Mapping[int, World], Trials]],
) -> tuple[dict[int, World], Trials]:
    """Return worlds and trials of several campaigns, renumbered, equal worlds as one; ModelError for missing ones."""
    numbers: dict[str, int] = {}
    worlds: dict[int, World] = {}
    renumbered = []
    for mine, trials in parts:
        check_worlds(mine, trials.worlds.tolist())
        new = {
            number: numbers.setdefault(world.checksum, len(numbers))
            for number, world in mine.items()
        }
        worlds |= {new[number]: world for number, world in mine.items()}
        renumbered.append(
            np.array([new[int(number)] for number in trials.worlds], np.int64)
        )
    return worlds, Trials(
        np.concatenate(renumbered),
        tuple(planner for _, one in parts for planner in one.planners),
        np.concatenate([one.normalised_s_per_m for _, one in parts]),
        np.concatenate([one.succeeded for _, one in parts]),
    )
