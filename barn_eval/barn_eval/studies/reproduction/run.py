"""The reproduction from its configuration to its files.

OUT/campaign/             the paper's trials, a campaign that is resumed
OUT/transfer_worlds.npz   the new worlds, OUT/transfer/ their trials
OUT/results.json          every number; OUT/results.md and OUT/figures/results_*.png are made from it
OUT/results_origin.json   versions, commits and machines
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from barn_eval.experiments.experiment import Execution, Experiment, PlannerChoice
from barn_eval.experiments.folder import read_results
from barn_eval.experiments.request import Request
from barn_eval.experiments.run import run_experiment
from barn_eval.experiments.run_file import RunFile
from barn_eval.studies.reproduction.config import ReproduceConfig, chosen_worlds
from barn_eval.studies.reproduction.findings import Findings, Origin, Scope
from barn_eval.studies.reproduction.model import learning_finding, model_trials
from barn_eval.studies.reproduction.new_worlds import (
    SENSOR,
    TransferFinding,
    new_worlds,
    spread_out,
    transfer_campaign,
    transfer_finding,
)
from barn_eval.studies.reproduction.paper import PLANNERS
from barn_eval.studies.reproduction.table_ii import metrics_finding
from barn_eval.studies.reproduction.trials import trials_by_planner, trials_finding
from barn_eval.trials.identity import first_difference, task
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.result import TrialResult
from barn_eval.trials.spec import simulator_config
from barn_metrics.model import DifficultyModel, load_model
from barn_worlds.base.errors import ConfigError
from barn_worlds.worlds.dataset import Dataset, open_dataset


@dataclass(frozen=True)
class _Driven:
    """The paper's trials: a campaign's folder, results, run.json and data set."""

    where: Path
    results: Sequence[TrialResult]
    run: RunFile
    dataset: Dataset


def reproduce(
    config: ReproduceConfig, out: Path, execution: Execution, console: Console, campaign: Path | None = None
) -> tuple[Findings, Origin]:
    """Run what is still missing, and return what all of it says and what it was made with.

    campaign: folder of a finished campaign of the paper's trials to take in place of an own one. Raises BarnError in
    one line for what the user has to change, before any trial where it can be told by then.
    """
    model = load_model()
    driven = _given(campaign, config) if campaign else _driven(config, out / "campaign", execution, console)
    found = trials_by_planner(driven.results, str(driven.where))
    worlds = {int(number): driven.dataset.load(int(number)) for number in found["dwa"].worlds}
    learning = learning_finding(model, worlds, model_trials(found), config)
    transfer, transfer_sessions = _transfer(config, model, out, execution, console)
    described = driven.run.experiment
    scope = Scope(
        config=config,
        dataset=driven.dataset.name,
        dataset_checksum=driven.dataset.checksum,
        dataset_worlds=len(driven.dataset.indices),
        worlds=len(worlds),
        repetitions=found["dwa"].time_s.shape[1],
        campaign_seed=int(described["seed"]),
        protocol=described["protocol"],
        simulator=described["simulator"],
        sensor=SENSOR,
    )
    metrics = metrics_finding(driven.dataset, config.seed)
    trials = trials_finding(driven.results, found, config.seed)
    return Findings(scope, metrics, trials, learning, transfer), Origin.of([*driven.run.sessions, *transfer_sessions])


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


def _driven(config: ReproduceConfig, where: Path, execution: Execution, console: Console) -> _Driven:
    """Run the paper's trials, as far as they are missing."""
    asked = paper_campaign(config)
    console.print(f"the paper's trials, in {where}", markup=False)
    results = run_experiment(Request(asked, execution, where), console)
    return _Driven(where, results, RunFile.read(where), open_dataset(config.dataset))


def _given(where: Path, config: ReproduceConfig) -> _Driven:
    """Read the paper's trials from a campaign's folder; ConfigError if it is unfinished or holds others."""
    run = RunFile.read(where)
    described = run.experiment
    protocol = described["protocol"]["name"]
    if protocol != PAPER_2020.name:
        raise ConfigError(f"{where}: holds trials of protocol {protocol!r}, not {PAPER_2020.name!r}")
    found = first_difference(task(PAPER_2020, simulator_config(PAPER_2020)), run.task())
    if found is not None:
        raise ConfigError(
            f"{where}: its task is not that of {PAPER_2020.name!r}: {found[0]} is {found[2]!r}, not {found[1]!r}"
        )
    dataset = open_dataset(described["dataset"])
    results = read_results(where)
    for index, checksum in sorted({(one.world, one.world_checksum) for one in results}):
        if index not in dataset.indices or dataset.load(index).checksum != checksum:
            raise ConfigError(f"{where}: world {index} is not the one of {dataset.name} that it ran in")
    planned = len(run.worlds) * len(described["planners"]) * described["repetitions"]
    if len(results) != planned:
        raise ConfigError(f"{where}: has {len(results)} of {planned} trials; finish the campaign first")
    chosen = set(chosen_worlds(sorted({one.world for one in results}), config.strata, config.seed))
    return _Driven(where, [one for one in results if one.world in chosen], run, dataset)


def _transfer(
    config: ReproduceConfig, model: DifficultyModel, out: Path, execution: Execution, console: Console
) -> tuple[TransferFinding, Sequence[Mapping[str, Any]]]:
    """Run the experiment on new worlds and return what it says, with its sessions."""
    out.mkdir(parents=True, exist_ok=True)
    file, where = out / "transfer_worlds.npz", out / "transfer"
    worlds = new_worlds(file, config)
    predicted = {index: model.predict(world).difficulty_s_per_m for index, world in worlds.items()}
    in_figure = spread_out(predicted, config.transfer_worlds)
    driven = list(worlds) if config.transfer_all else sorted(in_figure)
    console.print(f"{len(driven)} new worlds without map, in {where}", markup=False)
    results = run_experiment(Request(transfer_campaign(file, driven, config), execution, where), console)
    found = trials_by_planner(results, str(where))
    return transfer_finding(found, predicted, in_figure, len(worlds), config.seed), RunFile.read(where).sessions
