"""How a trial stands while it runs.

What a success now would be worth, then what the verdict is.
"""

import pytest
from planners import spec_of

from barn_eval.results.bags.messages import (
    RUNNING,
    TOPICS,
    ScoreReporter,
    running_score,
)
from barn_eval.trials.referee import Referee, Standing
from barn_eval.trials.result import Outcome, score_trial
from barn_worlds.base.types import Pose2D, nanoseconds
from barn_worlds.messages.cdr import deserialize


@pytest.fixture(scope="module")
def spec():
    return spec_of(0, planner="dwa")


@pytest.fixture
def referee(spec):
    return Referee(spec.protocol, spec.course)


def read(referee, spec, time_s, forward_m, collision=False):
    odometry = Pose2D(forward_m, 0.0, 0.0)
    referee.observe(
        nanoseconds(time_s), odometry, spec.course.start @ odometry, collision
    )


def drive(referee, spec, collision=False):
    """Stand for a second, then move far enough for the clock to start."""
    read(referee, spec, 0.0, 0.0)
    read(referee, spec, 1.0, 0.0)
    read(referee, spec, 2.0, spec.protocol.clock_start_distance_m + 0.1, collision)


def messages_of(live, referee, time_s):
    taken = live.take(referee, nanoseconds(time_s))
    return {topic.path: deserialize(data, topic.type_name) for topic, data in taken}


@pytest.mark.parametrize(
    "share, worth",
    [(None, 0.5), (0.0, 0.5), (2.0, 0.5), (4.0, 0.25), (8.0, 0.125), (99.0, 0.125)],
)
def test_before_the_verdict_the_score_is_of_a_success_now(spec, share, worth):
    on_clock_s = None if share is None else share * spec.course.optimal_time_s
    assert running_score(
        Standing(None, on_clock_s, 0.0, 1.0), spec.course
    ) == pytest.approx(worth)
    assert (
        running_score(Standing(Outcome.COLLISION, on_clock_s, 0.0, 1.0), spec.course)
        == 0.0
    )


def test_twice_a_second_and_once_at_the_verdict(referee, spec):
    live = ScoreReporter(spec)
    times = []
    for step in range(41):
        read(referee, spec, 0.05 * step, 0.02 * step)
        times += [step] if messages_of(live, referee, 0.05 * step) else []
    assert times == [0, 10, 20, 30, 40]
    read(referee, spec, 2.05, 0.9, collision=True)
    messages = messages_of(live, referee, 2.05)
    assert messages.keys() == {topic.path for topic in TOPICS}
    assert (messages["/outcome"].data, messages["/score"].data) == ("collision", 0.0)
    assert messages_of(live, referee, 2.1) == messages_of(live, referee, 9.0) == {}


def test_what_is_said_in_the_scene(referee, spec):
    live = ScoreReporter(spec)
    drive(referee, spec)
    messages = messages_of(live, referee, 2.25)
    assert (messages["/outcome"].data, messages["/score"].data) == (RUNNING, 0.5)
    (marker,) = messages["/score_text"].markers
    left = f"{referee.standing.goal_distance_m:.2f} m to the goal"
    assert marker.text.split("\n") == [
        "dwa, world_0", "0.00 s on the clock", left, "0.00 s in contact", "worth 0.500 if there now"
    ]  # fmt: skip
    assert (marker.type, marker.action, marker.header.frame_id) == (9, 0, "map")
    assert (marker.header.stamp.sec, marker.header.stamp.nanosec) == (2, 250_000_000)
    assert marker.color.a == 1.0
    assert marker.scale.z > 0.1


def test_the_last_score_is_that_of_the_result(referee, spec):
    live = ScoreReporter(spec)
    drive(referee, spec)
    goal = spec.course.start.inverse() @ spec.course.goal
    verdict = referee.observe(nanoseconds(30.0), goal, spec.course.goal, False)
    messages = messages_of(live, referee, 30.0)
    assert messages["/outcome"].data == "success"
    assert (
        messages["/score"].data
        == score_trial(verdict, spec.course, spec.protocol).challenge
    )
    assert 0.0 < messages["/score"].data < 0.5
