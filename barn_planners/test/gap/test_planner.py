"""Follow-the-gap: free distances against a plain reference, its decisions, and a drive in a small flat world."""

import math

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from barn_planners.gap.planner import GapConfig, GapPlanner, free_distances
from barn_planners.interface import Decision, PlannerStatus, Task
from barn_planners.navigation.scan_planner import scan_points
from barn_planners.registry import make_planner
from barn_worlds.base.types import STOP, Pose2D, Scan, Velocity2D


def decide(flat_world, discs, goal=(5.0, 0.0)):
    """Return what a planner decides before discs (x, y, radius), and the planner."""
    planner = GapPlanner(GapConfig())
    planner.start(Task(Pose2D(*goal, 0.0)), 0)
    world = flat_world(cylinders=discs, angles=np.linspace(-math.pi, math.pi, 721))
    return planner.step(world.observe()), planner


def test_free_distances_equal_small_steps():
    rng = np.random.default_rng(3)
    points = rng.uniform(-2.0, 2.0, (40, 2))
    points = points[np.hypot(*points.T) > 0.3]
    directions = np.linspace(-2.2, 2.2, 45)
    traveled = np.arange(0.0, 1.5, 1e-3)
    expected = []
    for direction in directions:
        places = np.outer(traveled, [math.cos(direction), math.sin(direction)])
        blocked = cdist(places, points).min(axis=1) < 0.28
        expected.append(traveled[blocked.argmax()] if blocked.any() else 1.5)
    distances = free_distances(points, directions, 0.28, 1.5)
    np.testing.assert_allclose(distances, expected, atol=2e-3)


def test_returns_leave_out_what_is_no_range():
    ranges = np.array([1.0, np.nan, np.inf, -np.inf, 0.05, 2.9, 1.0], np.float32)
    scan = Scan(0, ranges, 0.0, math.pi / 2.0, 0.1, 30.0)
    points = scan_points(scan, Pose2D(0.5, 0.0, 0.0), 2.0)
    np.testing.assert_allclose(points, [(1.5, 0.0), (-0.5, 0.0)], atol=1e-12)


def test_free_way_is_driven_at_full_speed(flat_world):
    decision, _ = decide(flat_world, [(20.0, 9.0, 0.1)])
    assert decision.command == Velocity2D(0.5, 0.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_steers_round_what_is_in_the_way(flat_world, side):
    decision, planner = decide(flat_world, [(1.0, -0.1 * side, 0.1)])
    assert math.copysign(1.0, decision.command.angular) == side
    assert 0.0 < decision.command.linear < 0.5
    view = planner.view()
    assert view.candidates.shape == (151, 2, 2)
    assert view.candidate_costs.min() == pytest.approx(0.0)


def test_turns_to_a_goal_behind(flat_world):
    decision, _ = decide(flat_world, [(20.0, 0.0, 0.1)], goal=(-3.0, 1.0))
    assert decision.command == Velocity2D(0.0, 1.57)


def test_stops_before_a_wall_and_turns_away(flat_world):
    wall = [(0.42, y, 0.02) for y in np.arange(-0.6, 0.61, 0.03)]
    decision, _ = decide(flat_world, wall)
    assert decision.command.linear == 0.0
    assert decision.command.angular != 0.0


def test_stops_where_nothing_is_open(flat_world, ring):
    decision, _ = decide(flat_world, ring(0.4, 0.05, 60))
    assert decision == Decision(STOP, PlannerStatus.BLOCKED, "no gap is open")


def test_reaches_the_goal_between_obstacles(flat_world):
    posts = [(2.0, 0.1, 0.2), (3.0, -0.9, 0.2), (3.2, 0.8, 0.2), (4.5, -0.2, 0.2)]
    world = flat_world(cylinders=posts)
    planner = make_planner("gap", "challenge")
    status = world.drive(planner, Pose2D(6.0, 0.0, 0.0), 40.0)
    assert status is PlannerStatus.GOAL_REACHED
    assert world.clearance > 0.24
