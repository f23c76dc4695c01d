"""The experiment of Fig. 8, in simulation: new worlds, no map, another sensor, more noise; measured against predicted.

The paper's was done with cardboard boxes and a real robot. It asks whether a difficulty learnt from one set of trials
holds elsewhere.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from barn_eval.analysis.means import mean_interval
from barn_eval.analysis.significance import proportion
from barn_eval.analysis.statistics import rank_correlation
from barn_eval.experiments.experiment import Experiment, PlannerChoice
from barn_eval.studies.intervals import Line, line, slope_difference
from barn_eval.studies.reproduction.config import ReproduceConfig
from barn_eval.studies.reproduction.paper import PLANNERS
from barn_eval.studies.reproduction.trials import PlannerTrials
from barn_eval.trials.protocol import PAPER_2020, Protocol
from barn_eval.trials.spec import simulator_config
from barn_metrics.bootstrap import Interval
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError
from barn_worlds.formats.own import write_own
from barn_worlds.worlds.dataset import open_dataset
from barn_worlds.worlds.generate import DatasetParameters, generate_dataset
from barn_worlds.worlds.world import World

PROTOCOL: Protocol = replace(PAPER_2020, name="transfer", map_given=False, historical_map=False)

# A small laser scanner of the kind of the Hokuyo URG-04LX (240 degrees, 0.36 degrees apart, 5.6 m, centimetres of
# noise) in place of the trials' SICK LMS1xx, and an IMU four times as noisy. Without a map localisation has no part.
SENSOR: dict[str, Any] = {
    "lidar.beams": 667,
    "lidar.angle_min_rad": -2.0944,
    "lidar.angle_max_rad": 2.0944,
    "lidar.range_min_m": 0.06,
    "lidar.range_max_m": 5.6,
    "lidar.noise_m": 0.015,
    "lidar.mount_x_m": 0.055,
    "lidar.mount_z_m": 0.241,
    "odometry.yaw_noise_rad": 0.02,
    "odometry.yaw_rate_noise_rad_s": 0.02,
    "localisation.mode": "exact",
}


@dataclass(frozen=True)
class NewWorld:
    """A new world: its prediction, and by planner the mean and spread over its trials, all in s/m.

    in_figure: whether it is one of Fig. 8's.
    """

    world: int
    in_figure: bool
    predicted_s_per_m: float
    mean_s_per_m: dict[str, float]
    spread_s_per_m: dict[str, float]


@dataclass(frozen=True)
class Regression:
    """Measured on predicted time per metre: both planners together, each, and how much steeper DWA's line is.

    correlation: Spearman's, of predictions and means of both planners over worlds.
    """

    lines: dict[str, Line]
    steeper: Interval
    correlation: Interval


@dataclass(frozen=True)
class NewTrials:
    """One planner on the new worlds: counted time per metre, and share of failures."""

    planner: str
    normalised_s_per_m: Interval
    failure_share: Interval


@dataclass(frozen=True)
class TransferFinding:
    """The experiment: on the worlds of the figure and, where more were driven, on all of these.

    easiest_difference_s_per_m: DWA's minus E-Band's mean in the half that is predicted to be easier.
    """

    generated: int
    worlds: tuple[NewWorld, ...]
    figure: Regression
    all_worlds: Regression | None
    planners: tuple[NewTrials, ...]
    easiest_difference_s_per_m: Interval


def new_worlds(path: Path, config: ReproduceConfig) -> dict[int, World]:
    """Return the new worlds by number, written to a data set file; ConfigError if it holds others."""
    parameters = DatasetParameters(name="transfer", seed=config.transfer_seed, worlds_per_set=config.transfer_per_set)
    made = dict(enumerate(generate_dataset(parameters)))
    if not path.exists():
        write_own(path, "transfer", made, {"seed": config.transfer_seed, "worlds_per_set": config.transfer_per_set})
    there = open_dataset(path)
    if {number: there.load(number).checksum for number in there.indices} != {
        n: one.checksum for n, one in made.items()
    }:
        raise ConfigError(f"{path}: holds other worlds than those of seed {config.transfer_seed}; use another folder")
    return made


def spread_out(predicted: Mapping[int, float], count: int) -> tuple[int, ...]:
    """Return the worlds in the middle of each of `count` parts of the order by prediction, easiest first."""
    order = sorted(predicted, key=lambda index: (predicted[index], index))
    if len(order) < count:
        raise ConfigError(f"transfer_worlds must be at most {len(order)}, the number of new worlds, got {count}")
    return tuple(int(part[len(part) // 2]) for part in np.array_split(np.array(order, np.int64), count))


def transfer_campaign(dataset: Path, worlds: Sequence[int], config: ReproduceConfig) -> Experiment:
    """Return the campaign on new worlds."""
    return Experiment(
        dataset=str(dataset.resolve()),
        worlds=",".join(map(str, sorted(worlds))),
        planners=tuple(PlannerChoice(name) for name in PLANNERS),
        repetitions=config.repetitions,
        protocol=PROTOCOL,
        simulator=simulator_config(PROTOCOL, SENSOR),
        seed=config.seed,
    )


def transfer_finding(
    found: Mapping[str, PlannerTrials],
    predicted: Mapping[int, float],
    in_figure: Sequence[int],
    generated: int,
    seed: int,
) -> TransferFinding:
    """Return what trials on new worlds say; predicted: by world; in_figure: the worlds of the figure."""
    dwa, eband = (found[planner].normalised_s_per_m for planner in ("dwa", "eband"))
    worlds = found["dwa"].worlds
    prediction, shown = np.array([predicted[int(world)] for world in worlds]), np.isin(worlds, in_figure)
    rows = tuple(
        NewWorld(
            int(worlds[at]),
            bool(shown[at]),
            float(prediction[at]),
            {planner: float(one.normalised_s_per_m[at].mean()) for planner, one in found.items()},
            {planner: float(one.normalised_s_per_m[at].std()) for planner, one in found.items()},
        )
        for at in np.lexsort((worlds, prediction))
    )
    easier = prediction <= np.median(prediction)
    return TransferFinding(
        generated,
        rows,
        _regression(prediction[shown], dwa[shown], eband[shown], seed),
        None if shown.all() else _regression(prediction, dwa, eband, seed),
        tuple(_new_trials(planner, one) for planner, one in found.items()),
        mean_interval((dwa - eband).mean(axis=1)[easier], worlds[easier]),
    )


def _regression(predicted: Floats, dwa: Floats, eband: Floats, seed: int) -> Regression:
    """Return the lines through the trials (w, t) of worlds over their predictions (w,)."""
    both, numbers = np.concatenate([dwa, eband], axis=1), np.arange(len(predicted))
    by_name = {"both": both, "dwa": dwa, "eband": eband}
    return Regression(
        {name: line(predicted, values, seed) for name, values in by_name.items()},
        slope_difference(predicted, dwa, eband, seed),
        rank_correlation((predicted, numbers), (both.mean(axis=1), numbers), seed),
    )


def _new_trials(planner: str, trials: PlannerTrials) -> NewTrials:
    worlds = trials.world_of_each
    return NewTrials(
        planner,
        mean_interval(trials.normalised_s_per_m.ravel(), worlds),
        proportion((~trials.succeeded).ravel().astype(np.int64), worlds),
    )
