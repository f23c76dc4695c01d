"""The reproduction from its configuration to its files.

OUT/campaign/             the paper's trials, a campaign that is resumed
OUT/transfer_worlds.npz   the new worlds, OUT/transfer/ their trials
OUT/results.json          every number; OUT/results.md and OUT/figures/results_*.png are made from it
OUT/results_origin.json   versions, commits and machines
"""

from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

from rich.console import Console

from barn_eval.experiments.experiment import Execution, Experiment, PlannerChoice
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
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.spec import simulator_config
from barn_metrics.model import DifficultyModel, load_model
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
    learning = learning_finding(model, worlds, model_trials(found), config)
    transfer, sessions = _transfer(config, model, out, execution, console)
    scope = Scope(
        config=config,
        dataset_checksum=dataset.checksum,
        dataset_worlds=len(dataset.indices),
        worlds=len(worlds),
        protocol=PAPER_2020.name,
        simulator={name: attrgetter(name)(experiment.simulator) for name in SENSOR},
        sensor=SENSOR,
    )
    metrics, trials = metrics_finding(dataset, config.seed), trials_finding(results, found, config.seed)
    origin = Origin.of([*RunFile.read(where).sessions, *sessions])
    return Findings(scope, metrics, trials, learning, transfer), origin


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
