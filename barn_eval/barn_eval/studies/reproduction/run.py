"""The reproduction from its configuration to its files.

OUT/campaign/             the paper's trials, a campaign that is resumed
OUT/results.json          every number; OUT/results.md and OUT/figures/results_*.png are made from it
OUT/results_origin.json   versions, commits and machines
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from barn_eval.experiments.experiment import Execution, Experiment, PlannerChoice
from barn_eval.experiments.request import Request
from barn_eval.experiments.run import run_experiment
from barn_eval.experiments.run_file import RunFile
from barn_eval.studies.reproduction.findings import Findings, Origin, ReproduceConfig, Scope
from barn_eval.studies.reproduction.paper import PLANNERS
from barn_eval.studies.reproduction.trials import PlannerTrials, metrics_finding, trials_by_planner, trials_finding
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.spec import simulator_config
from barn_metrics.model import load_model
from barn_metrics.model.evaluation import EvaluationConfig, evaluate
from barn_metrics.model.trials import Trials
from barn_worlds.worlds.dataset import open_dataset


def reproduce(config: ReproduceConfig, out: Path, execution: Execution, console: Console) -> tuple[Findings, Origin]:
    """Run what is still missing, and return what all of it says and what it was made with.

    Raises BarnError in one line for what the user has to change, before any trial where it can be told by then.
    """
    model, dataset, where = load_model(), open_dataset(config.dataset), out / "campaign"
    experiment = paper_campaign(config)
    console.print(f"the paper's trials, in {where}", markup=False)
    results = run_experiment(Request(experiment, execution, where), console)
    found = trials_by_planner(results, str(where))
    worlds = {int(number): dataset.load(int(number)) for number in found["dwa"].worlds}
    judged = EvaluationConfig(folds=config.folds, repeats=config.repeats, seed=config.seed)
    findings = Findings(
        Scope(config, dataset.checksum, len(dataset.indices), len(worlds), PAPER_2020.name),
        metrics_finding(dataset, config.seed),
        trials_finding(results, found, config.seed),
        evaluate(worlds, _model_trials(found), judged, model),
    )
    return findings, Origin.of(RunFile.read(where).sessions)


def paper_campaign(config: ReproduceConfig) -> Experiment:
    """Return the campaign of the paper's trials."""
    indices = open_dataset(config.dataset).indices
    chosen = chosen_worlds(indices, config.strata, config.seed)
    return Experiment(
        dataset=config.dataset,
        worlds="all" if len(chosen) == len(indices) else ",".join(map(str, chosen)),
        planners=tuple(PlannerChoice(name) for name in PLANNERS),
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


def _model_trials(found: dict[str, PlannerTrials]) -> Trials:
    """Return trials as the difficulty model takes them."""
    return Trials(
        np.concatenate([one.world_of_each for one in found.values()]),
        tuple(planner for planner, one in found.items() for _ in one.world_of_each),
        np.concatenate([one.normalised_s_per_m.ravel() for one in found.values()]),
        np.concatenate([one.succeeded.ravel() for one in found.values()]),
    )
