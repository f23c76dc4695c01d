"""E-Band as a local planner: control law, failures, and drives in a small flat world."""

import math
from unittest.mock import Mock

import numpy as np
import pytest

from barn_planners.costmap.config import CostmapConfig
from barn_planners.costmap.costmap import RollingCostmap
from barn_planners.eband.config import EBandConfig
from barn_planners.eband.planner import ENTRY, EBandController, bubble_radii
from barn_planners.interface import PlannerStatus
from barn_planners.navigation.loop import ControlInput
from barn_planners.registry import make_planner
from barn_worlds.base.types import ORIGIN, STOP, Pose2D, Scan, Velocity2D

BEAMS = 181
FREE_SPEED = 2.0 * 0.7 * math.log(252.0) / 10.0 * 0.5  # 0.387 m/s


def scan_of(pose, points, stamp_ns=0):
    """Return what a lidar at the robot's center sees of small discs at points (n, 2), seen through one another."""
    ranges = np.full(BEAMS, np.inf, np.float32)
    points = np.asarray(points, np.float64).reshape(-1, 2)
    for x, y in pose.inverse().transform(points):
        beam = 90 + round(math.degrees(math.atan2(y, x)) / 2.0)
        ranges[beam] = min(ranges[beam], math.hypot(x, y))
    return Scan(stamp_ns, ranges, -math.pi, math.radians(2.0), 0.05, 30.0)


def inputs(pose, plan, points=(), *, new_plan=True, costmap=None):
    if costmap is None:
        costmap = RollingCostmap(CostmapConfig())
        costmap.update(pose, scan_of(pose, points), ORIGIN)
    return ControlInput(0, pose, STOP, costmap, plan, plan, Pose2D(*plan[-1]), new_plan)


def straight_plan(length=4.0, yaw=0.0):
    xs = np.arange(0.0, length + 1e-9, 0.025)
    plan = np.column_stack([xs, np.zeros((len(xs), 2))])
    plan[-1, 2] = yaw
    return plan


def controller(**changes):
    return EBandController(EBandConfig(**changes))


def test_radii_of_the_paper():
    radii = bubble_radii(10.0)[[0, 255, 1, 177, 241, 253, 254]]
    expected = [0.5529, 0.5529, 0.5529, 0.0353, 0.0045, 0, 0]
    np.testing.assert_allclose(radii, expected, atol=5e-5)


@pytest.mark.parametrize("length, speed", [(4.0, FREE_SPEED), (0.7, FREE_SPEED / 2.0)])
def test_speed_in_the_open(length, speed):
    command = controller().control(inputs(ORIGIN, straight_plan(length))).command
    assert command.linear == pytest.approx(speed, abs=1e-12)
    assert command.angular == pytest.approx(0.0, abs=1e-12)
    assert pytest.approx(0.387, abs=1e-3) == FREE_SPEED


def test_speed_beside_an_obstacle_is_the_lowest():
    control = controller().control(inputs(ORIGIN, straight_plan(), [(0.0, 0.31)]))
    assert control.diagnostics["robot_radius_m"] < 0.04
    assert control.command.linear == 0.1


@pytest.mark.parametrize("yaw", [0.3, -0.3])
def test_small_bearing_steers_while_driving(yaw):
    control = controller().control(inputs(Pose2D(0.0, 0.0, yaw), straight_plan()))
    bearing = control.diagnostics["bearing_rad"]
    assert bearing == pytest.approx(-yaw, abs=0.1)
    speed = FREE_SPEED * math.cos(bearing)
    assert control.command.linear == pytest.approx(speed)
    assert control.command.angular == pytest.approx(4.0 * bearing)


@pytest.mark.parametrize("yaw, rate", [(2.0, -1.57), (-2.0, 1.57), (0.7, -1.57)])
def test_large_bearing_turns_in_place(yaw, rate):
    control = controller().control(inputs(Pose2D(0.0, 0.0, yaw), straight_plan()))
    assert control.command == Velocity2D(0.0, rate)


def test_final_turn_and_goal():
    plan = straight_plan(yaw=0.2)
    steering = controller()
    turning = steering.control(inputs(Pose2D(3.97, 0.02, 0.0), plan))
    assert turning.command == Velocity2D(0.0, pytest.approx(0.8))
    assert not turning.goal_reached
    drifted = steering.control(inputs(Pose2D(3.92, 0.02, 0.0), plan))
    assert drifted.command.linear == 0.0
    reached = steering.control(inputs(Pose2D(3.97, 0.02, 0.18), plan))
    assert (reached.command, reached.goal_reached) == (STOP, True)


def test_plan_in_collision_resets_the_costmap_once():
    across = [(1.0, 0.04)]
    request = inputs(ORIGIN, straight_plan(), across)
    assert request.costmap.costs.any()
    refused = controller().control(request)
    assert refused.command is None
    assert "collision" in refused.reason
    control = controller(reset_costmap_once=True).control(request)
    assert control.command.linear == pytest.approx(FREE_SPEED)
    assert not request.costmap.costs.any()


@pytest.mark.parametrize("relaxes, calls", [(False, [1, 2, 3]), (True, [2, 3, 5])])
def test_a_new_plan_is_relaxed_once_more_where_that_is_asked_for(relaxes, calls):
    steered = controller(relax_new_plan=relaxes)
    band = steered._band
    optimize = band.optimize = Mock(side_effect=band.optimize)
    advance = band.advance = Mock(side_effect=band.advance)
    counts = []
    for new_plan in (True, False, True):
        request = inputs(ORIGIN, straight_plan(), [(1.0, 0.4)], new_plan=new_plan)
        steered.control(request)
        counts.append(optimize.call_count + advance.call_count)
    assert counts == calls


def test_band_in_collision_gives_no_command_and_recovers():
    steering = controller()
    plan = straight_plan()
    assert steering.control(inputs(ORIGIN, plan)).command is not None
    on_the_next_bubble = steering.view().band[1, :2]
    blocked = steering.control(inputs(ORIGIN, plan, on_the_next_bubble, new_plan=False))
    assert blocked.command is None
    assert "collision" in blocked.reason
    assert steering.control(inputs(ORIGIN, plan, new_plan=False)).command is not None


def test_band_grows_along_a_kept_plan():
    steering = controller()
    plan = straight_plan(9.0)
    costmap = RollingCostmap(CostmapConfig())
    for k in range(8):
        pose = Pose2D(0.5 * k, 0.0, 0.0)
        costmap.update(pose, scan_of(pose, []), ORIGIN)
        control = steering.control(inputs(pose, plan, new_plan=k == 0, costmap=costmap))
        assert control.command.linear == pytest.approx(FREE_SPEED)
        end = min(5.0 + pose.x, 9.0)
        assert steering.view().band[-1, 0] == pytest.approx(end, abs=0.03)


def test_view_shows_band_and_local_plan():
    steering = controller()
    assert steering.view().band is None
    steering.control(inputs(Pose2D(0.0, 0.0, 0.1), straight_plan()))
    view = steering.view()
    assert view.band.shape == view.local_plan.shape
    assert view.band[0, 2] == pytest.approx(0.5529, abs=1e-4)
    assert view.local_plan[0, 2] == 0.1


@pytest.mark.parametrize("preset", list(ENTRY.presets))
def test_straight_run_takes_as_long_as_published(flat_world, preset):
    """14.0 to 14.9 s for 5.65 m, from 0.316 m of motion until 0.316 m from the goal."""
    world = flat_world([((-3.0, side), (9.0, side)) for side in (-2.0, 2.0)])
    goal = Pose2D(5.65, 0.0, 0.0)
    status = world.drive(make_planner("eband", preset), goal, limit_s=18.0)
    assert status is PlannerStatus.GOAL_REACHED
    x, y, _ = np.array(world.track).T
    began = np.argmax(x > 0.316)
    ended = np.argmax(np.hypot(x - goal.x, y - goal.y) < 0.316)
    assert 13.95 <= (ended - began) * world.period_s <= 14.9
    assert world.pose.distance(goal) < 0.1
