"""The simulator node as a process of its own, over DDS, in lockstep with this test."""

import json
import math
from contextlib import closing

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from geometry_msgs.msg import TwistStamped  # noqa: E402
from rclpy.duration import Duration  # noqa: E402
from simulator_peer import (  # noqa: E402
    TRIAL,
    Driver,
    assert_equal,
    commands,
    read,
    simulator_process,
    stamp_of,
)

from barn_sim.config import PRESETS  # noqa: E402
from barn_worlds.base.config import fields_of  # noqa: E402
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Velocity2D  # noqa: E402
from barn_worlds.messages import decode  # noqa: E402


@pytest.fixture(scope="module")
def lockstep(private_domain):
    process = simulator_process(lockstep=True, start_paused=True)
    yield process
    code, output = process.stop()
    assert code == 0
    assert "Traceback" not in output


@pytest.fixture
def peer(lockstep):
    with closing(Driver()) as driver:
        yield driver


def clocks(peer):
    return [read(decode.clock, message) for message in peer.heard["/clock"]]


@pytest.mark.parametrize("preset", ["default", "paper2020"])
def test_lockstep_equals_the_core_to_the_last_bit(peer, preset):
    config = PRESETS[preset]
    settings = {name.replace(".", "__"): value for name, _, value in fields_of(config)}
    peer.fresh_trial(**settings, **TRIAL)
    sent = commands(80)
    peer.drive(sent)
    expected = assert_equal(peer.heard, config, sent)
    assert {sensors.collision for sensors in expected} == {
        False,
        True,
    }  # so that contacts are compared as well


def test_the_clock_never_runs_back_across_a_reset(peer):
    peer.fresh_trial(**TRIAL)
    peer.drive(commands(5))
    before = clocks(peer)[-1]
    assert peer.reset().success
    peer.wait(lambda: clocks(peer)[-1] > before)
    ticks = clocks(peer)
    seconds = before // NANOSECONDS_PER_SECOND
    assert ticks[-1] == (seconds + 1) * NANOSECONDS_PER_SECOND
    assert ticks == sorted(ticks)


def test_while_paused_time_stands_still_and_is_repeated(peer):
    peer.fresh_trial(**TRIAL)
    peer.wait(lambda: len(peer.heard["/clock"]) > 2)
    assert len(set(clocks(peer))) == 1
    assert not peer.heard["/scan"]


def test_single_steps_repeat_the_last_command_and_need_a_pause(peer):
    peer.fresh_trial(drive__command_latency_s=0.0, **TRIAL)
    peer.send(Velocity2D(0.5, 0.0))
    assert peer.commands.wait_for_all_acked(Duration(seconds=600.0))
    for _ in range(20):  # longer than the watchdog would let it run
        assert peer.call("/simulator/step").success
    # on each, that of the start and one for each step
    for topic in ("/ground_truth/odom", "/scan"):
        peer.wait(lambda topic=topic: len(peer.heard[topic]) == 21)
    stamps = [stamp_of(message) for message in peer.heard["/scan"]]
    assert stamps[-1] - stamps[0] == 20 * 50_000_000
    truth = read(decode.odometry, peer.heard["/ground_truth/odom"][-1])
    assert truth.velocity.linear == pytest.approx(0.5, abs=0.01)
    peer.set(drive__command_latency_s=0.08)
    assert peer.pause(False).success
    refused = peer.call("/simulator/step")
    assert not refused.success
    assert "not paused" in refused.message


def test_values_that_are_not_allowed_are_refused_with_the_reason(peer):
    results = peer.set(lidar__beams=0, seed=-1, localisation__mode="amlc")
    assert [result.successful for result in results] == [False] * 3
    assert "beams" in results[0].reason
    assert "amcl" in results[2].reason


def test_a_failed_reset_says_why_and_changes_nothing(peer):
    peer.fresh_trial(**TRIAL)
    assert all(result.successful for result in peer.set(world=99999))
    answer = peer.reset()
    assert not answer.success
    assert "no world 99999" in answer.message
    assert "\n" not in answer.message
    peer.set(**TRIAL)
    peer.drive(commands(3))
    assert len(peer.heard["/scan"]) == 4


def test_missed_and_invalid_commands_are_counted_and_reported(peer):
    peer.fresh_trial(command_wait_s=0.05, **TRIAL)
    peer.drive([Velocity2D(0.5, 0.0), Velocity2D(math.nan, 0.0)])
    assert peer.pause(False).success
    peer.wait(lambda: len(peer.heard["/scan"]) >= 6)  # nobody answers
    status = json.loads(peer.pause(True).message)
    assert status["version"] == 1
    assert status["invalid_commands"] == 1
    assert (status["scan_subscriptions"], status["command_publishers"]) == (1, 1)
    assert status["missed_commands"] >= 3
    peer.wait(lambda: peer.is_warned("invalid commands"))
    assert "missed commands" in peer.reset().message
    peer.set(command_wait_s=5.0)


def test_stamped_commands_are_taken_as_well(lockstep):
    with closing(Driver(TwistStamped)) as peer:
        peer.fresh_trial(**TRIAL)
        peer.drive([Velocity2D(0.5, 0.0)] * 20)
        assert peer.heard["/ground_truth/odom"][-1].twist.twist.linear.x > 0.4
