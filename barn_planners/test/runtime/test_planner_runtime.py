"""What a planner's node does with readings: which become an observation, and tasks, readiness, what is sent."""

import itertools
import math

import numpy as np
import pytest

from barn_planners.interface import Decision, Observation, Planner, PlannerStatus
from barn_planners.registry import make_planner
from barn_planners.runtime.planner_runtime import PlannerRuntime, goal_problem
from barn_planners.runtime.synchronizer import SyncConfig, Synchronizer
from barn_worlds.base.types import (
    STOP,
    OccupancyMap,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
)

GOAL = Pose2D(3.0, 0.0, 0.0)
MS = 1_000_000
FORWARD = Velocity2D(0.3, 0.1)


class Scripted(Planner):
    def __init__(self, *decisions: Decision):
        self.decisions, self.tasks = list(decisions), []

    def start(self, task, seed) -> None:
        self.tasks.append((task, seed))

    def step(self, observation) -> Decision:
        return self.decisions.pop(0) if self.decisions else Decision(FORWARD)


def at(seconds: float) -> Observation:
    stamp = round(seconds * 1e9)
    scan = Scan(stamp, np.ones(3, np.float32), 0.0, 0.1, 0.1, 30.0)
    return Observation(
        stamp, Odometry(stamp, Pose2D(0.0, 0.0, 0.0), STOP), scan, Pose2D(0.0, 0.0, 0.0)
    )


def static_map(value: int = 0) -> OccupancyMap:
    return OccupancyMap(np.full((3, 3), value, np.int8), 0.15, 0.0, 0.0)


def runtime(*decisions: Decision, use_map: bool = False, **kwargs) -> PlannerRuntime:
    return PlannerRuntime(Scripted(*decisions), seed=5, use_map=use_map, **kwargs)


def test_before_the_goal_the_robot_stands():
    each = runtime()
    assert each.step(at(0.0)).command == STOP and each.missing() == "no goal yet"
    assert each.set_goal(GOAL) and each.missing() == ""
    assert each.step(at(0.05)).command == FORWARD
    assert each.planner.tasks[0][0].goal == GOAL and each.planner.tasks[0][1] == 5


@pytest.mark.parametrize("map_first", [True, False])
def test_with_a_map_both_must_have_come(map_first):
    each = runtime(use_map=True)
    assert each.missing() == "no goal yet, no map yet"
    first = (each.set_map, static_map())
    second = (each.set_goal, GOAL)
    for call, argument in (first, second) if map_first else (second, first):
        assert each.step(at(0.0)).command == STOP and not each.planner.tasks
        call(argument)
    assert each.missing() == "" and len(each.planner.tasks) == 1
    assert each.planner.tasks[0][0].map.data.shape == (3, 3)


def test_an_equal_task_changes_nothing_another_restarts():
    each = runtime(use_map=True)
    each.set_map(static_map())
    each.set_goal(GOAL)
    assert not each.set_goal(Pose2D(3.0, 0.0, 0.0)) and not each.set_map(static_map())
    assert len(each.planner.tasks) == 1
    assert each.set_goal(Pose2D(3.0, 0.5, 0.0)) and each.set_map(static_map(100))
    assert len(each.planner.tasks) == 3


def test_an_equal_goal_restarts_only_after_end_and_pause():
    done = Decision(STOP, PlannerStatus.GOAL_REACHED)
    each = runtime(
        Decision(FORWARD), done, *[Decision(STOP, PlannerStatus.GOAL_REACHED)] * 100
    )
    each.set_goal(GOAL)
    for k in range(20):
        each.step(at(0.1 * k))
        assert not each.set_goal(GOAL), "sent again all the time it is a repetition"
    each.step(at(4.0))
    assert each.set_goal(GOAL)


def test_a_cycle_without_command_repeats_or_sends_nothing():
    decisions = [Decision(None), Decision(FORWARD), Decision(None)]
    repeating = runtime(*decisions)
    silent = runtime(*decisions, repeat_command=False)
    for each in (repeating, silent):
        each.set_goal(GOAL)
    assert [repeating.step(at(k)).command for k in range(3)] == [
        STOP,
        FORWARD,
        FORWARD,
    ]
    assert [silent.step(at(k)).command for k in range(3)] == [None, FORWARD, None]


def test_reset_forgets_goal_map_and_task():
    each = runtime(use_map=True)
    each.set_map(static_map())
    each.set_goal(GOAL)
    each.reset()
    assert (
        each.missing() == "no goal yet, no map yet"
        and each.step(at(0.0)).command == STOP
    )
    each.set_map(static_map())
    assert each.set_goal(GOAL)


def test_a_goal_in_another_frame_or_not_a_number_is_refused():
    assert (
        goal_problem(GOAL, "odom", "odom") == ""
        and goal_problem(GOAL, "/odom", "odom") == ""
    )
    assert "in frame 'map'" in goal_problem(GOAL, "map", "odom")
    assert "not a number" in goal_problem(Pose2D(math.nan, 0.0, 0.0), "odom", "odom")


@pytest.mark.parametrize("use_map", [True, False])
def test_warming_up_leaves_no_trace(use_map):
    warm, cold = (
        PlannerRuntime(make_planner("dwa"), seed=0, use_map=use_map) for _ in range(2)
    )
    warm.warm_up()
    warm.reset()
    answers = []
    for each in (warm, cold):
        each.set_goal(GOAL)
        each.set_map(OccupancyMap(np.zeros((60, 60), np.int8), 0.15, -4.5, -4.5))
        answers.append([each.step(at(0.05 * k)).command for k in range(5)])
    assert answers[0] == answers[1]


def odometry(ms: int) -> Odometry:
    return Odometry(ms * MS, Pose2D(ms / 1000.0, 0.0, 0.0), STOP)


def scan(ms: int) -> Scan:
    return Scan(ms * MS, np.ones(3, np.float32), 0.0, 0.1, 0.1, 30.0)


def feed(sync: Synchronizer, *readings: tuple[str, int]):
    """Feed readings in order and return (index of the reading, scan ms, odometry ms, pose x) of each observation."""
    observations = []
    for index, (kind, ms) in enumerate(readings):
        if kind == "odom":
            results = [sync.add_odometry(odometry(ms))]
        elif kind == "pose":
            results = [sync.add_pose(ms * MS, Pose2D(100.0 + ms / 1000.0, 0.0, 0.0))]
        else:
            results = sync.add_scan(scan(ms))
        for each in results:
            if each is not None:
                assert each.stamp_ns == each.scan.stamp_ns
                observations.append(
                    (
                        index,
                        each.stamp_ns // MS,
                        each.odometry.stamp_ns // MS,
                        each.pose.x,
                    )
                )
    return observations


def test_in_lockstep_equal_stamps_meet_in_any_order():
    for order in itertools.permutations(["odom", "pose", "scan"]):
        sync = Synchronizer(SyncConfig(), use_pose=True)
        readings = [(kind, ms) for ms in (0, 50, 100) for kind in order]
        assert feed(sync, *readings) == [
            (2, 0, 0, 100.0),
            (5, 50, 50, 100.05),
            (8, 100, 100, 100.1),
        ]


def test_without_a_map_the_pose_is_that_of_the_odometry():
    sync = Synchronizer(SyncConfig(), use_pose=False)
    assert feed(sync, ("scan", 50), ("odom", 50)) == [(1, 50, 50, 0.05)]


def test_odometry_between_scans_is_taken_from_before():
    sync = Synchronizer(SyncConfig(), use_pose=False)
    assert feed(sync, ("odom", 35), ("scan", 50), ("odom", 55)) == [(2, 50, 35, 0.035)]
    later = feed(sync, ("scan", 100), ("odom", 95), ("scan", 150), ("odom", 155))
    assert [(stamp, used) for _, stamp, used, _ in later] == [(100, 55), (150, 95)], (
        "no more waiting once let down"
    )


def test_a_source_that_matches_again_is_waited_for_again():
    sync = Synchronizer(SyncConfig(), use_pose=False)
    feed(sync, ("odom", 35), ("scan", 50), ("odom", 55))
    assert [item[0] for item in feed(sync, ("odom", 100), ("scan", 100))] == [1]
    assert feed(sync, ("scan", 150), ("odom", 150)) == [(1, 150, 150, 0.15)]


def test_a_scan_with_lost_odometry_is_used_with_the_next():
    sync = Synchronizer(SyncConfig(), use_pose=False)
    assert feed(sync, ("odom", 0), ("scan", 0), ("scan", 50), ("scan", 100))[-2:] == [
        (3, 50, 0, 0.0),
        (3, 100, 0, 0.0),
    ]


@pytest.mark.parametrize("age, count", [(0.1, 2), (1.0, 4)])
def test_odometry_that_is_too_old_is_not_used(age, count):
    sync = Synchronizer(SyncConfig(odometry_age_s=age), use_pose=False)
    observations = feed(
        sync,
        ("odom", 0),
        ("scan", 0),
        ("scan", 100),
        ("scan", 200),
        ("scan", 300),
        ("scan", 400),
    )
    assert len(observations) >= count
    assert max(stamp for _, stamp, _, _ in observations) == (100 if age == 0.1 else 400)
    if age == 0.1:
        assert sync.missing == "no odometry of the last 0.1 s" and sync.skipped == 2


def test_seldom_localisation_is_carried_on_by_odometry():
    sync = Synchronizer(SyncConfig(), use_pose=True)
    observations = feed(
        sync,
        ("odom", 0),
        ("pose", 0),
        ("scan", 0),
        ("odom", 50),
        ("scan", 50),
        ("odom", 100),
        ("scan", 100),
    )
    assert observations[0][1:] == (0, 0, 100.0)
    assert [stamp for _, stamp, _, _ in observations] == [0, 50, 100]
    assert observations[1][3] == pytest.approx(100.05) and observations[2][
        3
    ] == pytest.approx(100.1)


def test_what_is_missing_is_said():
    sync = Synchronizer(SyncConfig(), use_pose=True)
    assert sync.missing == "no scan yet"
    feed(sync, ("scan", 0))
    assert sync.missing == "no odometry yet"
    feed(sync, ("odom", 0))
    assert sync.missing == "no localization yet"
    feed(sync, ("pose", 0))
    assert sync.missing == ""


def test_time_that_jumps_back_begins_anew_with_nothing_of_before():
    sync = Synchronizer(SyncConfig(), use_pose=False)
    feed(sync, ("odom", 5000), ("scan", 5000))
    assert not sync.restarted
    assert feed(sync, ("scan", 50)) == [] and sync.restarted
    assert feed(sync, ("odom", 50)) == [(0, 50, 50, 0.05)]


def test_no_observation_is_made_twice_and_memory_is_bounded():
    sync = Synchronizer(SyncConfig(), use_pose=False)
    readings = [(kind, ms) for ms in range(0, 20000, 20) for kind in ("odom", "scan")]
    stamps = [stamp for _, stamp, _, _ in feed(sync, *readings)]
    assert stamps == list(range(0, 20000, 20))
    assert len(sync._odometry._readings) <= 200
