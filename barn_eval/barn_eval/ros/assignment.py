"""What the evaluator does under supervision: handed over as a file, since it is more than parameters can hold."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from barn_eval.experiments.experiment import Experiment
from barn_eval.experiments.rows import write_whole
from barn_eval.experiments.store import Store
from barn_eval.trials.spec import TrialSpec
from barn_worlds.config import as_dict, from_dict
from barn_worlds.text_files import read_json


@dataclass(frozen=True)
class Assignment:
    """Trials of one planner, by name, and where their bags and pictures go."""

    experiment: Experiment
    planner: str
    trials: tuple[str, ...]
    worlds: tuple[int, ...]
    out: str
    pictures: bool

    @classmethod
    def of(cls, experiment: Experiment, trials: Sequence[TrialSpec], store: Store) -> Assignment:
        """Return the assignment of an experiment's trials, all of one planner."""
        return cls(
            experiment,
            trials[0].planner,
            tuple(spec.trial_id for spec in trials),
            tuple(dict.fromkeys(spec.index for spec in trials)),
            str(store.folder),
            store.pictures,
        )

    @classmethod
    def read(cls, path: Path) -> Assignment:
        """Return what a file says; ConfigError if it is none."""
        return from_dict(cls, read_json(path), str(path))

    def write(self, path: Path) -> None:
        """Write the file; StoreError if it cannot be written."""
        write_whole(path, json.dumps(as_dict(self)).encode())

    @property
    def store(self) -> Store:
        """Where bags and pictures go."""
        return Store(Path(self.out), self.experiment.bags, self.pictures)

    def specs(self) -> list[TrialSpec]:
        """Return the trials; WorldError if a world cannot be read."""
        alone = tuple(one for one in self.experiment.planners if one.name == self.planner)
        made = replace(self.experiment, planners=alone).trials(self.worlds)
        return [spec for spec in made if spec.trial_id in set(self.trials)]
