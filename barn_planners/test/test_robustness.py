"""Every registered planner, whatever it observes: a safe stop with a reason, no exception, no NaN command."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from barn_planners.interface import Observation, PlannerStatus, Task
from barn_planners.registry import make_planner, planner_config, planner_names, presets
from barn_worlds.base.config import fields_of
from barn_worlds.base.types import STOP, OccupancyMap, Odometry, Pose2D, Velocity2D

BOX = [((-2.0, -1.5), (8.0, -1.5)), ((-2.0, 1.5), (8.0, 1.5)), ((-2.0, -1.5), (-2.0, 1.5)), ((8.0, -1.5), (8.0, 1.5))]
GOAL = Pose2D(5.0, 0.0, 0.0)
GAPS = ("gap",)
NOWHERE = Pose2D(math.nan, math.nan, math.nan)


def planners():
    """Return name and preset of every planner in every preset."""
    return [(name, preset) for name in planner_names() for preset in presets(name)]


def with_ranges(value):
    return lambda seen: replace(seen, scan=replace(seen.scan, ranges=np.full_like(seen.scan.ranges, value)))


def with_scan(**changes):
    return lambda seen: replace(seen, scan=replace(seen.scan, **changes))


def with_odometry(pose=None, velocity=None):
    def change(seen: Observation) -> Observation:
        odometry = seen.odometry
        return replace(seen, odometry=Odometry(odometry.stamp_ns, pose or odometry.pose, velocity or odometry.velocity))

    return change


# What is wrong with an observation, and the reason that is given for the stop.
FAULTS = {
    "empty scan": (with_scan(ranges=np.empty(0, np.float32)), "the scan is empty"),
    "nothing seen": (with_ranges(np.inf), "the lidar (returns nothing though|has returned nothing yet)"),
    "all too near": (with_ranges(-np.inf), "no valid range"),
    "no valid range": (with_ranges(np.nan), "no valid range"),
    "zero ranges": (with_ranges(0.0), "no valid range"),
    "negative ranges": (with_ranges(-3.0), "no valid range"),
    "angles not a number": (with_scan(angle_min=math.nan), "no usable angles"),
    "odometry pose not a number": (with_odometry(pose=NOWHERE), "odometry holds no usable pose"),
    "odometry yaw not a number": (with_odometry(pose=Pose2D(0.0, 0.0, math.nan)), "odometry holds no usable pose"),
    "odometry infinitely far": (with_odometry(pose=Pose2D(math.inf, 0.0, 0.0)), "odometry holds no usable pose"),
    "velocity not a number": (with_odometry(velocity=Velocity2D(math.nan, 0.0)), "no usable pose or velocity"),
    "yaw rate not a number": (with_odometry(velocity=Velocity2D(0.0, math.nan)), "no usable yaw rate"),
    "localisation not a number": (lambda seen: replace(seen, pose=NOWHERE), "localisation holds no usable pose"),
    "localised on the moon": (lambda seen: replace(seen, pose=Pose2D(1e30, 0.0, 0.0)), "localisation holds no usable"),
}


def observed(world, planner, fault=None):
    """Let the planner decide and the world go on by one cycle; return the decision, which is checked."""
    seen = world.observe()
    decision = planner.step(fault(seen) if fault else seen)
    assert decision.command is None or decision.command.is_finite()
    assert all(math.isfinite(value) for value in decision.diagnostics.values())
    assert decision.plan is None or np.isfinite(decision.plan).all()
    assert decision.reason or decision.status is PlannerStatus.RUNNING
    planner.view()
    world.advance(decision.command)
    return decision


def make(name, preset=None):
    """Return a planner, with a global costmap no larger than this world needs and fewer samples of MPPI."""
    preset = preset or next(iter(presets(name)))
    known = {field for field, _, _ in fields_of(planner_config(name, preset))}
    changes = {"global_costmap.size_m": 24.0, "mppi.samples": 400}
    return make_planner(name, preset, {field: value for field, value in changes.items() if field in known})


@pytest.mark.parametrize("name", planner_names())
def test_a_faulty_observation_stops_the_robot_with_a_reason_and_passes(flat_world, name):
    world, planner = flat_world(BOX), make(name)
    planner.start(Task(Pose2D(7.0, 0.0, 0.0)), 1)
    for _ in range(30):
        observed(world, planner)
    assert world.pose.x > 0.2
    for fault, (change, reason) in FAULTS.items():
        moved = world.pose.x
        for _ in range(4):
            decision = observed(world, planner, change)
            assert decision.command == STOP, fault
            assert decision.status is PlannerStatus.BLOCKED, fault
            assert re.search(reason, decision.reason), fault
        assert world.velocity.linear == 0.0, fault
        for _ in range(8):
            observed(world, planner)
        assert world.pose.x > moved, fault


@pytest.mark.parametrize("name", planner_names())
def test_a_fault_from_the_first_observation_on(flat_world, name):
    planner = make(name)
    for fault, (change, _) in FAULTS.items():
        world = flat_world(BOX)
        planner.start(Task(GOAL), 1)
        for _ in range(3):
            assert observed(world, planner, change).command == STOP, fault
        for _ in range(10):
            observed(world, planner)
        assert world.pose.x > 0.02, fault


@pytest.mark.parametrize("name", planner_names())
def test_scattered_bad_ranges_do_no_harm(flat_world, name):
    def scatter(seen):
        ranges = seen.scan.ranges.copy()
        ranges[::7], ranges[3::11], ranges[5::13] = np.nan, -np.inf, np.inf
        return replace(seen, scan=replace(seen.scan, ranges=ranges))

    world, planner = flat_world(BOX), make(name)
    planner.start(Task(GOAL), 1)
    for _ in range(60):
        observed(world, planner, scatter)
    assert world.pose.x > 0.5


@pytest.mark.parametrize("goal", [NOWHERE, Pose2D(math.inf, 0.0, 0.0), Pose2D(900.0, 0.0, 0.0)])
@pytest.mark.parametrize("name", planner_names())
def test_a_goal_that_is_nowhere_harms_nobody(flat_world, name, goal):
    world, planner = flat_world(BOX), make(name)
    planner.start(Task(goal), 1)
    for _ in range(40):
        decision = observed(world, planner)
    assert math.isfinite(goal.x) or decision.status is not PlannerStatus.RUNNING
    assert world.clearance > 0.3


@pytest.mark.parametrize(("name", "preset"), planners())
def test_a_goal_inside_an_obstacle_is_not_driven_into(flat_world, name, preset):
    world, planner = flat_world(BOX, [(3.0, 0.0, 0.15)]), make(name, preset)
    planner.start(Task(Pose2D(3.0, 0.0, 0.0)), 1)
    decisions = [observed(world, planner) for _ in range(330)]
    assert world.clearance > 0.19
    if name not in GAPS:  # which know no obstacle, only gaps beside it
        assert any(decision.status is not PlannerStatus.RUNNING for decision in decisions)
        assert abs(world.velocity.linear) < 0.02


@pytest.mark.parametrize(("name", "preset"), planners())
def test_an_enclosed_robot_stays_where_it_is(flat_world, name, preset):
    ring = [(0.55 * math.cos(a), 0.55 * math.sin(a), 0.075) for a in np.linspace(0.0, 2.0 * math.pi, 40)]
    # E-Band clears its costmap where a plan is in collision, and then drives into what it had seen: a quirk of its own.
    changes = {"band.reset_costmap_once": False} if name == "eband" else {}
    world, planner = flat_world(cylinders=ring), make_planner(name, preset, changes)
    planner.start(Task(GOAL), 1)
    decisions = [observed(world, planner) for _ in range(240)]
    assert math.hypot(world.pose.x, world.pose.y) < 0.2
    assert decisions[-1].status is not PlannerStatus.RUNNING
    assert abs(world.velocity.linear) < 0.02


@pytest.mark.parametrize(("name", "preset"), planners())
def test_a_plan_that_vanishes_ends_in_a_stop(flat_world, name, preset):
    """Walls appear all round while the robot drives."""
    world, planner = flat_world(BOX), make(name, preset)
    planner.start(Task(GOAL), 1)
    for _ in range(60):
        observed(world, planner)
    x = world.pose.x
    assert x > 0.5
    corners = [(x - 1.0, -1.0), (x + 1.2, -1.0), (x + 1.2, 1.0), (x - 1.0, 1.0)]
    world.cylinders = flat_world(list(zip(corners, corners[1:] + corners[:1], strict=True))).cylinders
    decisions = [observed(world, planner) for _ in range(240)]
    assert world.clearance > 0.19
    assert x - 1.0 < world.pose.x < x + 1.2
    assert any(decision.status is not PlannerStatus.RUNNING for decision in decisions) or name in GAPS


@pytest.mark.parametrize("name", planner_names())
def test_a_map_without_a_free_cell(flat_world, name):
    full = OccupancyMap(np.full((66, 66), 100, np.int8), 0.15, -5.0, -5.0)
    world, planner = flat_world(BOX), make(name)
    planner.start(Task(GOAL, full), 1)
    decision = [observed(world, planner) for _ in range(20)][-1]
    planless = name in (*GAPS, "policy")  # which look at no map
    assert planless or (decision.command in (STOP, None) and decision.status is not PlannerStatus.RUNNING)


@pytest.mark.parametrize("name", planner_names())
def test_the_same_seed_gives_the_same_commands_in_trial_after_trial(flat_world, name):
    planner = make(name)
    runs = []
    for _ in range(2):
        world = flat_world(BOX, [(2.0, 0.2, 0.2)])
        planner.start(Task(GOAL), 42)
        runs.append([observed(world, planner).command for _ in range(60)])
    assert runs[0] == runs[1]
