"""What the difficulty model is trained on, from experiments and tables of published times."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from barn_eval.analysis.published import read_published
from barn_eval.analysis.sources import read_source
from barn_metrics.model.training import Trials, joined
from barn_worlds.base.errors import ConfigError
from barn_worlds.worlds.dataset import Dataset, open_dataset
from barn_worlds.worlds.world import World


def read_samples(sources: Sequence[Path], planner: str = "", dataset: str = "") -> tuple[Mapping[int, World], Trials]:
    """Return worlds and trials of all sources as `read_trials` reads them, of one planner if it is named."""
    parts = [read_trials(source, dataset) for source in sources]
    worlds, trials = parts[0] if len(parts) == 1 else joined(parts)
    return worlds, trials.of(planner) if planner else trials


def read_trials(source: Path, dataset: str = "") -> tuple[dict[int, World], Trials]:
    """Return worlds by number and the trials in them of an experiment's folder or a table of published times.

    dataset: where the worlds are, if not where the experiment names them or beside the table. BarnError in one line for
    what cannot be read, or for other worlds.
    """
    if source.suffix == ".csv" and not source.is_dir():
        return _of_published(source, open_dataset(dataset or source.resolve().parent))
    if source.is_file():
        raise ConfigError(f"{source}: must be a folder of results or a table of published times (.csv)")
    found = read_source(source)
    worlds = open_dataset(dataset or str(found.configuration.get("dataset")))
    known = {(world := worlds.load(index)).checksum: (index, world) for index in worlds.indices}
    lost = next((one.world for one in found.results if one.world_checksum not in known), None)
    if lost is not None:
        raise ConfigError(
            f"{source}: world {lost} of its trials is none of {worlds.name}; name the data set they ran in"
        )
    trials = Trials(
        np.array([known[one.world_checksum][0] for one in found.results], np.int64),
        tuple(one.planner for one in found.results),
        np.array([one.scores.normalised_time_s_per_m for one in found.results]),
        np.array([one.scores.success for one in found.results], np.bool_),
    )
    return _common(known.values(), trials)


def _of_published(source: Path, dataset: Dataset) -> tuple[dict[int, World], Trials]:
    published = read_published(source)
    first = next(iter(published.values()))
    worlds = {number: dataset.load(number) for number in sorted(first.lengths_m)}
    other = first.other_length((number, world.path_length_m) for number, world in worlds.items())
    if other is not None:
        raise ConfigError(
            f"{source}: path of world {other} has {first.lengths_m[other]:.3f} m, "
            f"{worlds[other].path_length_m:.3f} m in {dataset.name}"
        )
    trials = Trials(
        np.concatenate([one.worlds for one in published.values()]),
        tuple(planner for planner, one in published.items() for _ in one.worlds),
        np.concatenate([one.normalised_s_per_m for one in published.values()]),
        ~np.concatenate([one.failed for one in published.values()]),
    )
    return _common(worlds.items(), trials)


def _common(worlds: Iterable[tuple[int, World]], trials: Trials) -> tuple[dict[int, World], Trials]:
    """Return the worlds that every planner was tried in, ascending, and the trials there."""
    if not trials.world_numbers:
        raise ConfigError(f"no world has trials of all of {', '.join(trials.planner_names)}")
    known = dict(worlds)
    return {number: known[number] for number in trials.world_numbers}, trials.only(trials.world_numbers)
