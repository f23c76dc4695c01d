"""Scores against the rules of the paper and of the challenge, and seeds."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from barn_eval.trials.protocol import CHALLENGE, PAPER_2020, Course
from barn_eval.trials.result import Outcome, Scores, Verdict, score_trial
from barn_eval.trials.seeds import planner_seed, simulator_seed
from barn_worlds.base.types import ORIGIN, Pose2D

COURSE = Course(ORIGIN, Pose2D(0.0, 5.0, 0.0), 4.5, 10.0, 5.0)


def verdict(outcome, time_s):
    return Verdict(outcome, "", time_s, 60.0, 0.0)


def test_an_outcome_is_told_in_words():
    assert Outcome.NO_FIRST_MOTION.words == "no first motion"


@pytest.mark.parametrize(
    "time_s, metric, metric_2022",
    [
        (1.0, 0.5, 0.25),
        (10.0, 0.5, 0.25),
        (20.0, 0.25, 0.25),
        (25.0, 0.2, 0.2),
        (40.0, 0.125, 0.125),
        (90.0, 0.125, 0.125),
    ],
)
def test_the_challenge_metric_is_clipped(time_s, metric, metric_2022):
    scored = score_trial(verdict(Outcome.SUCCESS, time_s), COURSE, CHALLENGE)
    assert (scored.challenge, scored.challenge_2022) == pytest.approx(
        (metric, metric_2022)
    )


def test_scores_hold_what_the_verdict_and_the_course_say():
    scores = score_trial(
        Verdict(Outcome.SUCCESS, "", 20.0, 60.0, 0.0), COURSE, PAPER_2020
    )
    assert scores == Scores(
        success=True,
        traversal_time_s=20.0,
        scored_time_s=20.0,
        duration_s=60.0,
        path_length_m=4.5,
        normalised_time_s_per_m=pytest.approx(20.0 / 4.5),
        optimal_time_s=5.0,
        challenge=0.25,
        challenge_2022=0.25,
        failure_time_s=30.0,
    )


def test_a_success_without_a_time_counts_as_a_failure():
    scored = score_trial(verdict(Outcome.SUCCESS, None), COURSE, PAPER_2020)
    assert (scored.scored_time_s, scored.challenge) == (PAPER_2020.failure_time_s, 0.0)


@pytest.mark.parametrize(
    "outcome, blamed, fault",
    [
        (Outcome.SUCCESS, "planner", ""),
        (Outcome.COLLISION, "", "planner"),
        (Outcome.SIMULATOR_DIED, "", "simulator"),
        (Outcome.ENVIRONMENT_FAILED, "", "environment"),
        (Outcome.INTERFERENCE, "environment", "environment"),
    ],
)
def test_who_failed_follows_from_the_outcome_unless_it_is_known(outcome, blamed, fault):
    assert replace(verdict(outcome, 9.0), culprit=blamed).fault == fault


def test_before_times_were_clipped_the_metric_had_no_limit():
    rules = replace(CHALLENGE, clipped=False)
    metrics = [
        score_trial(verdict(Outcome.SUCCESS, time_s), COURSE, rules).challenge
        for time_s in (0.05, 90.0)
    ]
    assert metrics == pytest.approx([5.0 / 0.05, 5.0 / 90.0])


@pytest.mark.parametrize(
    "outcome, time_s, least_time_s, efficiency",
    [
        (Outcome.SUCCESS, 0.08, 0.06, 0.75),
        (Outcome.SUCCESS, 20.0, None, None),
        (Outcome.SUCCESS, 0.0, 6.0, 1.0),
        (Outcome.COLLISION, 20.0, 6.0, 0.0),
    ],
)
def test_efficiency_is_the_least_time_by_that_of_a_success(
    outcome, time_s, least_time_s, efficiency
):
    scored = score_trial(verdict(outcome, time_s), COURSE, CHALLENGE, least_time_s)
    assert (scored.efficiency, scored.least_time_s) == (
        efficiency and pytest.approx(efficiency),
        least_time_s,
    )


@pytest.mark.parametrize(
    "outcome, counted_s", [(Outcome.TIMEOUT, 50.0), (Outcome.COLLISION, 30.0)]
)
def test_a_timeout_may_count_with_more_than_another_failure(outcome, counted_s):
    scored = score_trial(
        verdict(outcome, 12.0), COURSE, replace(PAPER_2020, timeout_time_s=50.0)
    )
    assert (scored.scored_time_s, scored.failure_time_s) == (counted_s, 50.0)


@pytest.mark.parametrize(
    "outcome", [outcome for outcome in Outcome if outcome is not Outcome.SUCCESS]
)
def test_only_a_success_earns_the_challenge_metric(outcome):
    scores = score_trial(verdict(outcome, 12.0), COURSE, CHALLENGE)
    assert (scores.success, scores.challenge, scores.challenge_2022) == (
        False,
        0.0,
        0.0,
    )


@pytest.mark.parametrize(
    "outcome, time_s, counted_s",
    [
        (Outcome.SUCCESS, 9.0, 9.0),
        (Outcome.PLANNER_DIED, 9.0, 30.0),
        (Outcome.NO_FIRST_MOTION, None, 30.0),
        (Outcome.TIMEOUT, 50.0, 30.0),
    ],
)
def test_the_paper_counts_a_failure_as_30_s(outcome, time_s, counted_s):
    scored = score_trial(verdict(outcome, time_s), COURSE, PAPER_2020)
    assert (scored.scored_time_s, scored.traversal_time_s) == (counted_s, time_s)
    assert scored.normalised_time_s_per_m == pytest.approx(counted_s / 4.5)


def test_seeds_depend_on_what_a_trial_is_and_on_nothing_else():
    assert simulator_seed(0, 1, 2) == simulator_seed(0, 1, 2)
    everything = {
        simulator_seed(seed, world, repetition)
        for seed in range(4)
        for world in range(40)
        for repetition in range(5)
    }
    assert len(everything) == 4 * 40 * 5
    planners = {
        planner_seed(0, world, 0, planner)
        for world in range(40)
        for planner in ("dwa", "eband", "mppi")
    }
    assert len(planners) == 120
    assert not everything & planners


@given(
    seed=st.integers(0, 2**62),
    world=st.integers(0, 10**6),
    repetition=st.integers(0, 98),
)
def test_seeds_fit_every_generator(seed, world, repetition):
    assert 0 <= simulator_seed(seed, world, repetition) < 2**32
    assert 0 <= planner_seed(seed, world, repetition, "dwa") < 2**32


def test_seeds_never_change():
    """Recorded results are only repeatable while these stay what they are."""
    assert [simulator_seed(0, 0, 0), simulator_seed(1, 2, 3)] == [
        2247579044,
        1874683313,
    ]
    assert [planner_seed(0, 0, 0, "dwa"), planner_seed(1, 2, 3, "dwa")] == [
        572186411,
        1751269472,
    ]
