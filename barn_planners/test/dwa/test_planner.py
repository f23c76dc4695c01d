"""The dynamic window approach: its samples, its memory and its last meters."""

import dataclasses
import math

import numpy as np
import pytest

from barn_planners.costmap.config import CostmapConfig
from barn_planners.costmap.costmap import RollingCostmap
from barn_planners.costmap.kernels import LETHAL
from barn_planners.dwa.config import DwaConfig
from barn_planners.dwa.kernels import SPEED, TURN
from barn_planners.dwa.memory import DwaMemory
from barn_planners.dwa.planner import DwaController, sample_velocities
from barn_planners.navigation.loop import ControlInput
from barn_worlds.base.types import STOP, Pose2D, Scan, Velocity2D

HERE = Pose2D(0.0, 0.0, 0.0)
AHEAD = Pose2D(3.0, 0.0, 0.0)
QUIRKY = DwaConfig(sample_highest_turn=False, escape_through=True)
BLOCKED_ALL_AROUND = [
    (0.22 * math.cos(a), 0.22 * math.sin(a))
    for a in np.linspace(-math.pi, math.pi, 300)
]


def inputs(pose=HERE, velocity=STOP, goal=AHEAD, lethal=()):
    costmap = RollingCostmap(CostmapConfig(footprint_padding_m=0.03, soft_costs=False))
    nothing = Scan(0, np.full(4, np.inf, np.float32), 0.0, 0.1, 0.1, 30.0)
    costmap.update(pose, nothing, Pose2D(0.0, 0.0, 0.0))
    for x, y in lethal:
        costmap.costs[costmap.world_to_cell(x, y)] = LETHAL
    plan = np.stack(
        [
            np.linspace(pose.x, goal.x, 100),
            np.linspace(pose.y, goal.y, 100),
            np.full(100, goal.yaw),
        ],
        axis=1,
    )
    return ControlInput(0, pose, velocity, costmap, plan, plan, goal, True)


def forward_samples(config, velocity, end_distance_m):
    table, drives = sample_velocities(config, velocity, end_distance_m)
    return table[:drives, [SPEED, TURN]]


def turn_samples(config, velocity):
    table, drives = sample_velocities(config, velocity, 9.0, is_escaping=True)
    assert drives == 0 and not table[:, SPEED].any()
    return table[:, TURN]


def test_forward_samples_open_the_window_of_one_period():
    samples = forward_samples(QUIRKY, Velocity2D(0.3, 0.2), end_distance_m=9.0)
    assert samples.shape == (6 * 20, 2)
    np.testing.assert_allclose(np.unique(samples[:, 0]), np.linspace(0.1, 0.5, 6))
    turns = samples[:20, 1]
    assert (
        turns[0] == 0.0 and turns[1] == pytest.approx(-0.8) and turns.max() < 1.2 - 0.05
    )
    np.testing.assert_allclose(np.diff(turns[1:]), 2.0 / 19)
    with_highest = forward_samples(
        DwaConfig(), Velocity2D(0.3, 0.2), end_distance_m=9.0
    )
    assert with_highest.shape == (6 * 21, 2) and with_highest[
        :, 1
    ].max() == pytest.approx(1.2)


def test_speeds_fall_near_the_end_but_not_below_the_slowest():
    speeds = forward_samples(QUIRKY, Velocity2D(0.5, 0.0), end_distance_m=0.6)[:, 0]
    assert speeds.max() == pytest.approx(0.3) and speeds.min() == pytest.approx(0.1)
    assert set(forward_samples(QUIRKY, STOP, end_distance_m=0.05)[:, 0]) == {0.1}


def test_turns_in_place_are_never_slower_than_allowed():
    turns = turn_samples(QUIRKY, Velocity2D(0.0, 0.0))
    assert (
        len(turns) == 20
        and np.abs(turns).min() == pytest.approx(0.314)
        and turns.max() == pytest.approx(1.0)
    )


def test_turns_within_a_step_of_zero_are_left_out_where_asked():
    quirky = dataclasses.replace(QUIRKY, skip_slow_turns=True)
    step = 2.0 / 19
    rates = np.linspace(-1.0, 1.0, 20)
    assert (
        len(turn_samples(quirky, STOP)) == np.count_nonzero(np.abs(rates) > step) == 18
    )
    assert len(turn_samples(quirky, Velocity2D(0.0, 1.57))) == 20


def test_samples_are_added_up_in_single_precision():
    turns = forward_samples(
        dataclasses.replace(QUIRKY, single_precision=True), Velocity2D(0.3, 0.2), 9.0
    )[1:20, 1]
    added = [-0.8]
    step = 2.0 / 19
    for _ in range(18):
        added.append(added[-1] + step)
    assert turns.tolist() == added


def test_two_turns_to_one_side_forbid_the_other():
    memory = DwaMemory(QUIRKY)
    memory.record_sample(HERE, 0.0, 0.5)
    assert memory.allowed_turns() == (True, True)
    memory.record_sample(HERE, 0.0, 0.5)
    assert memory.allowed_turns() == (True, False)
    memory.record_sample(Pose2D(0.04, 0.0, 1.0), 0.3, 0.0)
    assert memory.allowed_turns() == (True, False)
    memory.record_sample(Pose2D(0.051, 0.0, 1.0), 0.3, 0.0)
    assert memory.allowed_turns() == (True, True)
    memory.record_sample(HERE, 0.0, -0.5)
    memory.record_sample(HERE, 0.0, -0.5)
    assert memory.allowed_turns() == (False, True)


def test_an_escape_ends_after_a_distance_or_a_turn():
    for end in (Pose2D(-0.11, 0.0, 0.0), Pose2D(0.0, 0.0, 0.11)):
        memory = DwaMemory(QUIRKY)
        memory.record_escape(HERE, may_begin=True)
        memory.record_escape(Pose2D(-0.05, 0.0, 0.05), may_begin=True)
        assert memory.is_escaping
        memory.record_sample(end, 0.0, 0.5)
        assert not memory.is_escaping


def test_with_nothing_allowed_the_quirk_reverses():
    assert DwaController(QUIRKY).control(
        inputs(lethal=BLOCKED_ALL_AROUND)
    ).command == Velocity2D(-0.5, 0.0)
    slow = dataclasses.replace(
        QUIRKY, max_speed_mps=0.4
    )  # the speed cap that it declares
    assert DwaController(slow).control(
        inputs(lethal=BLOCKED_ALL_AROUND)
    ).command == Velocity2D(-0.4, 0.0)
    plain = DwaController(dataclasses.replace(QUIRKY, escape_through=False)).control(
        inputs(lethal=BLOCKED_ALL_AROUND)
    )
    assert plain.command is None and plain.reason == "no sample is allowed"


def test_while_it_escapes_the_robot_does_not_drive_forward():
    controller = DwaController(QUIRKY)
    controller.control(inputs(lethal=BLOCKED_ALL_AROUND))
    assert controller.control(inputs()).command.linear <= 0.0
    away = inputs(pose=Pose2D(-0.2, 0.0, 0.0))
    assert controller.control(away).command.linear <= 0.0, (
        "the cycle that sees the escape end still belongs to it"
    )
    assert controller.control(away).command.linear > 0.0


def test_the_robots_own_cells_block_the_way_if_configured():
    inside = [(0.0, 0.0)]  # a mark under the robot, which its edges do not meet
    assert DwaController(QUIRKY).control(inputs(lethal=inside)).command.linear > 0.0
    quirky = DwaController(dataclasses.replace(QUIRKY, robot_blocks_goal=True)).control(
        inputs(lethal=inside)
    )
    assert quirky.command is None or quirky.command.linear <= 0.0


def test_at_the_goal_it_brakes_turns_and_says_so():
    controller = DwaController(QUIRKY)
    goal = Pose2D(0.1, 0.0, 1.2)
    braking = controller.control(inputs(velocity=Velocity2D(0.5, 0.3), goal=goal))
    assert braking.command == STOP and not braking.goal_reached
    turning = controller.control(inputs(goal=goal))
    assert turning.command.linear == 0.0 and turning.command.angular == pytest.approx(
        1.0
    )
    still_turning = controller.control(
        inputs(pose=Pose2D(0.0, 0.0, 0.9), velocity=Velocity2D(0.2, 0.9), goal=goal)
    )
    assert 0.314 - 1e-9 <= still_turning.command.angular <= 1.0
    reached = controller.control(inputs(pose=Pose2D(0.0, 0.0, 1.05), goal=goal))
    assert reached.goal_reached and reached.command == STOP


def test_the_goal_turn_takes_the_short_and_free_side():
    goal = Pose2D(0.0, 0.0, -3.0)
    turning = DwaController(QUIRKY).control(
        inputs(pose=Pose2D(0.0, 0.0, 3.0), goal=goal)
    )
    assert turning.command.angular > 0.0
    blocked = DwaController(QUIRKY).control(
        inputs(goal=goal, lethal=BLOCKED_ALL_AROUND)
    )
    assert blocked.command is None and "no room" in blocked.reason


def test_a_goal_turn_that_is_rolled_out_needs_room_for_all_of_it():
    aside = [
        (0.0, 0.3),
        (0.0, -0.3),
    ]  # free of the footprint as it stands, not as it turns
    goal = Pose2D(0.1, 0.0, 1.2)
    assert (
        DwaController(QUIRKY).control(inputs(goal=goal, lethal=aside)).command.angular
        > 0.0
    )
    quirky = dataclasses.replace(QUIRKY, roll_out_goal_turn=True)
    blocked = DwaController(quirky).control(inputs(goal=goal, lethal=aside))
    assert blocked.command is None and "no room to turn" in blocked.reason
    assert DwaController(quirky).control(inputs(goal=goal)).command.angular > 0.0
    moving = DwaController(quirky).control(
        inputs(velocity=Velocity2D(0.1, 0.0), goal=goal, lethal=BLOCKED_ALL_AROUND)
    )
    assert moving.command is None and "no room to brake" in moving.reason


def test_displayed_samples_have_the_costs_of_the_choice():
    controller = DwaController(DwaConfig())
    control = inputs(velocity=Velocity2D(0.3, 0.0), lethal=[(0.7, 0.1)])
    assert controller.view().candidates is None
    decision = controller.control(control)
    control.costmap.costs[:] = LETHAL
    view = controller.view()
    assert view.candidates.shape == (6 * 21 + 20, 80, 2) and view.local_plan.shape == (
        80,
        3,
    )
    assert np.isfinite(view.local_plan).all()
    costs = view.candidate_costs
    assert len(costs) == 6 * 21 + 20 and 20 < np.isfinite(costs).sum() < len(costs)
    assert costs[: 6 * 21].min() == decision.diagnostics["cost"]
    np.testing.assert_array_equal(controller.view().candidate_costs, costs)
