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
    ORIGIN,
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
    def __init__(self, *decisions):
        self.decisions, self.tasks = list(decisions), []

    def start(self, task, seed):
        self.tasks.append((task, seed))

    def step(self, observation):
        return self.decisions.pop(0) if self.decisions else Decision(FORWARD)


def at(seconds):
    stamp = round(seconds * 1e9)
    scan = Scan(stamp, np.ones(3, np.float32), 0.0, 0.1, 0.1, 30.0)
    pose = ORIGIN
    return Observation(stamp, Odometry(stamp, pose, STOP), scan, pose)


def static_map(value=0):
    return OccupancyMap(np.full((3, 3), value, np.int8), 0.15, 0.0, 0.0)


def runtime(*decisions, use_map=False, **kwargs):
    return PlannerRuntime(Scripted(*decisions), seed=5, use_map=use_map, **kwargs)


@pytest.fixture
def mapped():
    """A runtime with map and goal."""
    each = runtime(use_map=True)
    each.set_map(static_map())
    each.set_goal(GOAL)
    return each


@pytest.fixture
def sync():
    """A synchronizer without localization."""
    return Synchronizer(SyncConfig(), use_pose=False)


def test_before_the_goal_the_robot_stands():
    each = runtime()
    assert each.step(at(0.0)).command == STOP and each.missing() == "no goal yet"
    assert each.set_goal(GOAL) and each.missing() == ""
    assert each.step(at(0.05)).command == FORWARD
    ((task, seed),) = each.planner.tasks
    assert (task.goal, seed) == (GOAL, 5)


@pytest.mark.parametrize("map_first", [True, False])
def test_with_a_map_both_must_have_come(map_first):
    each = runtime(use_map=True)
    assert each.missing() == "no goal yet, no map yet"
    calls = [(each.set_map, static_map()), (each.set_goal, GOAL)]
    for call, argument in calls if map_first else reversed(calls):
        assert each.step(at(0.0)).command == STOP and not each.planner.tasks
        call(argument)
    assert each.missing() == ""
    ((task, _),) = each.planner.tasks
    assert task.map.data.shape == (3, 3)


def test_an_equal_task_changes_nothing_another_restarts(mapped):
    assert not mapped.set_goal(Pose2D(3.0, 0.0, 0.0))
    assert not mapped.set_map(static_map())
    assert len(mapped.planner.tasks) == 1
    assert mapped.set_goal(Pose2D(3.0, 0.5, 0.0)) and mapped.set_map(static_map(100))
    assert len(mapped.planner.tasks) == 3


def test_an_equal_goal_restarts_only_after_end_and_pause():
    done = [Decision(STOP, PlannerStatus.GOAL_REACHED)] * 101
    each = runtime(Decision(FORWARD), *done)
    each.set_goal(GOAL)
    for k in range(20):
        each.step(at(0.1 * k))
        assert not each.set_goal(GOAL), "sent again all the time it is a repetition"
    each.step(at(4.0))
    assert each.set_goal(GOAL)


@pytest.mark.parametrize(
    "repeats, commands",
    [(True, [STOP, FORWARD, FORWARD]), (False, [None, FORWARD, None])],
)
def test_a_cycle_without_command_repeats_or_sends_nothing(repeats, commands):
    decisions = [Decision(None), Decision(FORWARD), Decision(None)]
    each = runtime(*decisions, repeat_command=repeats)
    each.set_goal(GOAL)
    assert [each.step(at(k)).command for k in range(3)] == commands


def test_a_step_that_returns_no_decision_is_told_what_to_return():
    each = runtime((0.5, 0.0))
    each.set_goal(GOAL)
    with pytest.raises(TypeError, match=r"must return a Decision, such as Decision\("):
        each.step(at(0.0))


def test_reset_forgets_goal_map_and_task(mapped):
    mapped.reset()
    assert mapped.missing() == "no goal yet, no map yet"
    assert mapped.step(at(0.0)).command == STOP
    mapped.set_map(static_map())
    assert mapped.set_goal(GOAL)


def test_a_goal_in_another_frame_or_not_a_number_is_refused():
    assert goal_problem(GOAL, "odom", "odom") == ""
    assert goal_problem(GOAL, "/odom", "odom") == ""
    assert "in frame 'map'" in goal_problem(GOAL, "map", "odom")
    assert "not finite" in goal_problem(Pose2D(math.nan, 0.0, 0.0), "odom", "odom")


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


def odometry(ms):
    return Odometry(ms * MS, Pose2D(ms / 1000.0, 0.0, 0.0), STOP)


def scan(ms):
    return Scan(ms * MS, np.ones(3, np.float32), 0.0, 0.1, 0.1, 30.0)


def feed(sync, *readings):
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
                stamps = (each.stamp_ns // MS, each.odometry.stamp_ns // MS)
                observations.append((index, *stamps, each.pose.x))
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


def test_without_a_map_the_pose_is_that_of_the_odometry(sync):
    assert feed(sync, ("scan", 50), ("odom", 50)) == [(1, 50, 50, 0.05)]


def test_odometry_between_scans_is_taken_from_before(sync):
    assert feed(sync, ("odom", 35), ("scan", 50), ("odom", 55)) == [(2, 50, 35, 0.035)]
    # no more waiting once let down
    later = feed(sync, ("scan", 100), ("odom", 95), ("scan", 150), ("odom", 155))
    assert [(stamp, used) for _, stamp, used, _ in later] == [(100, 55), (150, 95)]


def test_a_source_that_matches_again_is_waited_for_again(sync):
    feed(sync, ("odom", 35), ("scan", 50), ("odom", 55))
    assert [item[0] for item in feed(sync, ("odom", 100), ("scan", 100))] == [1]
    assert feed(sync, ("scan", 150), ("odom", 150)) == [(1, 150, 150, 0.15)]


def test_a_scan_with_lost_odometry_is_used_with_the_next(sync):
    observations = feed(sync, ("odom", 0), ("scan", 0), ("scan", 50), ("scan", 100))
    assert observations[-2:] == [(3, 50, 0, 0.0), (3, 100, 0, 0.0)]


@pytest.mark.parametrize("age, count, last", [(0.1, 2, 100), (1.0, 4, 400)])
def test_odometry_that_is_too_old_is_not_used(age, count, last):
    sync = Synchronizer(SyncConfig(odometry_age_s=age), use_pose=False)
    scans = [("scan", 100 * k) for k in range(5)]
    observations = feed(sync, ("odom", 0), *scans)
    assert len(observations) >= count
    assert max(stamp for _, stamp, _, _ in observations) == last


def test_seldom_localisation_is_carried_on_by_odometry():
    sync = Synchronizer(SyncConfig(), use_pose=True)
    readings = [(kind, ms) for ms in (0, 50, 100) for kind in ("odom", "scan")]
    observations = feed(sync, ("pose", 0), *readings)
    assert [stamp for _, stamp, _, _ in observations] == [0, 50, 100]
    assert observations[0][1:] == (0, 0, 100.0)
    places = [x for _, _, _, x in observations]
    assert places == pytest.approx([100.0, 100.05, 100.1])


def test_time_that_jumps_back_begins_anew_with_nothing_of_before(sync):
    feed(sync, ("odom", 5000), ("scan", 5000))
    assert not sync.restarted
    assert feed(sync, ("scan", 50)) == [] and sync.restarted
    assert feed(sync, ("odom", 50)) == [(0, 50, 50, 0.05)]


def test_no_observation_is_made_twice_and_memory_is_bounded(sync):
    readings = [(kind, ms) for ms in range(0, 20000, 20) for kind in ("odom", "scan")]
    stamps = [stamp for _, stamp, _, _ in feed(sync, *readings)]
    assert stamps == list(range(0, 20000, 20))
    assert len(sync._odometry._readings) <= 200
