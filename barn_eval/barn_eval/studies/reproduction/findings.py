"""A reproduction of the paper: its run, and its findings as plain data.

OUT/campaign/             the paper's trials, a run that can be resumed
OUT/results.json          every number; results.md and figures/*.png follow from it
OUT/results_origin.json   versions, commits and machines
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from barn_eval.results.provenance import provenance
from barn_eval.results.run_file import RunFile
from barn_eval.running.reporting import Reporter
from barn_eval.running.request import RunRequest
from barn_eval.running.run import open_run
from barn_eval.studies.reproduction import trials as paper
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.spec import simulator_config
from barn_metrics.model import load_model
from barn_worlds.base.config import Checked, as_dict, quantity
from barn_worlds.base.files import make_json_safe
from barn_worlds.datasets.dataset import open_dataset

SCHEMA_VERSION = 5


@dataclass(frozen=True)
class ReproduceConfig(Checked):
    """Settings that determine the findings."""

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    strata: int = quantity(
        0,
        "number of difficulty classes, with one world drawn from each; 0: all worlds",
        "",
        0,
        10_000,
    )
    repetitions: int = quantity(
        paper.REPETITIONS, "trials per world and planner", "", 2, 99
    )
    seed: int = quantity(0, "seed of all random numbers", "", 0, 2**31)


QUICK = ReproduceConfig(strata=40)


@dataclass(frozen=True)
class Scope:
    """What was run."""

    config: ReproduceConfig
    dataset_checksum: str
    # Number of worlds of the data set, and of those with trials.
    dataset_worlds: int
    worlds: int
    protocol: str


@dataclass(frozen=True)
class Findings:
    """The findings of a reproduction; equal code and configuration give equal ones."""

    scope: Scope
    metrics: paper.MetricsFinding
    trials: paper.TrialsFinding
    model: paper.ModelFinding
    schema_version: int = SCHEMA_VERSION


@dataclass(frozen=True)
class Origin:
    """Commits, versions and machines of a run's sessions and its analysis, without repeats."""

    commits: tuple[str, ...]
    versions: tuple[dict[str, str], ...]
    machines: tuple[dict[str, Any], ...]

    @classmethod
    def of(cls, run_sessions: Iterable[Mapping[str, Any]]) -> "Origin":
        """Return distinct commits, versions, machines of sessions and this process."""
        sessions = [*run_sessions, provenance()]
        commits = [str(session["commit"] or "unknown") for session in sessions]
        return cls(
            tuple(dict.fromkeys(commits)),
            _distinct(session["versions"] for session in sessions),
            _distinct(session["machine"] for session in sessions),
        )


def to_json(content: Findings | Origin) -> str:
    """Return findings or an origin as JSON text, with null for NaN and infinity."""
    safe_content = make_json_safe(as_dict(content))
    return json.dumps(safe_content, indent=1, allow_nan=False) + "\n"


def _distinct(entries: Iterable[dict[str, Any]]) -> tuple[dict[str, Any], ...]:
    """Return entries without repetitions, in order of first appearance."""
    by_content = {json.dumps(entry, sort_keys=True): entry for entry in entries}
    return tuple(by_content.values())


def reproduce(
    config: ReproduceConfig, out: Path, execution: ExecutionConfig, reporter: Reporter
) -> tuple[Findings, Origin]:
    """Run the paper's missing trials in OUT/campaign; return (findings, origin) of all.

    Args:
        config: Settings that determine the findings.
        out: Folder of the reproduction.
        execution: Workers of the run.
        reporter: Receives notices and progress.

    Returns:
        The findings, and the versions and machines that they were made with.

    Raises:
        BarnError: If a setting is wrong, before any trial if possible.
    """
    model = load_model()
    dataset = open_dataset(config.dataset)
    run_folder = out / "campaign"
    reporter.notify(f"the paper's trials, in {run_folder}")
    request = RunRequest(paper_run(config), execution, run_folder)
    with open_run(request, reporter) as run:
        results = run.drive()

    planner_trials = paper.group_trials(results, str(run_folder))
    trials = paper.summarize_trials(planner_trials, config.seed)
    scope = Scope(
        config,
        dataset.checksum,
        len(dataset.world_numbers),
        len(trials.worlds),
        PAPER_2020.name,
    )
    findings = Findings(
        scope,
        paper.summarize_metrics(dataset, config.seed),
        trials,
        paper.judge_model(model, dataset, trials.worlds, config.seed),
    )
    return findings, Origin.of(RunFile.read(run_folder).sessions)


def paper_run(config: ReproduceConfig) -> RunConfig:
    """Return the configuration of the run with the paper's trials."""
    world_numbers = open_dataset(config.dataset).world_numbers
    sample = draw_worlds(world_numbers, config.strata, config.seed)
    worlds = "all"
    if len(sample) < len(world_numbers):
        worlds = ",".join(map(str, sample))
    return RunConfig(
        dataset=config.dataset,
        worlds=worlds,
        planners=tuple(PlannerChoice(name) for name in paper.PLANNERS),
        repetitions=config.repetitions,
        protocol=PAPER_2020,
        simulator=simulator_config(PAPER_2020),
        seed=config.seed,
    )


def draw_worlds(
    world_numbers: Sequence[int], strata: int, seed: int
) -> tuple[int, ...]:
    """Return a random world of each of `strata` parts in order; all if 0 or too many.

    Args:
        world_numbers: Numbers of worlds, in order of difficulty.
        strata: Number of parts of equal size; 0 takes all worlds.
        seed: Seed of the draws.

    Returns:
        One number per part, or all numbers if there are no more than parts.
    """
    if strata == 0 or strata >= len(world_numbers):
        return tuple(world_numbers)
    # A separate key keeps these draws independent of those of the trials.
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    parts = np.array_split(np.asarray(world_numbers, np.int64), strata)
    return tuple(int(part[int(generator.random() * len(part))]) for part in parts)
