"""The figures of a reproduction, on made-up trials whose truth is known."""

from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from refusals import refused
from reproduce_work import experiment_of, invent_result

from barn_eval.studies.reproduction.findings import (
    ReproduceConfig,
    draw_worlds,
    paper_run,
)
from barn_eval.studies.reproduction.page import (
    FAILS,
    HOLDS,
    OPEN,
    PAPER,
    above,
    contains,
)
from barn_eval.studies.reproduction.trials import (
    PLANNERS,
    deviation,
    group_trials,
    judge_model,
    summarize_metrics,
    summarize_trials,
)
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.spec import simulator_config
from barn_metrics.bootstrap import Interval
from barn_metrics.report import TABLE_II
from barn_worlds.datasets.dataset import open_dataset

WORLDS = "0:300:15"


@pytest.fixture(scope="module")
def results():
    """Made-up trials in twenty worlds."""
    return [invent_result(spec) for spec in experiment_of(WORLDS).trials()]


@pytest.fixture(scope="module")
def finding(results):
    return summarize_trials(group_trials(results, "there"), 0)


def test_worlds_are_drawn_one_from_each_part_of_their_order():
    indices = list(range(100, 400))
    sample = draw_worlds(indices, 40, 0)
    parts = np.array_split(np.array(indices), 40)
    assert len(sample) == 40
    assert all(world in part for world, part in zip(sample, parts, strict=True))
    assert sample == draw_worlds(indices, 40, 0) != draw_worlds(indices, 40, 1)
    assert draw_worlds(indices, 0, 0) == draw_worlds(indices, 300, 0) == tuple(indices)


def test_deviation():
    values = np.random.default_rng(3).normal(0.0, 2.0, 400)
    estimate = deviation(values, 0)
    assert (
        estimate.estimate == values.std()
        and estimate.low < 2.0 < estimate.high
        and estimate.high - estimate.low < 0.6
    )
    assert estimate == deviation(values, 0) != deviation(values, 1)


def test_verdicts_follow_the_interval():
    limits = [(0.1, 2.0), (-0.1, 2.0), (-2.0, -0.1), (None, None)]
    assert [above(Interval(1.0, low, high)) for low, high in limits] == [
        HOLDS,
        OPEN,
        FAILS,
        OPEN,
    ]
    inside = [
        contains(Interval(1.0, 0.5, 2.0), value) for value in (0.4, 0.5, 1.9, 2.0, 2.1)
    ]
    assert (
        inside == ["no", "yes", "yes", "yes", "no"]
        and contains(Interval(1.0), 1.0) == "no"
    )


def test_trials_are_counted_as_the_paper_does(results, finding):
    for planner in PLANNERS:
        rows = [result for result in results if result.planner == planner]
        times = np.array([result.scores.scored_time_s for result in rows])
        failed = np.array([not result.scores.success for result in rows])
        result = finding.of(planner)
        assert result.trials == len(rows) == 60
        per_m = np.mean([trial.scores.normalised_time_s_per_m for trial in rows])
        means = [
            figure.estimate
            for figure in (
                result.normalised_s_per_m,
                result.time_s,
                result.success_time_s,
            )
        ]
        assert means == pytest.approx([per_m, times.mean(), times[~failed].mean()])
        assert (
            result.failure_share.estimate == failed.mean()
            and result.outcomes["timeout"] == failed.sum() > 0
        )
        assert result.failure_time_s == 30.0
        published = PAPER["trials"][planner]
        failed_s = 30.0 * published["failures_30_s"] + 50.0 * published["failures_50_s"]
        succeeded = (
            published["trials"]
            - published["failures_30_s"]
            - published["failures_50_s"]
        )
        published_s = (succeeded * published["success_time_s"] + failed_s) / published[
            "trials"
        ]
        assert published_s == pytest.approx(
            published["time_s"], abs=0.01
        )  # they agree with each other


def test_worlds_are_ordered_by_the_mean_over_both_planners(finding):
    rows = finding.worlds
    means = [row.mean_s_per_m["both"] for row in rows]
    assert means == sorted(means) and len(rows) == 20
    for row in rows:
        assert row.mean_s_per_m["both"] == pytest.approx(
            (row.mean_s_per_m["dwa"] + row.mean_s_per_m["eband"]) / 2.0
        )


def test_the_trials_are_run_under_the_papers_rules():
    config = paper_run(ReproduceConfig(strata=40, seed=3))
    assert (config.protocol, config.simulator) == (
        PAPER_2020,
        simulator_config(PAPER_2020),
    )
    assert (
        [choice.name for choice in config.planners],
        config.repetitions,
        config.seed,
    ) == (["dwa", "eband"], 5, 3)
    assert len(config.worlds.split(",")) == 40


def test_missing_trials_are_named(results):
    lacking = [
        result
        for result in results
        if (result.planner, result.world, result.repetition) != ("eband", 30, 1)
    ]
    with refused(
        "there: planner 'eband' lacks trial 1 of world 30; finish the run first"
    ):
        group_trials(lacking, "there")
    with refused("planner 'eband' lacks two trials per world"):
        group_trials([result for result in results if result.planner == "dwa"], "there")


def test_a_model_is_judged_by_what_both_planners_needed(finding):
    class Shifted:
        """A model that knows the difficulty up to a constant."""

        about: ClassVar = {}
        difficulty: ClassVar = {
            row.world: row.mean_s_per_m["both"] for row in finding.worlds
        }

        def predict(self, world):
            return SimpleNamespace(difficulty_s_per_m=self.difficulty[world] + 0.5)

    dataset = SimpleNamespace(load=lambda number: number)
    errors = judge_model(Shifted(), dataset, finding.worlds, 0)
    assert errors.mse.estimate == pytest.approx(0.25)
    assert errors.mae.estimate == pytest.approx(0.5)
    assert errors.r2.estimate == pytest.approx(1.0 - 0.25 / errors.variance)
    assert errors.r2.low < errors.r2.estimate < errors.r2.high
    assert errors.spearman.estimate == pytest.approx(1.0)


def test_table_ii_is_that_of_the_data_set():
    finding = summarize_metrics(open_dataset("barn300"), 0)
    assert finding.worlds == 300
    for row in finding.rows:
        published = TABLE_II[row.name]
        assert row.mean.low < row.mean.estimate < row.mean.high
        assert abs(row.mean.estimate - published["mean"]) < 0.15 * published["std"]
        assert row.minimum <= row.mean.estimate <= row.maximum
