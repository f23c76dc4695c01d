"""Trials in one process.

Repeatable to the last byte, and ended by every fault in its own way.
"""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import planners
import pybullet
import pytest
from mcap.reader import make_reader
from planners import Faulty, Straight, recorded
from rosbags.rosbag2 import Reader
from text_tables import rows_of

from barn_eval.results.bags.messages import PUSHED_M
from barn_eval.results.bags.recorded import read_recorded_trial
from barn_eval.results.folder import read_results
from barn_eval.results.store import BagStore
from barn_eval.running import direct
from barn_eval.running.direct import run_direct_trial
from barn_eval.running.planner_objects import PlannerObject
from barn_eval.running.pool import DirectWork, Job, run_job
from barn_eval.trials import trial
from barn_eval.trials.protocol import CHALLENGE, PAPER_2020
from barn_eval.trials.result import Outcome, from_json_line, to_json_line
from barn_eval.trials.spec import simulator_config
from barn_worlds.messages import topics
from barn_worlds.messages.cdr import deserialize, serialize

QUICK = replace(
    CHALLENGE, name="quick", limit_s=4.0, first_motion_limit_s=2.0, timeout_time_s=4.0
)


def spec_of(world, protocol=QUICK, **changes):
    return planners.spec_of(world, protocol, "straight", **changes)


@pytest.mark.parametrize("preset, frame", [("challenge", "odom"), ("paper2020", "map")])
def test_a_bag_says_in_which_frame_a_planner_follows_its_plan(
    open_world, tmp_path, preset, frame
):
    short = replace(PAPER_2020, first_motion_limit_s=0.6, clock_start_distance_m=10.0)
    recorded(
        replace(spec_of(open_world, short), planner="eband", preset=preset),
        tmp_path / "bag",
    )
    items = read_recorded_trial(tmp_path / "bag").items
    assert items[topics.COSTMAP]
    for topic in (topics.COSTMAP, topics.LOCAL_PLAN, topics.BAND):
        assert {item.frame for item in items[topic]} == {frame}


@pytest.mark.parametrize(
    "protocol", [CHALLENGE, PAPER_2020], ids=lambda rules: rules.name
)
def test_an_open_world_is_crossed(open_world, protocol):
    finished = run_direct_trial(spec_of(open_world, protocol), planner=Straight())
    result = finished.result
    assert result.outcome is Outcome.SUCCESS
    course = finished.spec.course
    apart = (
        course.start.distance(course.goal)
        - protocol.goal_distance_m
        - protocol.clock_start_distance_m
    )
    assert result.scores.traversal_time_s == pytest.approx(apart / 0.5, rel=0.05)
    assert result.measures.driven_ratio == pytest.approx(1.0, abs=0.01)
    assert result.measures.contacts == 0
    clock = result.wall_clock
    assert clock.compute_max_ms >= clock.compute_p95_ms >= clock.compute_p50_ms > 0.0
    assert from_json_line(to_json_line(result), "line") == result


def test_the_same_trial_gives_the_same_bytes(either_world, tmp_path):
    trials = [
        (spec_of(either_world), tmp_path / name / "bag") for name in ("one", "other")
    ]
    first, other = (recorded(*trial, Straight()) for trial in trials)
    for name in ("bag_0.mcap", "metadata.yaml"):
        assert (tmp_path / "one/bag" / name).read_bytes() == (
            tmp_path / "other/bag" / name
        ).read_bytes()
    assert first.result.repeatable() == other.result.repeatable()
    np.testing.assert_array_equal(first.trajectory.truth, other.trajectory.truth)


def test_recording_does_not_change_the_trial(either_world, tmp_path):
    with_bag = recorded(spec_of(either_world), tmp_path / "bag", Straight())
    without = run_direct_trial(spec_of(either_world), planner=Straight())
    np.testing.assert_array_equal(with_bag.trajectory.truth, without.trajectory.truth)
    assert with_bag.result.repeatable() == without.result.repeatable()


def test_a_planner_can_be_used_again(either_world):
    planner = Straight()
    first, second = (
        run_direct_trial(spec_of(either_world), planner=planner) for _ in range(2)
    )
    np.testing.assert_array_equal(first.trajectory.truth, second.trajectory.truth)


def test_a_trial_does_not_depend_on_its_engines_past(walled_world):
    first = run_direct_trial(spec_of(walled_world, CHALLENGE), planner=Straight())
    for number in range(10):
        with suppress(pybullet.error):
            pybullet.disconnect(number)
    again = run_direct_trial(spec_of(walled_world, CHALLENGE), planner=Straight())
    assert again.result.repeatable() == first.result.repeatable()
    np.testing.assert_array_equal(first.trajectory.truth, again.trajectory.truth)


def test_another_repetition_is_another_trial(either_world):
    first, second = (
        run_direct_trial(spec_of(either_world, repetition=k), planner=Straight())
        for k in range(2)
    )
    assert first.result.trial_id != second.result.trial_id
    assert not np.array_equal(first.trajectory.truth[:50], second.trajectory.truth[:50])


FAULTS = """
raises          | planner_died    | RuntimeError: out of ideas
raises at start | planner_died    | OSError: no such
nan             | invalid_command | command (nan m/s, 0.0 rad/s) is not finite
no decision     | planner_died    | TypeError: a planner's step must return a Decision, such as
no velocity     | planner_died    | TypeError: command must be a Velocity2D or None, got (0.5, 0.0)
no number       | planner_died    | ValueError: could not convert string to float: 'fast'
no status       | planner_died    | ValueError: 'fast' is not a valid PlannerStatus
no plan         | planner_died    | ValueError: could not convert string to float: 'fast'
nothing         | timeout         |
stops           | timeout         |
"""


@pytest.mark.parametrize("fault, outcome, detail", rows_of(FAULTS))
def test_faults_of_a_planner_are_outcomes(open_world, tmp_path, fault, outcome, detail):
    finished = recorded(spec_of(open_world), tmp_path / "bag", Faulty(fault))
    assert finished.result.outcome.value == outcome
    assert detail in finished.result.detail
    assert "\n" not in finished.result.detail
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count > 0


@pytest.mark.parametrize("fault", ["hangs", "hangs and catches"])
def test_a_planner_that_hangs_is_stopped(open_world, monkeypatch, fault):
    monkeypatch.setattr(direct, "STALL_LIMIT_S", 0.3)
    finished = run_direct_trial(spec_of(open_world), planner=Faulty(fault))
    assert finished.result.outcome is Outcome.PLANNER_STALLED
    assert "0.3 s of its own time" in finished.result.detail
    assert (
        run_direct_trial(spec_of(open_world), planner=Straight()).result.outcome
        is not Outcome.PLANNER_STALLED
    )


def test_a_process_stopped_in_a_cycle_is_the_machines_fault(open_world, monkeypatch):
    monkeypatch.setattr(direct, "STALL_LIMIT_S", 0.8)

    class Stopped(Straight):
        cycles = 0

        def step(self, observation):
            self.cycles += 1
            if self.cycles == 5:
                subprocess.Popen(
                    ["sh", "-c", f"sleep 2; kill -CONT {os.getpid()}"]
                )  # the fault that is tried
                os.kill(os.getpid(), signal.SIGSTOP)
            return super().step(observation)

    stopped, straight = (
        run_direct_trial(spec_of(open_world), planner=planner).result
        for planner in (Stopped(), Straight())
    )
    assert stopped.repeatable() == straight.repeatable()


def test_a_machine_that_stalls_for_good_is_told_from_the_planner(
    open_world, monkeypatch
):
    monkeypatch.setattr(trial, "STALLED", 0.0)
    work = DirectWork(
        BagStore(Path()),
        {"straight": PlannerObject("straight", lambda _: time.sleep(60.0))},
    )
    report = run_job(
        work, "key", "here", Job("key", (spec_of(open_world),)), lambda _: None
    )
    assert report.is_stall and not report.is_overtime
    assert "the machine stalled" in report.reason


def test_what_something_else_raises_is_not_the_planners_fault(open_world, monkeypatch):
    def break_down(*_, **__):
        raise AttributeError("'NoneType' object has no attribute 'flush'")

    jobs = []
    for name in ("Simulator", "make_planner"):
        with monkeypatch.context() as patch:
            patch.setattr(direct, name, break_down)
            job = Job("key", (planners.spec_of(open_world, QUICK),))
            work = DirectWork(BagStore(Path()))
            jobs.append(run_job(work, "key", "here", job, lambda _: None))
    assert [report.is_stall for report in jobs] == [True, False]


def test_trials_run_without_any_output(tmp_path):
    """As cron and systemd start programs, with closed descriptors."""
    words = "run --worlds 0 --planner gap --execution engine=inline --out out"
    line = ["sh", "-c", f'"$0" -m barn_eval {words} >&- 2>&-', sys.executable]
    code = subprocess.run(line, check=False, cwd=tmp_path).returncode
    (row,) = read_results(tmp_path / "out")
    assert (code, row.outcome) == (0, Outcome.SUCCESS)


def test_only_the_first_answer_has_time_to_compile(open_world, monkeypatch):
    monkeypatch.setattr(direct, "STALL_LIMIT_S", 60.0)
    monkeypatch.setattr(direct, "FIRST_LIMIT_S", 0.3)
    finished = run_direct_trial(spec_of(open_world), planner=Faulty("hangs", after=0))
    assert finished.result.outcome is Outcome.PLANNER_STALLED
    assert "no answer within 0.3 s" in finished.result.detail


def test_a_planner_that_never_moves(open_world):
    finished = run_direct_trial(spec_of(open_world), planner=Faulty("stops", after=0))
    assert (finished.result.outcome, finished.result.recoveries) == (
        Outcome.NO_FIRST_MOTION,
        20,
    )
    assert finished.result.scores.scored_time_s == QUICK.failure_time_s


def test_a_simulator_that_fails_is_an_outcome(open_world, monkeypatch):
    def fail(_self, _command, _delay_ns):
        raise ArithmeticError("the physics blew up")

    monkeypatch.setattr("barn_sim.simulator.Simulator.step", fail)
    finished = run_direct_trial(spec_of(open_world), planner=Straight())
    assert finished.result.outcome is Outcome.SIMULATOR_DIED
    assert finished.result.detail.startswith(
        "ArithmeticError: the physics blew up (test_direct.py, line "
    )


def test_a_contact_ends_the_challenge_but_not_the_papers_trial(walled_world, tmp_path):
    challenge = run_direct_trial(
        spec_of(walled_world, CHALLENGE), planner=Straight()
    ).result
    assert (challenge.outcome, challenge.measures.contacts) == (Outcome.COLLISION, 1)
    assert (
        challenge.measures.min_clearance_m < 0.02 and challenge.scores.challenge == 0.0
    )
    finished = recorded(spec_of(walled_world, PAPER_2020), tmp_path / "bag", Straight())
    paper = finished.result
    assert paper.outcome in (Outcome.SUCCESS, Outcome.TIMEOUT)
    assert paper.measures.contact_s > 0.5
    moved_m = np.hypot(*(finished.cylinders_m - walled_world.cylinders_m).T)
    assert 1 <= (moved_m > 0.05).sum() <= 30
    bag = read_recorded_trial(tmp_path / "bag")
    assert bag.scene.cylinders_m.tolist() == walled_world.cylinders_m.tolist()
    assert bag.pushed_m.tolist() == finished.cylinders_m[moved_m > PUSHED_M].tolist()


def test_every_message_decodes_with_rosbags_and_mcap(open_world, tmp_path):
    recorded(
        spec_of(open_world, replace(PAPER_2020, limit_s=3.0)),
        tmp_path / "bag",
        Straight(),
    )
    often = (
        "clock odom ground_truth/odom amcl_pose tf collision joint_states scan cmd_vel"
    )
    at_least = {
        50: often,
        20: "goal_pose",
        5: "plan local_plan band score outcome score_text",
        2: "diagnostics",
    }
    at_least[1] = "robot_description tf_static map world"
    expected = {
        f"/{name}": count for count, names in at_least.items() for name in names.split()
    }
    counts: dict[str, int] = {}
    with Reader(tmp_path / "bag") as reader:
        for connection, _, data in reader.messages():
            assert serialize(deserialize(data, connection.msgtype)) == data
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
    assert counts.keys() == expected.keys()
    assert all(counts[topic] >= count for topic, count in expected.items())
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        assert sum(
            1 for _ in make_reader(file, validate_crcs=True).iter_messages()
        ) == sum(counts.values())


def test_the_bag_tells_what_the_trial_was(either_world, tmp_path):
    finished = recorded(spec_of(either_world), tmp_path / "bag", Straight())
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        metadata = {
            record.name: record.metadata for record in make_reader(file).iter_metadata()
        }
    assert (
        '"checksum": "' + either_world.checksum
        in metadata["barn.trial"]["specification"]
    )
    assert (
        '"simulator": ' + str(finished.spec.simulator_seed)
        in metadata["barn.trial"]["specification"]
    )
    assert '"numpy"' in metadata["barn.trial"]["versions"]
    assert finished.result.outcome is (
        Outcome.COLLISION if either_world.moving else Outcome.TIMEOUT
    )
    assert (
        f'"outcome": "{finished.result.outcome.value}"'
        in metadata["barn.result"]["result"]
    )


def test_the_map_of_other_cells_is_off_like_the_pose(open_world):
    world = replace(open_world, resolution_m=0.1)
    maps = [
        spec_of(world, replace(PAPER_2020, historical_map=old)).map
        for old in (False, True)
    ]
    assert np.array_equal(maps[0].data, maps[1].data)
    assert (
        maps[1].origin_y - maps[0].origin_y
        == pytest.approx(PAPER_2020.map_offset_m())
        == -0.15
    )


def test_the_pose_is_off_with_the_map_it_was_matched_to():
    def offset(protocol, overrides=None):
        return simulator_config(protocol, overrides).localisation.offset_y_m

    protocol = replace(PAPER_2020, name="own", simulator="known_map")
    assert offset(protocol) == -0.15
    assert (
        offset(replace(protocol, historical_map=False))
        == offset(replace(protocol, map_given=False))
        == 0.0
    )
    assert offset(protocol, {"localisation.offset_y_m": 0.02}) == 0.02
