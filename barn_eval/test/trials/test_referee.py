"""The referee: each rule on its own, then properties that hold for any readings."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from barn_eval.trials import rules
from barn_eval.trials.protocol import CHALLENGE, PAPER_2020, Course
from barn_eval.trials.referee import Referee, Standing
from barn_eval.trials.result import Outcome, Verdict
from barn_worlds.base.types import ORIGIN, Pose2D, Velocity2D

COURSE = Course(
    Pose2D(0.0, 0.0, math.pi / 2), Pose2D(0.0, 5.0, math.pi / 2), 4.5, 5.0, 2.5
)
PERIOD_NS = 50_000_000


class Reading(NamedTuple):
    """What `Referee.observe` takes."""

    stamp_ns: int
    odometry: Pose2D
    truth: Pose2D
    collision: bool


def reading(step, y, collision=False):
    """Return the readings of a robot that has driven straight to y.

    Odometry counts along its own x.
    """
    return Reading(
        step * PERIOD_NS, Pose2D(y, 0.0, 0.0), Pose2D(0.0, y, math.pi / 2), collision
    )


def judge(protocol, positions, contacts=()):
    """Return the verdict on a list of positions along the course, None if there is
    none.
    """
    referee = Referee(protocol, COURSE)
    verdicts = (
        referee.observe(*reading(step, y, step in contacts))
        for step, y in enumerate(positions)
    )
    return next((verdict for verdict in verdicts if verdict is not None), None)


def test_success_is_timed_from_the_first_motion_to_the_goal():
    positions = [0.0] * 10 + [0.05 * step for step in range(200)]
    verdict = judge(CHALLENGE, positions)
    # Motion of more than 0.1 m is first seen at 0.15 m, and 4 m is within 1 m of the
    # goal: 77 periods later.
    times_s = pytest.approx(77 * 0.05), pytest.approx((10 + 80) * 0.05)
    assert verdict == Verdict(Outcome.SUCCESS, "", *times_s, 0.0)


def test_a_protocol_that_looks_at_10_hz_sees_all_its_looks():
    looking = replace(CHALLENGE, look_period_s=0.1)
    positions = [0.0] * 10 + [0.05 * step for step in range(200)]
    verdict = judge(looking, positions)
    # 0.15 m is passed at step 13 and seen at 14; 4 m at step 90, which is a look.
    assert verdict.traversal_time_s == pytest.approx((90 - 14) * 0.05)
    touched = judge(looking, [0.0] * 10, contacts=(3,))
    assert (touched.outcome, touched.duration_s) == (
        Outcome.COLLISION,
        pytest.approx(4 * 0.05),
    )
    assert judge(looking, [0.0] * 4, contacts=(3,)) is None


def test_looks_count_from_the_first_reading():
    referee = Referee(replace(CHALLENGE, look_period_s=0.1), COURSE)
    for step in (1, 2):
        assert referee.observe(*reading(step, 0.0, collision=step == 2)) is None
    assert referee.observe(*reading(3, 0.0)).outcome is Outcome.COLLISION


def test_arrival_at_exactly_the_goal_distance_counts():
    protocol = replace(CHALLENGE, goal_distance_m=0.5)
    assert judge(protocol, [0.0, 4.4999]) is None
    assert judge(protocol, [0.0, 4.5]).outcome is Outcome.SUCCESS


def test_motion_of_exactly_the_distance_does_not_start_the_clock():
    protocol = replace(CHALLENGE, clock_start_distance_m=0.5)
    referee = Referee(protocol, COURSE)
    for step, (y, starts) in enumerate([(0.0, False), (0.5, False), (0.5000001, True)]):
        referee.observe(*reading(step, y))
        assert referee.clock_started is starts


@pytest.mark.parametrize("source", ["odometry", "truth"])
@pytest.mark.parametrize("x, y", [(0.4, 0.0), (0.0, 0.4), (-0.4, 0.0), (0.0, -0.4)])
def test_the_first_motion_may_be_in_any_direction(source, x, y):
    first = Pose2D(3.0, -2.0, 0.0)
    still = Pose2D(-1.0, 4.0, 0.0)
    for moves in ("odometry", "truth"):
        referee = Referee(
            replace(CHALLENGE, clock_start_source=source, clock_start_distance_m=0.3),
            COURSE,
        )
        for stamp_ns, pose in enumerate((first, Pose2D(first.x + x, first.y + y, 0.0))):
            referee.observe(
                stamp_ns,
                *((pose, still) if moves == "odometry" else (still, pose)),
                False,
            )
        assert referee.clock_started is (moves == source)


def test_referees_in_rows_judge_at_once():
    states = np.zeros(3, rules.STATE)
    referees = [Referee(CHALLENGE, COURSE) for _ in range(3)]
    for index, referee in enumerate(referees):
        referee.observe(*reading(0, 0.0))
        referee.move_to(states[index : index + 1])
    poses = np.array([[0.0, y, 0.0] for y in (0.0, 2.0, 4.5)])
    stamps_ns = np.full(3, 2 * PERIOD_NS)
    contacts = np.array([True, False, False])
    rules.observe(states, np.arange(2), stamps_ns, poses, poses, contacts)
    assert [judge.verdict and judge.verdict.outcome for judge in referees] == [
        Outcome.COLLISION,
        None,
        None,
    ]
    assert [judge.standing.goal_distance_m for judge in referees] == [5.0, 3.0, 5.0]
    assert referees[2].observe(*reading(1, 4.5)).outcome is Outcome.SUCCESS


@pytest.mark.parametrize("source", ["odometry", "truth"])
def test_the_goal_is_measured_by_what_the_protocol_says(source):
    referee = Referee(replace(CHALLENGE, goal_source=source), COURSE)
    referee.observe(*reading(0, 0.0))
    far = 1.0
    near = 4.5
    by_odometry = Reading(
        PERIOD_NS, Pose2D(near, 0.0, 0.0), Pose2D(0.0, far, 0.0), False
    )
    by_truth = Reading(
        2 * PERIOD_NS, Pose2D(far, 0.0, 0.0), Pose2D(0.0, near, 0.0), False
    )
    assert (referee.observe(*by_odometry) is not None) == (source == "odometry")
    assert referee.observe(*by_truth).outcome is Outcome.SUCCESS


def test_a_contact_ends_the_challenge_on_the_goal_too():
    assert judge(CHALLENGE, [0.0, 0.0], {1}).outcome is Outcome.COLLISION
    assert judge(CHALLENGE, [0.0, 2.0, 4.9], {2}).outcome is Outcome.COLLISION


def test_contact_time_counts_since_the_reading_before():
    referee = Referee(PAPER_2020, COURSE)
    for stamp_ms, collision in (
        (1000, True),
        (1100, True),
        (1300, False),
        (1700, True),
        (2500, False),
    ):
        contact_reading = reading(0, 0.0, collision)._replace(
            stamp_ns=stamp_ms * 1_000_000
        )
        assert referee.observe(*contact_reading) is None
    # 0.1 s up to the contact at 1.1 s and 0.4 s up to that at 1.7 s; before the first
    # reading nothing is known
    assert referee.standing.contact_s == pytest.approx(0.5)
    verdict = referee.fail(Outcome.PLANNER_DIED, "")
    assert (verdict.contact_s, verdict.duration_s) == (
        pytest.approx(0.5),
        pytest.approx(1.5),
    )


def test_a_contact_is_told_with_the_true_place():
    referee = Referee(CHALLENGE, COURSE)
    verdict = referee.observe(
        *Reading(0, Pose2D(7.0, 8.0, 0.0), Pose2D(1.0, -2.0, 0.0), True)
    )
    assert verdict.detail == "contact at (1.00, -2.00) m"


def test_no_first_motion():
    verdict = judge(CHALLENGE, [0.0] * 10_000)
    assert (verdict.outcome, verdict.traversal_time_s) == (
        Outcome.NO_FIRST_MOTION,
        None,
    )
    assert verdict.duration_s == CHALLENGE.first_motion_limit_s


def test_a_clock_of_no_distance_starts_with_the_goal():
    protocol = replace(CHALLENGE, clock_start_distance_m=0.0)
    verdict = judge(protocol, [0.0] * 100 + [4.5])
    assert (verdict.outcome, verdict.traversal_time_s) == (Outcome.SUCCESS, 5.0)
    verdict = judge(protocol, [0.0] * 10_000)
    assert verdict.outcome is Outcome.TIMEOUT
    assert verdict.duration_s == protocol.limit_s


@pytest.mark.parametrize("x_m, y_m", [(-2.1, 0.0), (2.1, 0.0), (0.0, -1.1)])
def test_the_edge_of_the_world_ends_a_trial(x_m, y_m):
    course = replace(COURSE, bounds_m=(-2.0, -1.0, 2.0, 6.0))
    referee = Referee(replace(CHALLENGE, edge_m=1.0), course)
    inside = Pose2D(2.0, -1.0, 0.0)
    assert referee.observe(0, inside, inside, False) is None
    outside = Pose2D(x_m, y_m, 0.0)
    verdict = referee.observe(PERIOD_NS, inside, outside, False)
    assert (verdict.outcome, verdict.fault) == (Outcome.LEFT_WORLD, "planner")
    assert verdict.detail == f"at ({x_m:.2f}, {y_m:.2f}) m, more than 1 m outside"


def test_timeout_counts_from_the_first_motion():
    verdict = judge(CHALLENGE, [0.0] * 100 + [1.0] * 10_000)
    times = (verdict.traversal_time_s, verdict.duration_s)
    assert (verdict.outcome, times) == (
        Outcome.TIMEOUT,
        (CHALLENGE.limit_s, CHALLENGE.limit_s + 5.0),
    )
    assert "4.00 m from the goal" in verdict.detail


def test_the_goal_counts_until_the_limit_and_not_after():
    steps = round(CHALLENGE.limit_s / 0.05)
    assert judge(CHALLENGE, [0.0] + [1.0] * steps + [4.5]).outcome is Outcome.SUCCESS
    assert (
        judge(CHALLENGE, [0.0] + [1.0] * (steps + 1) + [4.5]).outcome is Outcome.TIMEOUT
    )


@pytest.mark.parametrize(
    "command, message",
    [
        (Velocity2D(math.nan, 0.2), "command (nan m/s, 0.2 rad/s) is not finite"),
        (Velocity2D(0.3, math.inf), "command (0.3 m/s, inf rad/s) is not finite"),
        (
            Velocity2D(-0.6, 0.0),
            "command of -0.6 m/s is above the planner's declared speed cap of 0.5 m/s",
        ),
    ],
)
def test_a_command_that_cannot_be_given_ends_the_trial(command, message):
    referee = Referee(CHALLENGE, COURSE, 0.5)
    referee.observe(*reading(0, 0.0))
    assert referee.command(Velocity2D(0.5, 9.0)) is None
    verdict = referee.command(command)
    assert (verdict.outcome, verdict.detail) == (Outcome.INVALID_COMMAND, message)


@pytest.mark.parametrize(
    "declared_mps, command_mps, allowed",
    [
        (0.05, 0.06, False),
        (0.5, 0.5 * (1.0 + 0.95e-6), True),  # as numbers of 32 bits are rounded
        (0.5, 0.5 * (1.0 + 1e-6), True),
        (0.5, 0.5 * (1.0 + 1.05e-6), False),
    ],
)
def test_a_cap_holds_but_for_rounding(declared_mps, command_mps, allowed):
    verdict = Referee(CHALLENGE, COURSE, declared_mps).command(
        Velocity2D(command_mps, 0.0)
    )
    assert (verdict is None) is allowed


def test_any_speed_is_allowed_where_no_cap_is_declared():
    assert Referee(CHALLENGE, COURSE).command(Velocity2D(99.0, 0.0)) is None


def test_a_clock_may_stand_still_and_runs_back_one_reading():
    referee = Referee(CHALLENGE, COURSE)
    for step in (0, 2, 2):
        assert referee.observe(*reading(step, 0.0)) is None
    verdict = referee.observe(*reading(1, 0.0))
    assert verdict.outcome is Outcome.SIMULATOR_DIED
    assert "ran back from 100000000 to 50000000 ns" in verdict.detail


@pytest.mark.parametrize(
    "field, name", [("odometry", "odometry"), ("truth", "true pose")]
)
@pytest.mark.parametrize("coordinate", ["x", "y", "yaw"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_pose_that_is_no_number_is_the_simulators_fault(
    field, name, coordinate, value
):
    referee = Referee(CHALLENGE, COURSE)
    pose = replace(ORIGIN, **{coordinate: value})
    verdict = referee.observe(*reading(0, 0.0)._replace(**{field: pose}))
    assert verdict == Verdict(
        Outcome.SIMULATOR_DIED, f"the {name} is not finite", None, 0.0, 0.0
    )


def test_a_trial_that_fails_at_once_has_no_times():
    verdict = Referee(CHALLENGE, COURSE).fail(
        Outcome.PLANNER_NOT_READY, "no answer within 10 s"
    )
    assert verdict == Verdict(
        Outcome.PLANNER_NOT_READY, "no answer within 10 s", None, 0.0, 0.0
    )


def test_the_standing_stays_at_the_verdict():
    referee = Referee(replace(CHALLENGE, collision_ends_trial=False), COURSE)
    assert referee.standing == Standing(None, None, 0.0, None)
    referee.observe(*reading(20, 0.0))
    assert referee.standing == Standing(None, None, 0.0, 5.0)
    referee.observe(*reading(40, 1.0))  # starts the clock
    referee.observe(*reading(50, 2.0, collision=True))
    assert referee.standing == Standing(None, 0.5, 0.5, 3.0)
    referee.observe(*reading(60, 4.5))
    referee.observe(*reading(70, 3.0, collision=True))
    assert referee.standing == Standing(Outcome.SUCCESS, 1.0, 0.5, 0.5)


def test_the_first_verdict_stands():
    referee = Referee(CHALLENGE, COURSE)
    referee.observe(*reading(0, 0.0))
    first = referee.fail(Outcome.PLANNER_DIED, "exit code 1")
    assert referee.observe(*reading(1, 4.9, collision=True)) is first
    assert referee.command(Velocity2D(math.nan, 0.0)) is first
    assert referee.fail(Outcome.SIMULATOR_DIED, "") is first
    assert referee.verdict is first


positions = st.floats(-1.0, 6.0, allow_nan=False)
steps = st.lists(
    st.tuples(st.integers(0, 2_000_000_000), positions, st.booleans()), max_size=60
)


@settings(max_examples=300, deadline=None)
@given(
    steps=steps,
    protocol=st.sampled_from([PAPER_2020, CHALLENGE]),
    offset_ns=st.integers(0, 10**15),
)
def test_one_verdict_with_sound_times_wherever_time_begins(steps, protocol, offset_ns):
    def run(first_ns):
        referee = Referee(protocol, COURSE)
        now_ns = first_ns
        verdicts = []
        for wait_ns, y, collision in steps:
            now_ns += wait_ns
            item = Reading(now_ns, Pose2D(y, 0.0, 0.0), Pose2D(0.0, y, 0.0), collision)
            verdicts.append(referee.observe(*item))
        return verdicts

    verdicts = run(0)
    assert verdicts == run(offset_ns)
    verdict = next((item for item in verdicts if item is not None), None)
    if verdict is None:
        return
    assert all(item is verdict for item in verdicts[verdicts.index(verdict) :])
    assert 0.0 <= verdict.contact_s <= verdict.duration_s
    if verdict.traversal_time_s is None:
        assert verdict.outcome in (Outcome.NO_FIRST_MOTION, Outcome.COLLISION)
    else:
        assert 0.0 <= verdict.traversal_time_s <= verdict.duration_s
    if verdict.outcome is Outcome.SUCCESS:
        assert verdict.traversal_time_s <= protocol.limit_s
    if verdict.outcome is Outcome.TIMEOUT:
        assert verdict.traversal_time_s >= protocol.limit_s
