"""The session of a planner's node: tasks, repetitions, readiness, what is sent."""

import math

import numpy as np
import pytest

from barn_planners.interface import Decision, Observation, Planner, PlannerStatus
from barn_planners.registry import make_planner
from barn_planners.runtime.session import PlannerSession, goal_problem
from barn_worlds.base.types import STOP, OccupancyMap, Odometry, Pose2D, Scan, Velocity2D

GOAL = Pose2D(3.0, 0.0, 0.0)
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
    return Observation(stamp, Odometry(stamp, Pose2D(0.0, 0.0, 0.0), STOP), scan, Pose2D(0.0, 0.0, 0.0))


def known(value: int = 0) -> OccupancyMap:
    return OccupancyMap(np.full((3, 3), value, np.int8), 0.15, 0.0, 0.0)


def session(*decisions: Decision, use_map: bool = False, **kwargs) -> PlannerSession:
    return PlannerSession(Scripted(*decisions), seed=5, use_map=use_map, **kwargs)


def test_before_the_goal_the_robot_stands():
    each = session()
    assert each.answer(at(0.0)).command == STOP and each.missing() == "no goal yet"
    assert each.set_goal(GOAL) and each.missing() == ""
    assert each.answer(at(0.05)).command == FORWARD
    assert each.planner.tasks[0][0].goal == GOAL and each.planner.tasks[0][1] == 5


@pytest.mark.parametrize("map_first", [True, False])
def test_with_a_map_both_must_have_come(map_first):
    each = session(use_map=True)
    assert each.missing() == "no goal yet, no map yet"
    first, second = (each.set_map, known()), (each.set_goal, GOAL)
    for call, argument in (first, second) if map_first else (second, first):
        assert each.answer(at(0.0)).command == STOP and not each.planner.tasks
        call(argument)
    assert each.missing() == "" and len(each.planner.tasks) == 1
    assert each.planner.tasks[0][0].map.data.shape == (3, 3)


def test_the_same_goal_and_map_again_change_nothing_and_others_begin_anew():
    each = session(use_map=True)
    each.set_map(known())
    each.set_goal(GOAL)
    assert not each.set_goal(Pose2D(3.0, 0.0, 0.0)) and not each.set_map(known())
    assert len(each.planner.tasks) == 1
    assert each.set_goal(Pose2D(3.0, 0.5, 0.0)) and each.set_map(known(100))
    assert len(each.planner.tasks) == 3


def test_the_same_goal_begins_anew_only_after_the_task_is_over_and_after_a_pause():
    done = Decision(STOP, PlannerStatus.GOAL_REACHED)
    each = session(Decision(FORWARD), done, *[Decision(STOP, PlannerStatus.GOAL_REACHED)] * 100)
    each.set_goal(GOAL)
    for k in range(20):
        each.answer(at(0.1 * k))
        assert not each.set_goal(GOAL), "sent again all the time it is a repetition"
    each.answer(at(4.0))
    assert each.set_goal(GOAL)


def test_a_cycle_without_a_command_repeats_the_last_one_or_sends_nothing():
    decisions = [Decision(None), Decision(FORWARD), Decision(None)]
    repeating, silent = session(*decisions), session(*decisions, repeat_command=False)
    for each in (repeating, silent):
        each.set_goal(GOAL)
    assert [repeating.answer(at(k)).command for k in range(3)] == [STOP, FORWARD, FORWARD]
    assert [silent.answer(at(k)).command for k in range(3)] == [None, FORWARD, None]


def test_reset_forgets_goal_map_and_task():
    each = session(use_map=True)
    each.set_map(known())
    each.set_goal(GOAL)
    each.reset()
    assert each.missing() == "no goal yet, no map yet" and each.answer(at(0.0)).command == STOP
    each.set_map(known())
    assert each.set_goal(GOAL)


def test_a_goal_in_another_frame_or_not_a_number_is_refused():
    assert goal_problem(GOAL, "odom", "odom") == "" and goal_problem(GOAL, "/odom", "odom") == ""
    assert "in frame 'map'" in goal_problem(GOAL, "map", "odom")
    assert "not a number" in goal_problem(Pose2D(math.nan, 0.0, 0.0), "odom", "odom")


@pytest.mark.parametrize("use_map", [True, False])
def test_warming_up_leaves_no_trace(use_map):
    warm, cold = (PlannerSession(make_planner("dwa"), seed=0, use_map=use_map) for _ in range(2))
    warm.warm_up()
    warm.reset()
    answers = []
    for each in (warm, cold):
        each.set_goal(GOAL)
        each.set_map(OccupancyMap(np.zeros((60, 60), np.int8), 0.15, -4.5, -4.5))
        answers.append([each.answer(at(0.05 * k)).command for k in range(5)])
    assert answers[0] == answers[1]
