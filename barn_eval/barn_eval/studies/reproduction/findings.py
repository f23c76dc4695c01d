"""What a reproduction consists of, its run, and all that it has found, as plain data: the page comes from it alone.

OUT/campaign/             the paper's trials, a campaign that is resumed
OUT/results.json          every number; OUT/results.md and OUT/figures/results_*.png are made from it
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
from barn_metrics.model.evaluation import Evaluation, EvaluationConfig, evaluate
from barn_metrics.model.trials import Trials
from barn_worlds.base.config import Checked, as_dict, from_dict, quantity
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.text_files import make_json_safe, read_json
from barn_worlds.datasets.dataset import open_dataset

SCHEMA_VERSION = 4


@dataclass(frozen=True)
class ReproduceConfig(Checked):
    """What decides the outcome.

    strata: the worlds, in the order of the data set, are cut into so many parts, one drawn from each; 0 takes all.
    """

    dataset: str = quantity("barn300", "data set: a name, folder or file")
    strata: int = quantity(
        0,
        "parts of the order of which one world each is taken, 0 for all",
        "",
        0,
        10_000,
    )
    repetitions: int = quantity(
        paper.REPETITIONS, "trials per world and planner", "", 2, 99
    )
    seed: int = quantity(0, "all randomness comes from it", "", 0, 2**31)
    folds: int = quantity(10, "parts that held-out worlds are taken in", "", 2, 100)
    repeats: int = quantity(5, "how often they are drawn anew", "", 1, 100)


QUICK = ReproduceConfig(strata=40, folds=5, repeats=1)


@dataclass(frozen=True)
class Scope:
    """What was run.

    dataset_worlds: number of worlds of the data set; worlds: number of those with trials.
    """

    config: ReproduceConfig
    dataset_checksum: str
    dataset_worlds: int
    worlds: int
    protocol: str


@dataclass(frozen=True)
class Findings:
    """The outcome of a reproduction; equal configurations and code give equal findings, bit for bit."""

    scope: Scope
    metrics: paper.MetricsFinding
    trials: paper.TrialsFinding
    learning: Evaluation
    schema_version: int = SCHEMA_VERSION


@dataclass(frozen=True)
class Origin:
    """Commits, versions and machines of all sessions of the campaign and of this analysis, each named once."""

    commits: tuple[str, ...]
    versions: tuple[dict[str, str], ...]
    machines: tuple[dict[str, Any], ...]

    @classmethod
    def of(cls, earlier: Iterable[Mapping[str, Any]]) -> "Origin":
        """Return what the sessions of a campaign and this process have been made with."""
        sessions = [*earlier, provenance()]
        return cls(
            tuple(
                dict.fromkeys(
                    str(session["commit"] or "not known") for session in sessions
                )
            ),
            _distinct(session["versions"] for session in sessions),
            _distinct(session["machine"] for session in sessions),
        )


def to_json(found: Findings | Origin) -> str:
    """Return findings, or their origin, as JSON; numbers that JSON does not have become null."""
    return json.dumps(make_json_safe(as_dict(found)), indent=1, allow_nan=False) + "\n"


def read_findings(path: Path) -> Findings:
    """Return the findings of a file that `to_json` made; ConfigError in one line if it is none."""
    content = read_json(path)
    version = content.get("schema_version") if isinstance(content, dict) else None
    if version != SCHEMA_VERSION:
        raise ConfigError(
            f"{path}: schema_version must be {SCHEMA_VERSION}, got {version!r}"
        )
    return from_dict(Findings, content, str(path))


def _distinct(entries: Iterable[dict[str, Any]]) -> tuple[dict[str, Any], ...]:
    return tuple(
        {json.dumps(entry, sort_keys=True): entry for entry in entries}.values()
    )


def reproduce(
    config: ReproduceConfig, out: Path, execution: ExecutionConfig, reporter: Reporter
) -> tuple[Findings, Origin]:
    """Run what is still missing, and return what all of it says and what it was made with.

    Raises BarnError in one line for what the user has to change, before any trial where it can be told by then.
    """
    model, dataset, where = load_model(), open_dataset(config.dataset), out / "campaign"
    experiment = paper_campaign(config)
    reporter.notify(f"the paper's trials, in {where}")
    with open_run(RunRequest(experiment, execution, where), reporter) as run:
        results = run.drive()
    found = paper.trials_by_planner(results, str(where))
    worlds = {int(number): dataset.load(int(number)) for number in found["dwa"].worlds}
    judged = EvaluationConfig(
        folds=config.folds, repeats=config.repeats, seed=config.seed
    )
    findings = Findings(
        Scope(
            config,
            dataset.checksum,
            len(dataset.world_numbers),
            len(worlds),
            PAPER_2020.name,
        ),
        paper.metrics_finding(dataset, config.seed),
        paper.trials_finding(results, found, config.seed),
        evaluate(worlds, _model_trials(found), model, judged),
    )
    return findings, Origin.of(RunFile.read(where).sessions)


def paper_campaign(config: ReproduceConfig) -> RunConfig:
    """Return the campaign of the paper's trials."""
    indices = open_dataset(config.dataset).world_numbers
    chosen = chosen_worlds(indices, config.strata, config.seed)
    return RunConfig(
        dataset=config.dataset,
        worlds="all" if len(chosen) == len(indices) else ",".join(map(str, chosen)),
        planners=tuple(PlannerChoice(name) for name in paper.PLANNERS),
        repetitions=config.repetitions,
        protocol=PAPER_2020,
        simulator=simulator_config(PAPER_2020),
        seed=config.seed,
    )


def chosen_worlds(indices: Sequence[int], strata: int, seed: int) -> tuple[int, ...]:
    """Return one number from each of `strata` parts of equal size of numbers in order, drawn from the seed.

    All of them if `strata` is 0 or there are not more.
    """
    if strata == 0 or strata >= len(indices):
        return tuple(indices)
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    parts = np.array_split(np.asarray(indices, np.int64), strata)
    return tuple(int(part[int(generator.random() * len(part))]) for part in parts)


def _model_trials(found: dict[str, paper.PlannerTrials]) -> Trials:
    """Return trials as the difficulty model takes them."""
    return Trials(
        np.concatenate([one.world_of_each for one in found.values()]),
        tuple(planner for planner, one in found.items() for _ in one.world_of_each),
        np.concatenate([one.normalised_s_per_m.ravel() for one in found.values()]),
        np.concatenate([one.succeeded.ravel() for one in found.values()]),
    )
