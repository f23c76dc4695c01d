"""Driving a trial of an experiment once more."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from barn_eval.bags import BAGS
from barn_eval.experiments.engine import Job
from barn_eval.experiments.experiment import Execution, PlannerChoice
from barn_eval.experiments.live import LivePlanner
from barn_eval.experiments.run_file import RunFile
from barn_eval.experiments.store import Record, Store
from barn_eval.ros.work import work_of
from barn_eval.trials.result import TrialResult
from barn_worlds.base.errors import ConfigError


@dataclass(frozen=True)
class Again:
    """Trials of the experiment in a folder, driven again. live: its planners that are Python objects, by name."""

    folder: Path
    live: Mapping[str, LivePlanner]

    def drive(self, result: TrialResult, folder: Path, bags: str) -> TrialResult:
        """Drive a trial once more, alone, its bag in a folder, and return its new result."""
        experiment = replace(RunFile.read(self.folder).configuration(), bags=bags)
        self._require_same_planner(experiment.planners, result.planner)
        (spec,) = (one for one in experiment.trials([result.world]) if one.trial_id == result.trial_id)
        kept: list[object] = []  # what mode ros reports on the way
        work = work_of(experiment, Execution(workers=1), Store(folder.absolute(), bags), self.live)
        done = work.run(Job(result.trial_id, (spec,)), kept.append)
        return next(one for one in (done, *kept) if isinstance(one, Record)).result

    def bag(self, result: TrialResult, folder: Path) -> Path:
        """Drive a trial for its bag, which comes into a folder, and say so; also if it goes otherwise this time."""
        console = Console(stderr=True)
        console.print(f"no bag of {result.trial_id} was kept: it is driven once more", highlight=False)
        again = self.drive(result, folder, bags="all")
        if again.repeatable() != result.repeatable():
            console.print(
                f"{result.trial_id} went otherwise this time: {again.outcome.value}, not {result.outcome.value} as in"
                " its row, or by another way; its planner does not repeat itself",
                highlight=False,
            )
        return folder / BAGS / result.trial_id

    def _require_same_planner(self, choices: Sequence[PlannerChoice], name: str) -> None:
        (choice,) = (one for one in choices if one.name == name)
        if not choice.source:
            return
        if name not in self.live:
            raise ConfigError(f"planner {name!r} was a Python object: barn.load(folder, planners=...) takes it")
        if self.live[name].choice().source != choice.source:
            raise ConfigError(f"planner {name!r} is not the one of these results: its source differs")
