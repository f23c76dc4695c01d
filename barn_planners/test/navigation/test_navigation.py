"""The navigation loop: what it does with bad observations, missing plans, goals sent again, and maps."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from barn_planners.global_plan.kernels import passed_points, visible_points
from barn_planners.global_plan.planner import GlobalPlan, transform_plan
from barn_planners.interface import PlannerStatus, Task
from barn_planners.navigation.loop import (
    Control,
    Controller,
    NavigationConfig,
    NavigationPlanner,
)
from barn_planners.registry import make_planner
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.types import ORIGIN, STOP, OccupancyMap, Pose2D, Velocity2D

BOX = [
    ((-2.0, -2.0), (6.0, -2.0)),
    ((-2.0, 2.0), (6.0, 2.0)),
    ((-2.0, -2.0), (-2.0, 2.0)),
]
GOAL = Pose2D(4.0, 0.0, 0.0)
FORWARD = Velocity2D(0.3, 0.0)
MAP_OF_ODOM = Pose2D(1.0, -0.5, 0.4)
NO_PLAN = GlobalPlan(None, "gone")


class Scripted(Controller):
    """Gives the commands of a list, the last one for ever, and keeps what it was given."""

    def __init__(self, *controls):
        self.controls = list(controls) or [Control(FORWARD)]
        self.inputs = []

    def reset(self, seed):
        self.inputs.clear()

    def control(self, inputs):
        self.inputs.append(inputs)
        return self.controls[min(len(self.inputs), len(self.controls)) - 1]


def started(*controls, goal=GOAL, static_map=None, **changes):
    """Return a planner with a task, whose controller is scripted."""
    config = replace_dotted(NavigationConfig(), changes, "test")
    planner = NavigationPlanner(config, Scripted(*controls))
    planner.start(Task(goal, static_map), seed=0)
    return planner


@pytest.fixture
def world(flat_world):
    return flat_world(BOX)


def commands_of(decisions):
    """Return commands as letters: F forward, S stop, - none."""
    letters = {FORWARD: "F", STOP: "S", None: "-"}
    return "".join(letters[decision.command] for decision in decisions)


def free_map():
    return OccupancyMap(np.zeros((80, 80), np.int8), 0.15, -6.0, -6.0)


def steps(planner, world, count, moving=False):
    decisions = []
    for _ in range(count):
        decisions.append(planner.step(world.observe()))
        world.advance(decisions[-1].command if moving else STOP)
    return decisions


def test_leaving_everything_behind_is_not_blindness_for_a_while(flat_world):
    planner = make_planner("dwa", "challenge")
    world = flat_world(cylinders=[(4.0, 0.0, 0.1)])
    planner.start(Task(Pose2D(-3.0, 0.0, math.pi)), seed=0)
    assert steps(planner, world, 1)[0].status is PlannerStatus.RUNNING
    world.cylinders = world.cylinders[:0]
    decisions = steps(planner, world, 60)
    assert decisions[20].status is PlannerStatus.RUNNING
    assert decisions[-1].command == STOP
    assert "nothing for more than 2 s" in decisions[-1].reason
    open_field = make_planner("dwa", "challenge", {"guard.stop_when_blind": False})
    open_field.start(Task(Pose2D(3.0, 0.0, 0.0)), seed=0)
    assert open_field.step(world.observe()).command.linear > 0.0


def test_without_a_task_or_with_time_reversed_it_stands(world):
    planner = NavigationPlanner(NavigationConfig(), Scripted())
    assert planner.step(world.observe()).reason == "no task yet"
    planner.start(Task(GOAL), seed=0)
    planner.step(world.observe())
    world.stamp_ns -= 1_000_000_000
    decision = planner.step(world.observe())
    assert decision.command == STOP and "older than the last one" in decision.reason


@pytest.mark.parametrize("preset", ["paper2020", "challenge"])
def test_a_goal_inside_a_mapped_obstacle_is_refused(world, preset):
    static_map = free_map()
    static_map.data[40, 60] = 100
    planner = make_planner("dwa", preset)
    planner.start(Task(Pose2D(3.05, 0.05, 0.0), static_map), seed=0)
    for decision in steps(planner, world, 10):
        assert decision.command in (STOP, None)
        assert decision.reason == "the goal is inside an obstacle"
        assert decision.status is PlannerStatus.BLOCKED


def test_a_vanished_plan_is_followed_on_without_a_new_goal(world):
    planner = started()
    assert steps(planner, world, 2)[-1].reason == ""
    planner._global_planner.plan = lambda *_: NO_PLAN
    for decision in steps(planner, world, 5):
        assert decision.command == FORWARD
        assert decision.reason == "following the last plan: gone"


def test_a_repeated_goal_costs_a_cycle_then_a_stop(world):
    planner = started(goal_republish_period_s=0.1, hold_s=0.15)
    assert commands_of(steps(planner, world, 9)) == "FF-F-F-F-"
    planner._global_planner.plan = lambda *_: NO_PLAN
    lost = steps(planner, world, 8)
    assert commands_of(lost) == "F---SSSS"
    assert {decision.reason for decision in lost[1:]} == {"gone"}


def test_a_late_first_plan_starts_control_in_the_next_cycle(world):
    planner = started(goal_republish_period_s=0.1, hold_s=0.15, first_plan_waits=True)
    decisions = steps(planner, world, 5)
    assert commands_of(decisions) == "SF-F-"
    assert decisions[0].plan is not None
    assert decisions[0].status is PlannerStatus.RUNNING


def test_observations_between_control_periods_are_skipped(flat_world):
    decisions = steps(started(), flat_world(BOX, period_s=0.02), 100)
    commands = commands_of(decisions)
    assert commands.count("F") == 40 and commands.count("-") == 60


def test_no_valid_command_leads_to_recovery_and_back(world):
    failing = [Control(None, reason="stuck")] * 45
    patience = {"recovery.controller_patience_s": 1.0}
    planner = started(*failing, Control(FORWARD), **patience)
    decisions = steps(planner, world, 400, moving=True)
    recovering = [
        k
        for k, decision in enumerate(decisions)
        if decision.status is PlannerStatus.RECOVERING
    ]
    before = decisions[recovering[0] - 1]
    assert 20 <= recovering[0] <= 23
    assert (before.reason, before.command) == ("stuck", STOP)
    assert {decisions[k].reason for k in recovering} == {"stuck"}
    turned = sum(decisions[k].command.angular * 0.05 for k in recovering)
    assert turned == pytest.approx(2 * math.pi, abs=0.15)
    assert decisions[-1].status is PlannerStatus.RUNNING
    assert decisions[-1].command == FORWARD


def test_the_known_map_is_planned_on_in_the_odometry_frame(world):
    goal = MAP_OF_ODOM @ GOAL
    planner = started(goal=goal, static_map=free_map())
    observation = dataclasses.replace(world.observe(), pose=MAP_OF_ODOM @ world.pose)
    decision = planner.step(observation)
    assert math.dist(decision.plan[-1], goal.position) < 1e-9
    inputs = planner.controller.inputs[0]
    assert_allclose(inputs.plan[-1], GOAL.numbers, atol=1e-9)
    assert_allclose(inputs.plan[0, :2], [0.0, 0.0], atol=0.1)
    assert inputs.goal.distance(GOAL) < 1e-9 and inputs.pose == world.pose


def test_in_the_map_frame_plans_follow_the_believed_pose(world):
    goal = MAP_OF_ODOM @ GOAL
    planner = started(goal=goal, static_map=free_map(), local_costmap_in_map=True)
    # as when the localisation corrects itself
    for jump in (ORIGIN, Pose2D(0.3, 0.2, 0.1)):
        pose = MAP_OF_ODOM @ jump @ world.pose
        decision = planner.step(dataclasses.replace(world.observe(), pose=pose))
        world.advance(STOP)
        inputs = planner.controller.inputs[-1]
        assert inputs.pose == pose
        assert inputs.goal == goal
        assert_array_equal(inputs.plan[:, :2], decision.plan)
        end = goal.numbers
        assert_allclose(inputs.plan[-1], end, atol=1e-9)
        # the wall 2 m to the left of the robot is marked where the robot believes it
        wall = pose @ Pose2D(0.0, 2.0, 0.0)
        row, col = inputs.costmap.cell(*wall.position)
        assert inputs.costmap.costs[row - 1 : row + 2, col - 1 : col + 2].max() == 254
    assert planner.view().in_planning_frame


def test_without_a_map_the_only_frame_is_odometry(world):
    planner = started(local_costmap_in_map=True)
    observation = dataclasses.replace(world.observe(), pose=Pose2D(0.4, 0.1, 0.0))
    planner.step(observation)
    assert planner.controller.inputs[0].pose == observation.odometry.pose
    assert not planner.view().in_planning_frame


def test_a_task_given_up_restarts_with_the_same_goal(world):
    patience = {"recovery.controller_patience_s": 0.1}
    stuck = Control(None, reason="stuck")
    planner = started(stuck, goal_republish_period_s=30.0, **patience)
    statuses = [decision.status for decision in steps(planner, world, 640, moving=True)]
    failed = statuses.index(PlannerStatus.FAILED)
    # it has turned twice
    assert statuses[:failed].count(PlannerStatus.RECOVERING) > 200
    assert set(statuses[failed:600]) == {PlannerStatus.FAILED}
    assert PlannerStatus.FAILED not in statuses[600:]
    assert PlannerStatus.RECOVERING in statuses[600:]


def test_a_command_that_is_no_number_never_leaves_the_loop(world):
    planner = started(Control(Velocity2D(math.nan, 0.0)))
    decision = planner.step(world.observe())
    assert decision.command == STOP and decision.reason == "no valid command"


def test_windows_of_a_plan():
    plan = np.linspace([0.0, 0.0, 0.0], [10.0, 0.0, 0.0], 101)
    assert visible_points(plan, 2.0, 0.0, 5.0) == (0, 71)
    assert visible_points(plan, 9.0, 0.0, 5.0) == (40, 101)
    assert visible_points(plan, 0.0, 9.0, 5.0) == (0, 0)
    assert passed_points(plan, 5.0, 0.0, 1.05) == 40
    assert passed_points(plan, 5.0, 3.0, 1.0) == 101
    end = transform_plan(plan, Pose2D(1.0, 2.0, math.pi))[-1]
    assert_allclose(end, [-9.0, 2.0, -math.pi], atol=1e-9)
