"""A run: which trials are made, and the folder that their results go to.

OUT/run.json                 the plan, with versions and machine
OUT/results.jsonl            one line per finished trial, flushed to disk before the next begins
OUT/tracks.jsonl             one line per trial as well: what the robot did, thinned out
OUT/bags/TRIAL_ID/           rosbag2 directories
OUT/pictures/TRIAL_ID.png
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from barn_eval.experiments.provenance import provenance
from barn_eval.experiments.ros_config import RosSetup
from barn_eval.experiments.rows import ResultRows, write_whole
from barn_eval.trials.protocol import PAPER, Protocol
from barn_eval.trials.result import TrialResult
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_planners.registry import planner_config
from barn_sim.config import SimulatorConfig
from barn_worlds.config import Checked, as_dict, from_dict, quantity
from barn_worlds.dataset import open_dataset
from barn_worlds.errors import ConfigError
from barn_worlds.spec import select_worlds
from barn_worlds.text_files import read_json

SCHEMA_VERSION = 1
MODES = ("direct", "ros")
# Names of planners become names of files.
_LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,59}")


@dataclass(frozen=True)
class RunPlan(Checked):
    """Which trials are made; `overrides` are planner parameters by dotted name."""

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    worlds: str = quantity("all", "which of its worlds, such as 0, 0-49 or 0:300:6")
    planner: str = quantity("dwa", "name of the planner")
    preset: str = quantity("", "preset of its parameters, empty for that of the protocol")
    overrides: dict[str, Any] = field(default_factory=dict)
    protocol: Protocol = field(default_factory=lambda: PAPER)
    simulator: SimulatorConfig = field(default_factory=lambda: simulator_config(PAPER))
    mode: str = quantity("direct", "one process or ROS nodes", choices=MODES)
    seed: int = quantity(0, "seed of the run", minimum=0, maximum=2**62)
    repetitions: int = quantity(1, "trials per world", minimum=1, maximum=99)
    planner_command: str = quantity("", "of mode ros: what is started in place of our own planner node")
    ros: RosSetup = field(default_factory=RosSetup)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.planner_command and self.mode != "ros":
            raise ConfigError("planner_command needs mode ros")

    def check(self) -> int:
        """Return the number of trials, once data set, worlds, planner and parameters are known to be usable.

        Raises BarnError in one line for what is not, so that a run fails before it begins.
        """
        dataset = open_dataset(self.dataset)
        worlds = select_worlds(self.worlds, dataset.indices)
        for index in worlds:
            self.protocol.course(dataset.load(index))
        if not self.planner_command:
            planner_config(self.planner, self.preset or self.protocol.planner_preset, self.overrides)
        elif not _LABEL.fullmatch(self.planner):
            raise ConfigError(f"planner {self.planner!r}: a name must be 1 to 60 letters, digits, '_', '-' or '.'")
        return len(worlds) * self.repetitions

    def trials(self) -> Iterator[TrialSpec]:
        """Yield the trials, world by world; WorldError if a world cannot be read."""
        dataset = open_dataset(self.dataset)
        for index in select_worlds(self.worlds, dataset.indices):
            world = dataset.load(index)
            for repetition in range(self.repetitions):
                yield TrialSpec(
                    dataset=dataset.name,
                    index=index,
                    world=world,
                    planner=self.planner,
                    preset=self.preset or self.protocol.planner_preset,
                    overrides=self.overrides,
                    protocol=self.protocol,
                    simulator=self.simulator,
                    campaign_seed=self.seed,
                    repetition=repetition,
                )


class RunFolder:
    """The folder of a run; one process writes to it at a time."""

    def __init__(self, path: Path, plan: RunPlan) -> None:
        self.path = path
        self.plan = plan

    @classmethod
    def create(cls, path: Path, plan: RunPlan, *, overwrite: bool = False) -> RunFolder:
        """Make the folder of a run, or return to the one of an equal run.

        overwrite: remove an earlier run there. Raises ConfigError if the folder holds another run, or anything else.
        """
        if (path / "run.json").exists():
            if overwrite:
                _remove(path)
            elif cls.open(path).plan != plan:
                raise ConfigError(f"{path}: holds a run with another configuration; use another folder or --overwrite")
            else:
                return cls(path, plan)
        elif path.is_dir() and any(path.iterdir()):
            raise ConfigError(f"{path}: is not empty and holds no run")
        content = {"schema_version": SCHEMA_VERSION, "plan": as_dict(plan), "provenance": provenance()}
        try:
            path.mkdir(parents=True, exist_ok=True)
            write_whole(path / "run.json", (json.dumps(content, indent=1) + "\n").encode())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None
        return cls(path, plan)

    @classmethod
    def open(cls, path: Path) -> RunFolder:
        """Return the run of a folder; ConfigError if there is none or it cannot be read."""
        where = path / "run.json"
        content = read_json(where)
        version = content.get("schema_version") if isinstance(content, dict) else None
        if version != SCHEMA_VERSION:
            raise ConfigError(f"{where}: schema_version must be {SCHEMA_VERSION}, got {version!r}")
        return cls(path, from_dict(RunPlan, content.get("plan", {}), str(where)))

    def bag_path(self, trial_id: str) -> Path:
        """Return where a trial's bag goes, after removing what an interrupted trial left there."""
        path = self.path / "bags" / trial_id
        if path.exists():
            shutil.rmtree(path)
        return path

    def picture_path(self, trial_id: str) -> Path:
        """Return where a trial's picture goes."""
        return self.path / "pictures" / f"{trial_id}.png"

    def append(self, result: TrialResult) -> None:
        """Add a result and see it onto the disk; StoreError if that fails."""
        ResultRows(self.path).append(result)

    def results(self) -> list[TrialResult]:
        """Return the results so far, without a last line that a kill cut off."""
        return ResultRows(self.path).read()

    def remaining(self) -> Iterator[TrialSpec]:
        """Yield the plan's trials that have no result yet."""
        done = {result.trial_id for result in self.results()}
        return (trial for trial in self.plan.trials() if trial.trial_id not in done)


def _remove(path: Path) -> None:
    """Remove what a run has written, and nothing else."""
    for name in ("run.json", "results.jsonl", "tracks.jsonl"):
        (path / name).unlink(missing_ok=True)
    for name in ("bags", "pictures", "logs"):
        if (path / name).is_dir():
            shutil.rmtree(path / name)
