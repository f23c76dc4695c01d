"""Compute what the paper reports: Table II, times, failures, Fig. 6, model's errors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_eval.analysis.significance import proportion
from barn_eval.analysis.sources import group_by_planner
from barn_eval.analysis.statistics import mean_interval, rank_correlation
from barn_eval.analysis.summary import count_outcomes
from barn_eval.trials.result import Rows
from barn_metrics import bootstrap
from barn_metrics.bootstrap import Interval
from barn_metrics.metrics import CORRECTED, METRICS, PUBLISHED
from barn_metrics.model import DifficultyModel
from barn_metrics.report import metrics_table
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.errors import ConfigError
from barn_worlds.datasets.dataset import Dataset

# As in the paper.
PLANNERS = ("dwa", "eband")
REPETITIONS = 5
# Share of the worlds that are the easiest or the hardest; their times are compared.
EXTREME_SHARE = 0.1

# For deviations over very few worlds, no bias correction can be trusted.
_bootstrap_interval = partial(bootstrap.bootstrap_interval, percentile=True)


@dataclass(frozen=True, eq=False)
class PlannerTrials:
    """One planner's trials, a row per world and a column per repetition."""

    # Numbers of the worlds (worlds,), ascending.
    worlds: Integers
    # Scored by the protocol (worlds, repetitions).
    normalised_s_per_m: Floats
    time_s: Floats
    succeeded: Bools
    # Number of trials by outcome.
    outcomes: dict[str, int]

    @property
    def trial_worlds(self) -> Integers:
        """World number of each trial (worlds * repetitions,), world by world."""
        return np.repeat(self.worlds, self.time_s.shape[1])


@dataclass(frozen=True)
class PlannerFinding:
    """One planner's figures, named as in data/paper.yaml, with 95 % intervals."""

    planner: str
    trials: int
    # Number of trials by outcome.
    outcomes: dict[str, int]
    normalised_s_per_m: Interval
    # Standard deviation over a world's trials, and of means over worlds.
    spread_s_per_m: Interval
    over_worlds_s_per_m: Interval
    time_s: Interval
    success_time_s: Interval
    failure_share: Interval
    # Mean scored time of failures [s]; None without failures.
    failure_time_s: float | None
    # Mean times in the easiest and the hardest tenth of the worlds.
    easy_s: float
    hard_s: float


@dataclass(frozen=True)
class WorldRow:
    """A world of Fig. 6: figures by planner, and of all trials under "both"."""

    world: int
    mean_s_per_m: dict[str, float]
    # Standard deviation over the trials.
    spread_s_per_m: dict[str, float]


@dataclass(frozen=True)
class TrialsFinding:
    """All figures of the trials."""

    planners: tuple[PlannerFinding, ...]
    # From easy to difficult.
    worlds: tuple[WorldRow, ...]
    # Spearman's rank correlation of mean and spread over both planners' trials, and of
    # the two planners' means.
    spread_correlation: Interval
    planners_correlation: Interval
    # DWA's spread minus E-Band's [s/m].
    spread_difference: Interval
    # How much more DWA's time grows than E-Band's from the easiest to the hardest tenth.
    steeper_s: Interval

    def of(self, planner: str) -> PlannerFinding:
        """Return the figures of a planner by name; StopIteration if there are none."""
        return next(finding for finding in self.planners if finding.planner == planner)


def group_trials(results: Rows, subject: str) -> dict[str, PlannerTrials]:
    """Return DWA's and E-Band's trials as arrays; ConfigError if one is missing.

    Args:
        results: Rows of the run.
        subject: Beginning of the error message.

    Raises:
        ConfigError: If a trial is missing.
    """
    worlds = sorted({result.world for result in results})
    groups = group_by_planner(results)
    return {
        planner: _planner_trials(planner, groups.get(planner, ()), worlds, subject)
        for planner in PLANNERS
    }


def _planner_trials(
    planner: str, results: Rows, worlds: list[int], subject: str
) -> PlannerTrials:
    """Return trials as arrays (worlds, repetitions); ConfigError if one is missing.

    Raises ConfigError if a trial is missing, or there is only one per world.
    """
    scores = {(row.world, row.repetition): row.scores for row in results}
    repetitions = sorted({repetition for _, repetition in scores})
    # A full grid, because spreads over unequal numbers of trials cannot be averaged.
    places = list(product(worlds, repetitions))
    missing = [place for place in places if place not in scores]
    if len(repetitions) < 2 or missing:
        gap = "two trials per world"
        if missing:
            gap = f"trial {missing[0][1]} of world {missing[0][0]}"
        raise ConfigError(
            f"{subject}: planner {planner!r} lacks {gap}; finish the run first"
        )

    def grid(name: str) -> npt.NDArray[Any]:
        """Return a score by its field name as an array (worlds, repetitions)."""
        values = [getattr(scores[place], name) for place in places]
        return np.array(values).reshape(len(worlds), len(repetitions))

    return PlannerTrials(
        np.array(worlds, np.int64),
        grid("normalised_time_s_per_m"),
        grid("scored_time_s"),
        grid("success"),
        count_outcomes(results),
    )


def summarize_trials(
    planner_trials: Mapping[str, PlannerTrials], seed: int
) -> TrialsFinding:
    """Return the figures of both planners, of each world, and of their differences.

    Args:
        planner_trials: Trials of the run by planner.
        seed: Seed of the bootstrap.
    """
    dwa, eband = (planner_trials[planner].normalised_s_per_m for planner in PLANNERS)
    worlds = planner_trials["dwa"].worlds
    # As in Fig. 6, all trials of a world count the same, whichever planner drove.
    both = np.concatenate([dwa, eband], axis=1)
    # Equally difficult worlds are ordered by number.
    order = np.lexsort((worlds, both.mean(axis=1)))
    planners = tuple(
        _summarize_planner(planner, trials, order, seed)
        for planner, trials in planner_trials.items()
    )

    times = {"dwa": dwa, "eband": eband, "both": both}
    rows = tuple(
        WorldRow(
            int(worlds[place]),
            {name: float(values[place].mean()) for name, values in times.items()},
            {name: float(values[place].std()) for name, values in times.items()},
        )
        for place in order
    )
    return TrialsFinding(
        planners,
        rows,
        rank_correlation((both.mean(axis=1), worlds), (both.std(axis=1), worlds), seed),
        rank_correlation(
            (dwa.mean(axis=1), worlds), (eband.mean(axis=1), worlds), seed
        ),
        mean_interval(dwa.std(axis=1) - eband.std(axis=1), worlds),
        _steeper_rise(planner_trials, seed),
    )


def _summarize_planner(
    planner: str, trials: PlannerTrials, order: Integers, seed: int
) -> PlannerFinding:
    """Return one planner's figures; `order` holds indices of worlds, easiest first."""
    failed = ~trials.succeeded
    # Flattened to a value per trial, in the order of `trial_worlds`.
    failures = failed.ravel()
    times_s = trials.time_s.ravel()
    worlds = trials.trial_worlds
    per_m = trials.normalised_s_per_m
    tenth = _extreme_count(len(order))
    failure_time_s = None
    if failed.any():
        failure_time_s = float(trials.time_s[failed].mean())
    return PlannerFinding(
        planner=planner,
        trials=times_s.size,
        outcomes=trials.outcomes,
        normalised_s_per_m=mean_interval(per_m.ravel(), worlds),
        spread_s_per_m=mean_interval(per_m.std(axis=1), trials.worlds),
        over_worlds_s_per_m=deviation(per_m.mean(axis=1), seed),
        time_s=mean_interval(times_s, worlds),
        success_time_s=mean_interval(np.where(failures, np.nan, times_s), worlds),
        failure_share=proportion(failures.astype(np.int64), worlds),
        failure_time_s=failure_time_s,
        easy_s=float(trials.time_s[order[:tenth]].mean()),
        hard_s=float(trials.time_s[order[-tenth:]].mean()),
    )


def _extreme_count(worlds: int) -> int:
    """Return the number of worlds in a tenth, rounded, at least 1."""
    return max(1, round(EXTREME_SHARE * worlds))


def _steeper_rise(planner_trials: Mapping[str, PlannerTrials], seed: int) -> Interval:
    """Return how much more DWA's mean time rises with difficulty than E-Band's [s].

    The rise is from the easiest to the hardest tenth of the worlds.
    """
    dwa, eband = (planner_trials[planner] for planner in PLANNERS)
    dwa_per_m = dwa.normalised_s_per_m.mean(axis=1)
    eband_per_m = eband.normalised_s_per_m.mean(axis=1)
    difficulty = (dwa_per_m + eband_per_m) / 2.0
    difference_s = dwa.time_s.mean(axis=1) - eband.time_s.mean(axis=1)
    tenth = _extreme_count(len(difficulty))

    def rise_s(sample: Integers) -> Floats:
        """Return the rise [s] for each sample of indices of worlds (..., worlds)."""
        # Each bootstrap sample of worlds has its own tenths.
        order = np.argsort(difficulty[sample], axis=-1, kind="stable")
        ordered_s = np.take_along_axis(difference_s[sample], order, axis=-1)
        hard_s = ordered_s[..., -tenth:].mean(axis=-1)
        growth_s: Floats = hard_s - ordered_s[..., :tenth].mean(axis=-1)
        return growth_s

    return _bootstrap_interval(rise_s, len(difficulty), seed)


def deviation(values: Floats, seed: int) -> Interval:
    """Return the standard deviation (divisor n) of values, with a bootstrap interval.

    Args:
        values: One value per world (worlds,).
        seed: Seed of the bootstrap.
    """
    return _bootstrap_interval(
        lambda sample: values[sample].std(axis=-1), len(values), seed
    )


@dataclass(frozen=True)
class MetricRow:
    """One difficulty metric over all worlds of the data set, with 95 % intervals."""

    name: str
    title: str
    # Over the cells of all paths; tortuosity is over paths.
    minimum: float
    maximum: float
    mean: Interval
    std: Interval
    # By the corrected formula. The published one differs in visibility, dispersion and
    # the number of axes (four).
    corrected_mean: float
    corrected_std: float


@dataclass(frozen=True)
class MetricsFinding:
    """Table II of a data set, by the formulas that reproduce the published numbers."""

    worlds: int
    rows: tuple[MetricRow, ...]


def summarize_metrics(dataset: Dataset, seed: int) -> MetricsFinding:
    """Return Table II of a data set: range, mean and deviation of each metric.

    Args:
        dataset: The worlds.
        seed: Seed of the bootstrap.
    """
    table = metrics_table(dataset, PUBLISHED)
    corrected_table = metrics_table(dataset, CORRECTED)
    rows = []
    for metric, values in zip(METRICS, table.values.T, strict=True):
        summary = table.summary_of(metric)
        corrected = corrected_table.summary_of(metric)
        rows.append(
            MetricRow(
                metric.name,
                metric.title,
                summary.get("cell_minimum", summary["minimum"]),
                summary.get("cell_maximum", summary["maximum"]),
                mean_interval(values, np.arange(len(values))),
                deviation(values, seed),
                corrected["mean"],
                corrected["std"],
            )
        )
    return MetricsFinding(len(table.worlds), tuple(rows))


@dataclass(frozen=True)
class ModelFinding:
    """Errors of the suite's difficulty model in these worlds, with 95 % intervals."""

    title: str
    # Number of worlds that it was trained in, none of them among these.
    training_worlds: int
    # Mean squared error in those worlds [(s/m)^2].
    training_mse: float
    # Predictions from easy to difficult by measurement [s/m].
    predicted_s_per_m: tuple[float, ...]
    # (s/m)^2
    variance: float
    mse: Interval
    # s/m
    mae: Interval
    r2: Interval
    spearman: Interval


def judge_model(
    model: DifficultyModel, dataset: Dataset, rows: Sequence[WorldRow], seed: int
) -> ModelFinding:
    """Return a trained model's errors in worlds of `rows`, by both planners' trials.

    Args:
        model: A model that was trained in other worlds.
        dataset: The worlds.
        rows: Mean times by world.
        seed: Seed of the bootstrap.
    """
    worlds = np.array([row.world for row in rows])
    measured = np.array([row.mean_s_per_m["both"] for row in rows])
    predictions = [model.predict(dataset.load(row.world)) for row in rows]
    predicted = np.array([item.difficulty_s_per_m for item in predictions])
    errors = predicted - measured

    def r2(sample: Integers) -> Floats:
        """Return R2, the explained share of variance, for each sample of worlds."""
        unexplained = (errors[sample] ** 2).mean(axis=-1)
        share: Floats = 1.0 - unexplained / measured[sample].var(axis=-1)
        return share

    return ModelFinding(
        title=model.about.get("title", ""),
        training_worlds=model.about.get("training_worlds", 0),
        training_mse=model.about.get("training_mse", math.nan),
        predicted_s_per_m=tuple(predicted.tolist()),
        variance=float(measured.var()),
        mse=mean_interval(errors**2, worlds),
        mae=mean_interval(np.abs(errors), worlds),
        r2=_bootstrap_interval(r2, len(worlds), seed),
        spearman=rank_correlation((predicted, worlds), (measured, worlds), seed),
    )
