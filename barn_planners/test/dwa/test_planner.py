"""The dynamic window approach: its samples, its memory and its last meters."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from barn_planners.costmap.config import CostmapConfig
from barn_planners.costmap.costmap import RollingCostmap
from barn_planners.costmap.kernels import LETHAL
from barn_planners.dwa.config import DwaConfig
from barn_planners.dwa.kernels import SPEED, TURN
from barn_planners.dwa.memory import DwaMemory
from barn_planners.dwa.planner import DwaController, sample_velocities
from barn_planners.navigation.loop import ControlInput
from barn_worlds.base.types import ORIGIN, STOP, Pose2D, Scan, Velocity2D

AHEAD = Pose2D(3.0, 0.0, 0.0)
QUIRKY = DwaConfig(sample_highest_turn=False, escape_through=True)
ANGLES = np.linspace(-math.pi, math.pi, 300)
BLOCKED_ALL_AROUND = 0.22 * np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])


def inputs(pose=ORIGIN, velocity=STOP, goal=AHEAD, lethal=()):
    costmap = RollingCostmap(CostmapConfig(footprint_padding_m=0.03, soft_costs=False))
    nothing = Scan(0, np.full(4, np.inf, np.float32), 0.0, 0.1, 0.1, 30.0)
    costmap.update(pose, nothing, ORIGIN)
    for x, y in lethal:
        costmap.costs[costmap.world_to_cell(x, y)] = LETHAL
    plan = np.linspace((*pose.position, goal.yaw), goal.numbers, 100)
    return ControlInput(0, pose, velocity, costmap, plan, plan, goal, True)


def control(config, **situation):
    """Return what a controller decides in its first cycle."""
    return DwaController(config).control(inputs(**situation))


def quirky(**changes):
    return dataclasses.replace(QUIRKY, **changes)


def forward_samples(config, velocity, end_distance_m):
    table, drives = sample_velocities(config, velocity, end_distance_m)
    return table[:drives, [SPEED, TURN]]


def turn_samples(config, velocity):
    table, drives = sample_velocities(config, velocity, 9.0, is_escaping=True)
    assert drives == 0 and not table[:, SPEED].any()
    return table[:, TURN]


def test_forward_samples_open_the_window_of_one_period():
    samples = forward_samples(QUIRKY, Velocity2D(0.3, 0.2), 9.0)
    assert samples.shape == (6 * 20, 2)
    assert_allclose(np.unique(samples[:, 0]), np.linspace(0.1, 0.5, 6))
    turns = samples[:20, 1]
    assert turns[0] == 0.0 and turns[1] == pytest.approx(-0.8)
    assert turns.max() < 1.2 - 0.05
    assert_allclose(np.diff(turns[1:]), 2.0 / 19)
    with_highest = forward_samples(DwaConfig(), Velocity2D(0.3, 0.2), 9.0)
    assert with_highest.shape == (6 * 21, 2)
    assert with_highest[:, 1].max() == pytest.approx(1.2)


def test_speeds_fall_near_the_end_but_not_below_the_slowest():
    speeds = forward_samples(QUIRKY, Velocity2D(0.5, 0.0), 0.6)[:, 0]
    assert speeds.max() == pytest.approx(0.3) and speeds.min() == pytest.approx(0.1)
    assert set(forward_samples(QUIRKY, STOP, 0.05)[:, 0]) == {0.1}


def test_turns_in_place_are_never_slower_than_allowed():
    turns = turn_samples(QUIRKY, STOP)
    assert len(turns) == 20
    assert np.abs(turns).min() == pytest.approx(0.314)
    assert turns.max() == pytest.approx(1.0)


def test_turns_within_a_step_of_zero_are_left_out_where_asked():
    config = quirky(skip_slow_turns=True)
    is_fast = np.abs(np.linspace(-1.0, 1.0, 20)) > 2.0 / 19
    assert len(turn_samples(config, STOP)) == is_fast.sum() == 18
    assert len(turn_samples(config, Velocity2D(0.0, 1.57))) == 20


def test_samples_are_added_up_in_single_precision():
    config = quirky(single_precision=True)
    turns = forward_samples(config, Velocity2D(0.3, 0.2), 9.0)[1:20, 1]
    added = [-0.8]
    step = 2.0 / 19
    for _ in range(18):
        added.append(added[-1] + step)
    assert turns.tolist() == added


def test_two_turns_to_one_side_forbid_the_other():
    memory = DwaMemory(QUIRKY)
    memory.record_sample(ORIGIN, 0.0, 0.5)
    assert memory.allowed_turns() == (True, True)
    memory.record_sample(ORIGIN, 0.0, 0.5)
    assert memory.allowed_turns() == (True, False)
    memory.record_sample(Pose2D(0.04, 0.0, 1.0), 0.3, 0.0)
    assert memory.allowed_turns() == (True, False)
    memory.record_sample(Pose2D(0.051, 0.0, 1.0), 0.3, 0.0)
    assert memory.allowed_turns() == (True, True)
    memory.record_sample(ORIGIN, 0.0, -0.5)
    memory.record_sample(ORIGIN, 0.0, -0.5)
    assert memory.allowed_turns() == (False, True)


def test_an_escape_ends_after_a_distance_or_a_turn():
    for end in (Pose2D(-0.11, 0.0, 0.0), Pose2D(0.0, 0.0, 0.11)):
        memory = DwaMemory(QUIRKY)
        memory.record_escape(ORIGIN, may_begin=True)
        memory.record_escape(Pose2D(-0.05, 0.0, 0.05), may_begin=True)
        assert memory.is_escaping
        memory.record_sample(end, 0.0, 0.5)
        assert not memory.is_escaping


def test_with_nothing_allowed_the_quirk_reverses():
    for speed in (0.5, 0.4):  # the speed cap that it declares
        decision = control(quirky(max_speed_mps=speed), lethal=BLOCKED_ALL_AROUND)
        assert decision.command == Velocity2D(-speed, 0.0)
    plain = control(quirky(escape_through=False), lethal=BLOCKED_ALL_AROUND)
    assert plain.command is None and plain.reason == "no sample is allowed"


def test_while_it_escapes_the_robot_does_not_drive_forward():
    controller = DwaController(QUIRKY)
    controller.control(inputs(lethal=BLOCKED_ALL_AROUND))
    assert controller.control(inputs()).command.linear <= 0.0
    away = inputs(pose=Pose2D(-0.2, 0.0, 0.0))
    # the cycle that sees the escape end still belongs to it
    assert controller.control(away).command.linear <= 0.0
    assert controller.control(away).command.linear > 0.0


def test_the_robots_own_cells_block_the_way_if_configured():
    inside = [(0.0, 0.0)]  # a mark under the robot, which its edges do not meet
    assert control(QUIRKY, lethal=inside).command.linear > 0.0
    blocked = control(quirky(robot_blocks_goal=True), lethal=inside)
    assert blocked.command is None or blocked.command.linear <= 0.0


def test_at_the_goal_it_brakes_turns_and_says_so():
    controller = DwaController(QUIRKY)
    goal = Pose2D(0.1, 0.0, 1.2)
    braking = controller.control(inputs(velocity=Velocity2D(0.5, 0.3), goal=goal))
    assert braking.command == STOP and not braking.goal_reached
    turning = controller.control(inputs(goal=goal))
    assert turning.command == Velocity2D(0.0, pytest.approx(1.0))
    near = inputs(Pose2D(0.0, 0.0, 0.9), Velocity2D(0.2, 0.9), goal)
    still_turning = controller.control(near)
    assert 0.314 - 1e-9 <= still_turning.command.angular <= 1.0
    reached = controller.control(inputs(pose=Pose2D(0.0, 0.0, 1.05), goal=goal))
    assert reached.goal_reached and reached.command == STOP


def test_the_goal_turn_takes_the_short_and_free_side():
    goal = Pose2D(0.0, 0.0, -3.0)
    turning = control(QUIRKY, pose=Pose2D(0.0, 0.0, 3.0), goal=goal)
    assert turning.command.angular > 0.0
    blocked = control(QUIRKY, goal=goal, lethal=BLOCKED_ALL_AROUND)
    assert blocked.command is None and "no room" in blocked.reason


def test_a_goal_turn_that_is_rolled_out_needs_room_for_all_of_it():
    # free of the footprint as it stands, not as it turns
    aside = [(0.0, 0.3), (0.0, -0.3)]
    goal = Pose2D(0.1, 0.0, 1.2)
    assert control(QUIRKY, goal=goal, lethal=aside).command.angular > 0.0
    config = quirky(roll_out_goal_turn=True)
    blocked = control(config, goal=goal, lethal=aside)
    assert blocked.command is None and "no room to turn" in blocked.reason
    assert control(config, goal=goal).command.angular > 0.0
    slow = Velocity2D(0.1, 0.0)
    moving = control(config, velocity=slow, goal=goal, lethal=BLOCKED_ALL_AROUND)
    assert moving.command is None and "no room to brake" in moving.reason


def test_displayed_samples_have_the_costs_of_the_choice():
    controller = DwaController(DwaConfig())
    situation = inputs(velocity=Velocity2D(0.3, 0.0), lethal=[(0.7, 0.1)])
    assert controller.view().candidates is None
    decision = controller.control(situation)
    situation.costmap.costs[:] = LETHAL
    view = controller.view()
    assert view.candidates.shape == (20, 80, 2)
    assert view.local_plan.shape == (80, 3)
    assert np.isfinite(view.local_plan).all()
    costs = view.candidate_costs
    assert np.nanmin(costs) == decision.diagnostics["cost"]
    # The search rules out most samples before it scores them.
    assert 0 < np.isnan(costs).sum() < len(costs)
    assert_array_equal(controller.view().candidate_costs, costs)
