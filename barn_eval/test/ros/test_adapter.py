import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from planners import spec_of
from text_tables import rows_of

from barn_eval.results.bags.decode import decode_planner_status
from barn_eval.ros.adapter import (
    TrialAdapter,
    TrialTopics,
    count_missed_periods,
    share_of_missed,
)
from barn_eval.ros.sequencer import Message, Tick
from barn_eval.trials.protocol import CHALLENGE, PoseRule
from barn_eval.trials.result import Outcome
from barn_eval.trials.trial import RunningTrial
from barn_worlds.base.types import Odometry, Pose2D, Velocity2D
from barn_worlds.messages.encode import (
    FINE,
    OdometryEncoder,
    PathEncoder,
    encode_bool,
    encode_diagnostics,
    encode_twist,
)
from barn_worlds.messages.topics import CMD_VEL

ORIGIN = 7_000_000_000
PERIOD = 50_000_000
SILENCE = 500_000_000
AHEAD = replace(
    CHALLENGE, start=PoseRule(yaw_rad=0.0), goal=PoseRule(x_m=10.0, yaw_rad=0.0)
)
TOPICS = TrialTopics(
    "/clock", "/odom", "/truth", "/collision", "/cmd_vel", "/scan", "/diagnostics"
)
ODOMETRY = OdometryEncoder("odom", "base_link")


def message(topic, value, sent_ns):
    """Return a message: of odometry, the stamp and x; of a command, its two speeds.

    Of diagnostics, the status.
    """
    if topic in ("/odom", "/truth"):
        stamp_ns, x = value
        return Message(
            topic,
            ODOMETRY.encode(
                Odometry(stamp_ns, Pose2D(x, 0.0, 0.0), Velocity2D()), stamp_ns
            ),
            sent_ns,
        )
    encoders = {
        "/collision": encode_bool,
        "/cmd_vel": lambda speeds: encode_twist(Velocity2D(*speeds)),
        "/diagnostics": lambda status: encode_diagnostics(
            7, FINE, "planner", status, {"status": status}
        ),
    }
    return Message(topic, encoders[topic](value) if topic in encoders else b"", sent_ns)


def adapter_of(**changes):
    """Return an adapter of a trial under the rules of the challenge, but for some
    changes, with 10 m straight ahead.
    """
    return TrialAdapter(
        TOPICS,
        RunningTrial(spec_of(0, replace(AHEAD, **changes))),
        ORIGIN,
        CMD_VEL.type_name,
    )


@pytest.fixture
def adapter():
    return adapter_of()


def tick(k, x, *, odometry_x=None, collision=False, command=(0.5, 0.0), extra=()):
    stamp = ORIGIN + k * PERIOD
    content = [
        ("/odom", [stamp, x if odometry_x is None else odometry_x]),
        ("/truth", [stamp, x]),
    ]
    content += [("/collision", collision), ("/scan", 0)]
    content += [("/cmd_vel", command)] if command else []
    content += extra
    return Tick(stamp, k, [message(topic, value, k) for topic, value in content])


def test_time_is_that_of_the_last_tick_or_of_the_beginning(adapter):
    assert adapter.now_ns == ORIGIN
    adapter.take(tick(3, 0.0))
    assert adapter.now_ns == ORIGIN + 3 * PERIOD


def test_readings_and_commands_pair_up_as_in_a_direct_trial(adapter):
    for k in range(5):
        reading = adapter.take(tick(k, 0.03 * k, command=(0.1 * k, 0.2)))
        assert [message.topic for message in reading] == [
            "/odom",
            "/truth",
            "/collision",
            "/scan",
            "/cmd_vel",
        ]
    trajectory = adapter.trial.log.trajectory()
    assert trajectory.stamps_ns.tolist() == [k * PERIOD for k in range(5)]
    assert trajectory.truth[:, 0].tolist() == [0.03 * k for k in range(5)]
    assert trajectory.command[:, 0].tolist() == [0.1 * k for k in range(5)]
    assert adapter.trial.verdict is None


@pytest.mark.parametrize(
    "frame, expected", [("/odom", [math.nan, 0.2, 0.2]), ("map", [math.nan] * 3)]
)
def test_a_plan_counts_from_the_next_reading_in_its_frame(adapter, frame, expected):
    plan = Message(
        "/plan",
        PathEncoder(frame).encode(np.array([[-1.0, 0.2], [9.0, 0.2]]), ORIGIN),
        0,
    )
    for k in range(3):
        message = tick(k, 0.05 * k)
        message.messages.insert(4, plan)  # before the command
        adapter.take(message)
    trajectory = adapter.trial.log.trajectory()
    np.testing.assert_allclose(trajectory.off_plan_m, expected)
    adapter.take(tick(3, 0.15, extra=[("/plan", "no plan")]))
    assert adapter.trial.verdict is None


def test_only_the_simulator_publishes_the_time_and_all_readings():
    assert TOPICS.of_simulator == ("/clock", "/scan", "/odom", "/truth", "/collision")


def test_nothing_after_the_verdict_is_kept(adapter):
    adapter.take(tick(0, 0.0))
    adapter.take(tick(1, 0.5))
    reading = adapter.take(tick(2, 9.5, extra=[("/plan", 1)]))
    assert [message.topic for message in reading] == [
        "/odom",
        "/truth",
        "/collision",
        "/scan",
        "/plan",
    ]
    assert adapter.take(tick(3, 9.9)) == []
    verdict = adapter.trial.verdict
    assert (verdict.outcome, verdict.traversal_time_s) == (
        Outcome.SUCCESS,
        pytest.approx(0.05),
    )
    assert verdict.duration_s == pytest.approx(0.1)


def test_odometry_and_true_pose_are_kept_apart(adapter):
    for k, x in enumerate((0.0, 5.0, 9.5)):
        adapter.take(tick(k, x, odometry_x=0.0))
    assert adapter.trial.verdict.outcome is Outcome.SUCCESS
    other = adapter_of(clock_start_source="odometry", goal_source="odometry")
    for k, x in enumerate((0.0, 5.0, 9.5)):
        other.take(tick(k, 0.0, odometry_x=x))
    assert other.trial.verdict.outcome is Outcome.SUCCESS


def test_two_readings_in_one_tick_are_judged_one_by_one(adapter):
    # a clock that ticks less often than the robot is measured
    first = tick(0, 0.0, command=None)
    second = tick(1, 0.2)
    adapter.take(Tick(ORIGIN, 0, first.messages + second.messages))
    assert adapter.trial.log.trajectory().stamps_ns.tolist() == [0, PERIOD]
    adapter.take(tick(2, 9.5))
    assert adapter.trial.verdict.traversal_time_s == pytest.approx(0.05)


@pytest.mark.parametrize(
    "command", [(0.5, 0.0), None], ids=["with a command", "without one"]
)
def test_a_contact_counts_for_the_tick_it_was_told_in_alone(command):
    patient = adapter_of(collision_ends_trial=False)
    for k, collision in enumerate((False, True, False, False)):
        patient.take(tick(k, 0.0, collision=collision, command=command))
    assert patient.trial.log.trajectory().contact.tolist() == [
        False,
        True,
        False,
        False,
    ]


def test_ticks_without_readings_end_nothing(adapter):
    # a clock that ticks more often than the robot is measured
    adapter.take(Tick(ORIGIN, 0, []))
    adapter.take(tick(1, 0.0))
    adapter.take(Tick(ORIGIN + PERIOD + 1, 1, [message("/collision", True, 1)]))
    adapter.take(tick(2, 0.0))
    assert adapter.trial.verdict.outcome is Outcome.COLLISION


def test_response_time_is_from_scan_to_first_command(adapter):
    sent_ms = [
        ("/scan", 1),
        ("/cmd_vel", 4),
        ("/cmd_vel", 9),
        ("/cmd_vel", 55),
        ("/scan", 100),
        ("/cmd_vel", 105),
    ]
    sent_ms += [("/scan", 200), ("/cmd_vel", 199)]  # clocks may be told to say anything
    adapter.take(
        Tick(
            ORIGIN,
            0,
            [
                message(topic, (0.1, 0.0), 1_000_000 * now_ms)
                for topic, now_ms in sent_ms
            ],
        )
    )
    assert adapter.response_times_s == [0.003, 0.005, 0.0]
    assert adapter.waited_s == pytest.approx(0.008)


@pytest.mark.parametrize(
    "statuses, count",
    [
        ([""], None),
        (["recovering"], 1),
        (["running", "recovering", "recovering", "", "running", "recovering"], 2),
    ],
)
def test_recoveries_are_counted_when_they_begin(adapter, statuses, count):
    for k, status in enumerate(statuses):
        adapter.take(tick(k, 0.0, extra=[("/diagnostics", status)]))
    assert adapter.trial.recoveries == count


def test_a_planner_reports_its_status_and_nobody_else_does():
    values = {"cost": "1.5", "status": "recovering"}
    assert (
        decode_planner_status(
            encode_diagnostics(7, FINE, "planner", "recovering", values)
        )
        == "recovering"
    )
    assert (
        decode_planner_status(
            encode_diagnostics(7, FINE, "battery", "full", {"voltage": "24"})
        )
        == ""
    )
    assert decode_planner_status(b"not a message") == ""


# When commands came and what time it is, in ms; how many were missed, and which share.
PERIODS = """
                                      | 500  | 0 | 0      | it has not begun
100 150 200 250 300                   | 300  | 0 | 0      | all came
100 160 190 260 300                   | 300  | 0 | 0      | half a period late or early
100 150 240 300                       | 300  | 1 | 1/4    | one is missing
100 150 350                           | 350  | 3 | 3/5    | three are missing
100 175 251                           | 251  | 1 | 50/151 | no more than half a period
100 150                               | 300  | 2 | 1/2    | and none since
100 600                               | 600  | 9 | 9/10   | the longest time without counts
100                                   | 150  | 0 | 0      | one came
100                                   | 147  | 0 | 0      | not a period yet
100 150 200 900 950 1000 1050 1100    | 1100 | 0 | 0      | it has waited
100 120 140 160 180 200               | 200  | 0 | 0      | faster than it has to be
"""


@pytest.mark.parametrize("case", rows_of(PERIODS), ids=lambda cells: cells[-1])
def test_control_periods_without_a_command_are_counted(case):
    commands_ms, now_ms, missed, share, _ = case
    commands_ns = [1_000_000 * int(word) for word in commands_ms.split()]
    now_ns = 1_000_000 * int(now_ms)
    count = count_missed_periods(commands_ns, now_ns, PERIOD, SILENCE)
    assert count == int(missed)
    expected = pytest.approx(float(Fraction(share)))
    assert share_of_missed(count, commands_ns, now_ns, PERIOD) == expected
    is_counting = bool(commands_ns) and now_ns - commands_ns[0] >= PERIOD
    assert share_of_missed(1000, commands_ns, now_ns, PERIOD) == float(is_counting)


def test_a_planner_that_skips_cycles_is_seen_to(adapter):
    for k in range(21):
        adapter.take(tick(k, 0.01 * k, command=None if k % 5 == 4 else (0.2, 0.0)))
    assert (
        count_missed_periods(adapter.commands_ns, adapter.now_ns, PERIOD, SILENCE) == 4
    )
    assert share_of_missed(
        4, adapter.commands_ns, adapter.now_ns, PERIOD
    ) == pytest.approx(0.2)
