"""What worlds and trials say: Table II, times as the paper counts them, failures, worlds by difficulty (Fig. 6)."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from barn_eval.analysis.significance import proportion
from barn_eval.analysis.statistics import mean_interval, rank_correlation
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.result import Rows
from barn_metrics import bootstrap
from barn_metrics.bootstrap import Interval
from barn_metrics.metrics import CORRECTED, METRICS, PUBLISHED
from barn_metrics.report import metrics_table
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.errors import ConfigError
from barn_worlds.datasets.dataset import Dataset

PLANNERS, REPETITIONS = ("dwa", "eband"), 5  # of the paper
# A tenth of the worlds: the easiest and the most difficult whose mean times are compared.
EXTREME_SHARE = 0.1

# Deviations of very few worlds have no bias correction that could be trusted.
over_worlds = partial(bootstrap.bootstrap_interval, percentile=True)


@dataclass(frozen=True, eq=False)
class PlannerTrials:
    """One planner's trials, a row per world and a column per repetition.

    worlds: (w,) numbers, ascending. normalised_s_per_m, time_s: (w, t) as the protocol counts them. succeeded: (w, t).
    """

    worlds: Integers
    normalised_s_per_m: Floats
    time_s: Floats
    succeeded: Bools

    @property
    def world_of_each(self) -> Integers:
        """The world of each trial (w * t,), as the other arrays are flattened."""
        return np.repeat(self.worlds, self.time_s.shape[1])


@dataclass(frozen=True)
class PlannerFinding:
    """One planner's figures as data/paper.yaml names them, with 95 % intervals over worlds.

    failure_time_s: what a failure counts on average, None without failures.
    """

    planner: str
    trials: int
    outcomes: dict[str, int]
    normalised_s_per_m: Interval
    spread_s_per_m: Interval
    over_worlds_s_per_m: Interval
    time_s: Interval
    success_time_s: Interval
    failure_share: Interval
    failure_time_s: float | None
    easy_s: float
    hard_s: float


@dataclass(frozen=True)
class WorldRow:
    """A world of Fig. 6: mean and standard deviation over its trials, by planner and of both ("both"), in s/m."""

    world: int
    mean_s_per_m: dict[str, float]
    spread_s_per_m: dict[str, float]


@dataclass(frozen=True)
class TrialsFinding:
    """All that the trials say.

    worlds: from easy to difficult. spread_correlation: Spearman's, of mean and spread of both planners' trials.
    spread_difference: DWA's minus E-Band's. steeper: how much faster DWA's time grows than
    E-Band's from the easiest to the hardest tenth, s.
    """

    planners: tuple[PlannerFinding, ...]
    worlds: tuple[WorldRow, ...]
    spread_correlation: Interval
    planners_correlation: Interval
    spread_difference: Interval
    steeper_s: Interval

    def of(self, planner: str) -> PlannerFinding:
        """Return one planner's figures."""
        return next(one for one in self.planners if one.planner == planner)


def trials_by_planner(results: Rows, where: str) -> dict[str, PlannerTrials]:
    """Return the trials of each of the paper's planners; ConfigError, beginning with `where`, if some are missing."""
    worlds = sorted({one.world for one in results})
    found = {}
    for planner in PLANNERS:
        own = {
            (one.world, one.repetition): one
            for one in results
            if one.planner == planner
        }
        repetitions = sorted({repetition for _, repetition in own})
        missing = [
            (world, r) for world in worlds for r in repetitions if (world, r) not in own
        ]
        if len(repetitions) < 2 or missing:
            lacks = (
                f"trial {missing[0][1]} of world {missing[0][0]}"
                if missing
                else "two trials per world"
            )
            raise ConfigError(
                f"{where}: planner {planner!r} lacks {lacks}; finish the campaign first"
            )
        scores = [
            own[world, repetition].scores
            for world in worlds
            for repetition in repetitions
        ]
        figures = [
            (one.normalised_time_s_per_m, one.scored_time_s, one.success)
            for one in scores
        ]
        per_m, time_s, success = (
            np.array(figures, np.float64).T.copy().reshape(3, len(worlds), -1)
        )
        found[planner] = PlannerTrials(
            np.array(worlds, np.int64), per_m, time_s, success.astype(np.bool_)
        )
    return found


def trials_finding(
    results: Rows, found: Mapping[str, PlannerTrials], seed: int
) -> TrialsFinding:
    """Return what the trials of both planners say."""
    dwa, eband = (found[planner].normalised_s_per_m for planner in PLANNERS)
    worlds = found["dwa"].worlds
    both = np.concatenate([dwa, eband], axis=1)
    order = np.lexsort((worlds, both.mean(axis=1)))
    means = {"dwa": dwa, "eband": eband, "both": both}
    rows = tuple(
        WorldRow(
            int(worlds[at]),
            {name: float(values[at].mean()) for name, values in means.items()},
            {name: float(values[at].std()) for name, values in means.items()},
        )
        for at in order
    )
    return TrialsFinding(
        tuple(
            _planner(planner, results, trials, order, seed)
            for planner, trials in found.items()
        ),
        rows,
        rank_correlation((both.mean(axis=1), worlds), (both.std(axis=1), worlds), seed),
        rank_correlation(
            (dwa.mean(axis=1), worlds), (eband.mean(axis=1), worlds), seed
        ),
        mean_interval(dwa.std(axis=1) - eband.std(axis=1), worlds),
        _steeper(found, seed),
    )


def _planner(
    planner: str, results: Rows, trials: PlannerTrials, order: Integers, seed: int
) -> PlannerFinding:
    outcomes = Counter(one.outcome for one in results if one.planner == planner)
    failed, worlds = ~trials.succeeded, trials.world_of_each
    times, tenth = trials.time_s.ravel(), _tenth(len(order))
    return PlannerFinding(
        planner=planner,
        trials=times.size,
        outcomes={
            outcome.value: outcomes[outcome] for outcome in Outcome if outcomes[outcome]
        },
        normalised_s_per_m=mean_interval(trials.normalised_s_per_m.ravel(), worlds),
        spread_s_per_m=mean_interval(
            trials.normalised_s_per_m.std(axis=1), trials.worlds
        ),
        over_worlds_s_per_m=deviation(trials.normalised_s_per_m.mean(axis=1), seed),
        time_s=mean_interval(times, worlds),
        success_time_s=mean_interval(np.where(failed.ravel(), np.nan, times), worlds),
        failure_share=proportion(failed.ravel().astype(np.int64), worlds),
        failure_time_s=float(trials.time_s[failed].mean()) if failed.any() else None,
        easy_s=float(trials.time_s[order[:tenth]].mean()),
        hard_s=float(trials.time_s[order[-tenth:]].mean()),
    )


def _tenth(worlds: int) -> int:
    return max(
        1, round(EXTREME_SHARE * worlds)
    )  # the easiest, or the most difficult, of so many


def _steeper(found: Mapping[str, PlannerTrials], seed: int) -> Interval:
    """Return how much more the mean time rises from the easiest to the hardest tenth for DWA than for E-Band."""
    dwa, eband = (found[planner] for planner in PLANNERS)
    difficulty = (
        dwa.normalised_s_per_m.mean(axis=1) + eband.normalised_s_per_m.mean(axis=1)
    ) / 2.0
    difference = dwa.time_s.mean(axis=1) - eband.time_s.mean(axis=1)
    tenth = _tenth(len(difficulty))

    def rise(drawn: Integers) -> Floats:
        order = np.argsort(difficulty[drawn], axis=-1, kind="stable")
        ranked = np.take_along_axis(difference[drawn], order, axis=-1)
        found: Floats = ranked[..., -tenth:].mean(axis=-1) - ranked[..., :tenth].mean(
            axis=-1
        )
        return found

    return over_worlds(rise, len(difficulty), seed)


def deviation(values: Floats, seed: int) -> Interval:
    """Return the standard deviation (population) of one value per world (n,)."""
    return over_worlds(lambda drawn: values[drawn].std(axis=-1), len(values), seed)


@dataclass(frozen=True)
class MetricRow:
    """One metric over all worlds of the data set, with 95 % intervals over worlds.

    minimum, maximum: over the cells of all paths, for tortuosity over paths. corrected_mean, corrected_std: by
    the corrected formula, from which the published one (historical visibility, uneven dispersion, four axes) differs.
    """

    name: str
    title: str
    minimum: float
    maximum: float
    mean: Interval
    std: Interval
    corrected_mean: float
    corrected_std: float


@dataclass(frozen=True)
class MetricsFinding:
    """Table II of the data set, by the formula that reproduces the published numbers from the published worlds."""

    worlds: int
    rows: tuple[MetricRow, ...]


def metrics_finding(dataset: Dataset, seed: int) -> MetricsFinding:
    """Return the table of a whole data set."""
    table, corrected = (
        metrics_table(dataset, formula) for formula in (PUBLISHED, CORRECTED)
    )
    rows = []
    for metric, values in zip(METRICS, table.values.T, strict=True):
        ours, better = table.summary_of(metric), corrected.summary_of(metric)
        low, high = (
            ours.get(f"cell_{name}", ours[name]) for name in ("minimum", "maximum")
        )
        mean, std = (
            mean_interval(values, np.arange(len(values))),
            deviation(values, seed),
        )
        rows.append(
            MetricRow(
                metric.name,
                metric.title,
                low,
                high,
                mean,
                std,
                better["mean"],
                better["std"],
            )
        )
    return MetricsFinding(len(table.worlds), tuple(rows))
