"""Trials that train and judge the difficulty model, and where they are read from."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from barn_eval.analysis.sources import read_source
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.errors import ConfigError, ModelError, suggest
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.worlds.world import World

MIN_WORLDS = 10
# No model is trained on these worlds or chosen by them, so they can judge all models.
RESERVED_DATASET = "barn_test"


@dataclass(frozen=True, eq=False)
class Trials:
    """Trials in any order; each array holds one value per trial, (n,).

    Raises:
        ModelError: If the arrays differ in length, or a time is not finite and
            positive.
    """

    # Number of the world.
    worlds: Integers
    # Name of the planner.
    planners: tuple[str, ...]
    # Scored time, failures included, by the length of the path in s/m (paper, Sec. IV).
    normalized_s_per_m: Floats
    # Whether the planner reached the goal.
    succeeded: Bools

    def __post_init__(self) -> None:
        """Raise ModelError unless columns are equally long and times above 0."""
        columns = (self.planners, self.normalized_s_per_m, self.succeeded)
        lengths = {len(self.worlds), *map(len, columns)}
        if lengths == {0} or len(lengths) > 1:
            raise ModelError(
                "trials must be at least one and their columns equally long, "
                f"got lengths {sorted(lengths)}"
            )

        times = self.normalized_s_per_m
        for row in np.flatnonzero(~(np.isfinite(times) & (times > 0.0))):
            raise ModelError(
                f"world {self.worlds[row]}: time per meter must be above 0, "
                f"got {times[row]}"
            )

    def __len__(self) -> int:
        """Return the number of trials."""
        return len(self.worlds)

    @cached_property
    def planner_names(self) -> tuple[str, ...]:
        """The planners, sorted by name."""
        return tuple(sorted(set(self.planners)))

    @cached_property
    def world_numbers(self) -> tuple[int, ...]:
        """Numbers of the worlds in which every planner has trials, ascending.

        The difficulty of the other worlds is unknown.
        """
        worlds_by_planner = (
            set(self.by_planner(name).worlds.tolist()) for name in self.planner_names
        )
        return tuple(sorted(set.intersection(*worlds_by_planner)))

    def by_planner(self, planner: str) -> Trials:
        """Return the trials of one planner by name; ModelError if it has none."""
        if planner not in self.planner_names:
            hint = suggest(planner, self.planner_names)
            raise ModelError(f"no trials of planner {planner!r}{hint}")
        return self._select(np.array([name == planner for name in self.planners]))

    def in_worlds(self, world_numbers: Collection[int]) -> Trials:
        """Return the trials in worlds of these numbers; ModelError if none."""
        return self._select(np.isin(self.worlds, sorted(world_numbers)))

    def difficulty(self) -> Floats:
        """Return the measured difficulty (w,) of each of `world_numbers` in s/m.

        It is the mean over repetitions, then over planners, so that planners with more
        trials weigh no more. Failures are included, with the time that they score.
        """
        mean_times = self.mean_by_world(self.normalized_s_per_m)
        # Along the first axis, NumPy adds planners one by one: the sum's last bit
        # depends on the axis.
        difficulty: Floats = mean_times.T.mean(axis=0)
        return difficulty

    def mean_by_world(self, values: Floats | Bools) -> Floats:
        """Return means (w, p) by `world_numbers` and `planner_names`.

        Args:
            values: One value per trial, (n,); the mean of a mask is a share.
        """
        names = np.array(self.planners)
        world_numbers = np.array(self.world_numbers)
        means = []
        for planner in self.planner_names:
            selected = (names == planner) & np.isin(self.worlds, world_numbers)
            places = np.searchsorted(world_numbers, self.worlds[selected])
            sums = np.bincount(places, values[selected], len(world_numbers))
            means.append(sums / np.bincount(places, minlength=len(world_numbers)))
        return np.stack(means, axis=1)

    def _select(self, selected: Bools) -> Trials:
        """Return the trials where a mask (n,) is True; ModelError if there are none."""
        planners = np.array(self.planners)[selected]
        return Trials(
            self.worlds[selected],
            tuple(planners.tolist()),
            self.normalized_s_per_m[selected],
            self.succeeded[selected],
        )


def worlds_with_trials(worlds: Mapping[int, World], trials: Trials) -> list[World]:
    """Return the worlds with trials of every planner, by ascending number.

    Args:
        worlds: By number; those without trials of every planner are left out.
        trials: Trials in these worlds.

    Raises:
        ModelError: If a world is missing, or fewer than ten have trials of every
            planner.
    """
    world_numbers = trials.world_numbers
    require_worlds(worlds, world_numbers)
    if len(world_numbers) < MIN_WORLDS:
        raise ModelError(
            f"a model needs at least {MIN_WORLDS} worlds with trials of every planner, "
            f"got {len(world_numbers)}"
        )
    return [worlds[number] for number in world_numbers]


def require_worlds(worlds: Mapping[int, World], world_numbers: Iterable[int]) -> None:
    """Raise ModelError at the first number of a world that is not in `worlds`.

    Args:
        worlds: By number, as a data set has them.
        world_numbers: Numbers that trials name.
    """
    for number in world_numbers:
        if number not in worlds:
            raise ModelError(
                f"there are trials of world {number}, but not the world itself"
            )


def find_reserved_world(worlds: Iterable[World]) -> World | None:
    """Return the first world whose grid is in the data set barn_test, or None.

    Grids are compared, not names, so that a copy under another name counts as well.
    """
    reserved = open_dataset(RESERVED_DATASET)
    reserved_grids = {
        reserved.load(number).grid.tobytes() for number in reserved.world_numbers
    }
    return next(
        (world for world in worlds if world.grid.tobytes() in reserved_grids), None
    )


WorldTrials = tuple[Mapping[int, World], Trials]


def load_trials(
    folders: Sequence[Path], planner: str = "", dataset: str = ""
) -> WorldTrials:
    """Return worlds by number and the trials of all folders.

    Args:
        folders: Results folders.
        planner: Take the trials of this planner alone; empty for all.
        dataset: Data set of the worlds, if it is not the one that the results name.

    Raises:
        BarnError: If a folder cannot be read, its worlds are in another data set, or
            the planner has no trials.
    """
    parts = [read_trials(folder, dataset) for folder in folders]
    worlds, trials = parts[0] if len(parts) == 1 else join_trials(parts)
    return worlds, trials.by_planner(planner) if planner else trials


def read_trials(folder: Path, dataset: str = "") -> WorldTrials:
    """Return the worlds of a results folder that every planner drove, and their trials.

    Worlds are identified by checksum, so their numbers in the data set may have
    changed.

    Args:
        folder: Results folder.
        dataset: Data set of the worlds, if it is not the one that the results name.

    Raises:
        BarnError: If the folder cannot be read or its worlds are in another data set.
    """
    source = read_source(folder)
    opened_dataset = open_dataset(dataset or str(source.configuration.get("dataset")))
    all_worlds = {
        number: opened_dataset.load(number) for number in opened_dataset.world_numbers
    }
    numbers = {world.checksum: number for number, world in all_worlds.items()}

    for result in source.results:
        if result.world_checksum not in numbers:
            raise ConfigError(
                f"{folder}: world {result.world} of its trials is none of "
                f"{opened_dataset.name}; name the data set they ran in"
            )

    results = source.results
    trials = Trials(
        np.array([numbers[result.world_checksum] for result in results], np.int64),
        tuple(result.planner for result in results),
        np.array([result.scores.normalised_time_s_per_m for result in results]),
        np.array([result.scores.success for result in results], np.bool_),
    )
    if not trials.world_numbers:
        raise ConfigError(
            f"no world has trials of all of {', '.join(trials.planner_names)}"
        )

    worlds = {number: all_worlds[number] for number in trials.world_numbers}
    return worlds, trials.in_worlds(trials.world_numbers)


def join_trials(parts: Sequence[WorldTrials]) -> tuple[dict[int, World], Trials]:
    """Return worlds and trials of several runs as one, numbered anew.

    Args:
        parts: Worlds by number and trials of each run. Worlds with the same checksum
            become one world.

    Raises:
        ModelError: If a run has trials of a world that it does not have.
    """
    new_numbers: dict[str, int] = {}
    worlds: dict[int, World] = {}
    trial_worlds = []
    for part_worlds, trials in parts:
        require_worlds(part_worlds, trials.worlds.tolist())
        renumbering = {}
        for number, world in part_worlds.items():
            new_number = new_numbers.setdefault(world.checksum, len(new_numbers))
            renumbering[number] = new_number
            worlds[new_number] = world
        trial_worlds.append([renumbering[number] for number in trials.worlds.tolist()])

    all_trials = [trials for _, trials in parts]
    planners = [name for trials in all_trials for name in trials.planners]
    return worlds, Trials(
        np.concatenate(trial_worlds),
        tuple(planners),
        np.concatenate([trials.normalized_s_per_m for trials in all_trials]),
        np.concatenate([trials.succeeded for trials in all_trials]),
    )
