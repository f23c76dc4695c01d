"""The figures of a reproduction, on made-up trials whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from reproduce_work import made_up_results
from scipy import stats

from barn_eval.studies.intervals import deviation, line, slope_difference, split_correlation
from barn_eval.studies.reproduction import paper, run
from barn_eval.studies.reproduction.config import ReproduceConfig, chosen_worlds
from barn_eval.studies.reproduction.new_worlds import new_worlds, spread_out, transfer_campaign, transfer_finding
from barn_eval.studies.reproduction.table_ii import metrics_finding
from barn_eval.studies.reproduction.tables import FAILS, HOLDS, OPEN, above, below, contains
from barn_eval.studies.reproduction.trials import trials_by_planner, trials_finding
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.spec import simulator_config
from barn_metrics.bootstrap import Interval
from barn_metrics.report import TABLE_II
from barn_worlds.base.errors import ConfigError
from barn_worlds.worlds.dataset import open_dataset

WORLDS = "0:300:15"


@pytest.fixture(scope="module")
def results():
    """Made-up trials in twenty worlds."""
    return made_up_results(WORLDS)


@pytest.fixture(scope="module")
def found(results):
    return trials_by_planner(results, "there")


def test_worlds_are_drawn_one_from_each_part_of_their_order():
    indices = list(range(100, 400))
    chosen = chosen_worlds(indices, 40, 0)
    parts = np.array_split(np.array(indices), 40)
    assert len(chosen) == 40
    assert all(world in part for world, part in zip(chosen, parts, strict=True))
    assert chosen == chosen_worlds(indices, 40, 0) != chosen_worlds(indices, 40, 1)
    assert chosen_worlds(indices, 0, 0) == chosen_worlds(indices, 300, 0) == tuple(indices)


def test_a_line_is_that_of_all_trials_and_its_interval_covers_the_truth():
    generator = np.random.default_rng(0)
    covered = 0
    for _ in range(40):
        predicted = generator.uniform(2.0, 5.0, 20)
        measured = (
            0.5 + 0.8 * predicted[:, None] + generator.normal(0.0, 0.3, (20, 1)) + generator.normal(0, 1, (20, 5))
        )
        found = line(predicted, measured, 1)
        covered += found.slope.low <= 0.8 <= found.slope.high
    expected = stats.linregress(np.repeat(predicted, 5), measured.ravel())
    assert found.slope.estimate == pytest.approx(expected.slope, abs=1e-12)
    assert found.intercept_s_per_m.estimate == pytest.approx(expected.intercept, abs=1e-12)
    assert (found.trials, found.worlds) == (100, 20)
    assert 32 <= covered <= 40


def test_a_line_through_the_same_world_drawn_again_and_again_is_left_out():
    found = line(np.array([2.0, 3.0, 4.0]), np.array([[2.0], [3.5], [4.0]]), 0)
    assert found.slope.estimate == pytest.approx(1.0)
    assert 0.4 < found.slope.low < 1.0 < found.slope.high < 1.6
    steeper = slope_difference(np.array([1.0, 2.0, 3.0]), np.array([[2.0], [4.0], [6.0]]), np.ones((3, 1)), 0)
    assert (steeper.estimate, steeper.low, steeper.high) == pytest.approx((2.0, 2.0, 2.0))


def test_deviation_and_split_halves():
    values = np.random.default_rng(3).normal(0.0, 2.0, 400)
    found = deviation(values, 0)
    assert found.estimate == values.std() and found.low < 2.0 < found.high and found.high - found.low < 0.6
    assert found == deviation(values, 0) != deviation(values, 1)
    table = np.array([[1.0, 1.0, 9.0, 2.0], [2.0, 3.0, 5.0, 1.0], [3.0, 2.0, 1.0, 3.0], [4.0, 5.0, 0.0, 4.0]])
    splits = (((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2)))
    expected = [stats.spearmanr(table[:, a].mean(axis=1), table[:, b].mean(axis=1)).statistic for a, b in splits]
    assert split_correlation(table, 2) == pytest.approx(np.mean(expected))
    assert split_correlation(np.repeat(table[:, :1], 4, axis=1), 2) == 1.0


def test_verdicts_follow_the_interval():
    assert [above(Interval(1.0, low, high)) for low, high in ((0.1, 2.0), (-0.1, 2.0), (-2.0, -0.1), (None, None))] == [
        HOLDS,
        OPEN,
        FAILS,
        OPEN,
    ]
    assert below(Interval(-1.0, -2.0, -0.5)) == HOLDS and below(Interval(1.0, 0.5, 2.0)) == FAILS
    inside = [contains(Interval(1.0, 0.5, 2.0), value) for value in (0.4, 0.5, 1.9, 2.0, 2.1)]
    assert inside == ["no", "yes", "yes", "yes", "no"] and contains(Interval(1.0), 1.0) == "no"


def test_trials_are_counted_as_the_paper_does(results, found):
    finding = trials_finding(results, found, 0)
    for planner in paper.PLANNERS:
        own = [one for one in results if one.planner == planner]
        times = np.array([one.scores.scored_time_s for one in own])
        failed = np.array([not one.scores.success for one in own])
        one = finding.of(planner)
        assert one.trials == len(own) == 60
        assert one.normalised_s_per_m.estimate == pytest.approx(
            np.mean([r.scores.normalised_time_s_per_m for r in own])
        )
        assert one.time_s.estimate == pytest.approx(times.mean())
        assert one.success_time_s.estimate == pytest.approx(times[~failed].mean())
        assert one.failure_share.estimate == failed.mean() and one.outcomes["timeout"] == failed.sum() > 0
        assert one.failure_time_s == 30.0
        parts, published = one.parts, paper.TRIALS[planner]
        assert parts.total_s == pytest.approx(parts.successes_s + parts.share_s + parts.penalty_s)
        published_s = (1 - published.failure_share) * published.success_time_s
        published_s += published.failure_share * published.failure_time_s
        assert parts.total_s == pytest.approx(times.mean() - published_s)
        assert published_s == pytest.approx(published.time_s, abs=0.01)  # the published figures agree with each other


def test_worlds_are_ordered_by_the_mean_over_both_planners(found, results):
    rows = trials_finding(results, found, 0).worlds
    means = [row.mean_s_per_m["both"] for row in rows]
    assert means == sorted(means) and len(rows) == 20
    for row in rows:
        assert row.mean_s_per_m["both"] == pytest.approx((row.mean_s_per_m["dwa"] + row.mean_s_per_m["eband"]) / 2.0)


def test_the_trials_are_run_under_the_papers_rules():
    config = run.paper_campaign(ReproduceConfig(strata=40, seed=3))
    assert config.protocol == PAPER_2020
    assert config.simulator == simulator_config(PAPER_2020)
    assert ([one.name for one in config.planners], config.repetitions, config.seed) == (["dwa", "eband"], 5, 3)
    assert len(config.worlds.split(",")) == 40


def test_missing_trials_are_named(results):
    lacking = [one for one in results if (one.planner, one.world, one.repetition) != ("eband", 30, 1)]
    with pytest.raises(
        ConfigError, match="there: planner 'eband' lacks trial 1 of world 30; finish the campaign first"
    ):
        trials_by_planner(lacking, "there")
    with pytest.raises(ConfigError, match="planner 'eband' lacks two trials per world"):
        trials_by_planner([one for one in results if one.planner == "dwa"], "there")


def test_table_ii_is_that_of_the_data_set():
    finding = metrics_finding(open_dataset("barn300"), 0)
    assert finding.worlds == 300 and finding.regenerated is True
    for row in finding.rows:
        published = TABLE_II[row.name]
        assert row.mean.low < row.mean.estimate < row.mean.high
        assert abs(row.mean.estimate - published.mean) < 0.15 * published.std
        assert row.minimum <= row.mean.estimate <= row.maximum


def test_new_worlds_are_spread_over_the_prediction_and_kept(tmp_path):
    config = ReproduceConfig(transfer_per_set=1, transfer_worlds=3)
    worlds = new_worlds(tmp_path / "new.npz", config)
    assert len(worlds) == 12
    again = new_worlds(tmp_path / "new.npz", config)
    assert [one.checksum for one in again.values()] == [one.checksum for one in worlds.values()]
    with pytest.raises(ConfigError, match=r"new\.npz: holds other worlds than those of seed 7; use another folder"):
        new_worlds(tmp_path / "new.npz", replace(config, transfer_seed=7))
    assert spread_out({index: float(-index) for index in range(9)}, 3) == (7, 4, 1)
    with pytest.raises(ConfigError, match="at most 12, the number of new worlds, got 13"):
        spread_out(dict.fromkeys(range(12), 0.0), 13)
    ours = {one.checksum for one in worlds.values()}
    assert not ours & {open_dataset("barn300").load(index).checksum for index in range(300)}


def test_new_worlds_are_driven_without_a_map_and_with_another_sensor(tmp_path):
    config = transfer_campaign(tmp_path / "new.npz", (4, 2), ReproduceConfig())
    assert not config.protocol.map_given and config.worlds == "2,4"
    assert (config.protocol.failure_time_s, config.protocol.goal_source) == (30.0, "odometry")
    assert config.simulator.lidar.beams == 667 and config.simulator.lidar.range_max_m == 5.6
    assert config.simulator.odometry.yaw_noise_rad == 0.02 and config.simulator.localisation.mode == "exact"
    assert config.simulator.drive.command_timeout_s == 0.25  # else the paper's


def test_lines_are_those_of_the_worlds_of_the_figure(found):
    worlds = [int(world) for world in found["dwa"].worlds]
    truth = dict(zip(worlds, found["dwa"].normalised_s_per_m.mean(axis=1), strict=True))
    finding = transfer_finding(found, truth, worlds[:5], 60, 0)
    first, whole = finding.figure, finding.all_worlds
    assert first.lines["dwa"].worlds == 5 and first.lines["both"].trials == 30 and whole.lines["dwa"].worlds == 20
    assert whole.lines["dwa"].slope.estimate == pytest.approx(1.0)
    twice = transfer_finding(found, {world: 2 * value for world, value in truth.items()}, worlds[3:9], 60, 0)
    assert twice.all_worlds.lines["dwa"].slope.estimate == pytest.approx(0.5) and twice.figure.lines["dwa"].worlds == 6
    both = (whole.lines["dwa"].slope.estimate + whole.lines["eband"].slope.estimate) / 2.0
    assert whole.lines["both"].slope.estimate == pytest.approx(both)
    assert [row.world for row in finding.worlds] == sorted(worlds, key=lambda world: truth[world])
    assert {row.world for row in finding.worlds if row.in_figure} == set(worlds[:5])
    assert transfer_finding(found, truth, worlds, 60, 0).all_worlds is None
