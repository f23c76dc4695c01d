"""Worlds and trials of results folders, as the difficulty model learns from them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from barn_eval.analysis.sources import read_source
from barn_metrics.model.trials import Trials, require_worlds
from barn_worlds.base.errors import ConfigError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.worlds.world import World

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
