"""Circles and tracks against what really moves, and the planners that use them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from predictive_planners.planners import add_moving_costs
from predictive_planners.tracker import (
    Tracker,
    TrackerConfig,
    fit_circle,
    meeting_distances,
    transform_discs,
)

from barn_planners.interface import Observation, PlannerStatus, Task
from barn_planners.registry import make_planner
from barn_planners.robots import fit_parameters
from barn_worlds.base.arrays import unit_vectors
from barn_worlds.base.types import STOP, Odometry, Pose2D, Scan
from barn_worlds.robots.files import load_robot

PERIOD_NS = 50_000_000
BEAMS = 721


def scan_of(pose, discs, stamp_ns=0):
    """Return the exact scan, all round, of discs (x, y, radius).

    The lidar is 0.055 m ahead of the robot's center.
    """
    angles = np.linspace(-math.pi, math.pi, BEAMS)
    sensor = pose @ Pose2D(0.055, 0.0, 0.0)
    ranges = np.full(BEAMS, np.inf)
    for x, y, radius in discs:
        at = sensor.inverse() @ Pose2D(x, y, 0.0)
        along = at.x * np.cos(angles) + at.y * np.sin(angles)
        inside = radius**2 - (at.x**2 + at.y**2 - along**2)
        hit = (inside > 0.0) & (along > 0.0)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(inside[hit]))
    return Scan(
        stamp_ns,
        ranges.astype(np.float32),
        -math.pi,
        2.0 * math.pi / (BEAMS - 1),
        0.01,
        30.0,
    )


def observe(
    step: int, pose: Pose2D, discs: list[tuple[float, float, float]]
) -> Observation:
    stamp_ns = step * PERIOD_NS
    return Observation(
        stamp_ns, Odometry(stamp_ns, pose, STOP), scan_of(pose, discs, stamp_ns), pose
    )


def tracks(
    discs_at, pose_at=lambda _: Pose2D(0.0, 0.0, 0.0), steps=30, **changes
) -> np.ndarray:
    """Return what is tracked after some scans of discs (x, y, radius) at times."""
    tracker = Tracker(TrackerConfig(**changes), Pose2D(0.055, 0.0, 0.0))
    for step in range(steps):
        discs = tracker.update(
            observe(step, pose_at(step * 0.05), discs_at(step * 0.05))
        )
    return discs


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_circle_is_found_from_an_arc_of_it(seed):
    rng = np.random.default_rng(seed)
    center = rng.uniform(-5.0, 5.0, 2)
    radius = rng.uniform(0.1, 2.0)
    angles = rng.uniform(0.0, 6.0) + np.linspace(0.0, rng.uniform(0.5, 3.0), 20)
    directions = unit_vectors(angles)
    points = center + radius * directions
    fitted_center, radius_m, roundness = fit_circle(points)
    assert fitted_center == pytest.approx(center, abs=1e-6)
    assert (radius_m, roundness) == pytest.approx((radius, 0.0), abs=1e-6)


def test_a_line_is_no_circle():
    line = np.stack([np.linspace(0.0, 1.0, 10), np.ones(10)], axis=1)
    assert math.isinf(fit_circle(line)[1])


@pytest.mark.parametrize("velocity", [(1.0, 0.0), (-0.8, -1.0), (0.0, 2.0)])
def test_a_disc_is_tracked_from_a_robot_that_drives_and_turns(velocity):
    def disc(time_s):
        return [(3.0 + velocity[0] * time_s, -1.0 + velocity[1] * time_s, 0.5)]

    discs = tracks(disc, lambda time_s: Pose2D(0.5 * time_s, 0.0, 0.6 * time_s))
    ((x, y, radius),) = disc(29 * 0.05)
    expected = np.array([[x, y, *velocity, radius]])
    assert discs == pytest.approx(expected, abs=0.03)


def test_what_stands_is_not_tracked_however_the_robot_moves():
    discs = [(2.0, 1.0, 0.3), (3.0, -1.0, 0.5), (4.0, 0.0, 0.075)]
    assert (
        len(tracks(lambda _: discs, lambda time_s: Pose2D(0.5 * time_s, 0.0, time_s)))
        == 0
    )


def test_two_that_cross_keep_their_velocities():
    discs = tracks(
        lambda t: [(3.0, -1.0 + 1.0 * t, 0.3), (1.5, 1.2 - 1.0 * t, 0.3)], steps=20
    )
    by_x = discs[np.argsort(discs[:, 0])]
    velocities = np.array([[0.0, -1.0], [0.0, 1.0]])
    assert by_x[:, 2:4] == pytest.approx(velocities, abs=0.1)


def test_a_track_ends_unobserved_and_a_reset_forgets_all():
    def gone(time_s):
        return [] if time_s > 1.0 else [(3.0, time_s, 0.5)]

    assert len(tracks(gone, steps=21)) == 1
    assert len(tracks(gone, steps=40)) == 0
    tracker = Tracker(TrackerConfig(), Pose2D(0.055, 0.0, 0.0))
    for step in range(20):
        tracker.update(observe(step, Pose2D(0.0, 0.0, 0.0), [(3.0, 0.05 * step, 0.5)]))
    again = tracker.update(
        observe(19, Pose2D(0.0, 0.0, 0.0), [])
    )  # the same instant again changes nothing
    assert len(again) == len(tracker.moving_discs()) == 1
    tracker.reset()
    assert len(tracker.moving_discs()) == 0


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_meeting_distances_equal_small_steps(seed):
    rng = np.random.default_rng(seed)
    discs = np.column_stack(
        [
            rng.uniform(-3.0, 3.0, (4, 2)),
            rng.uniform(-2.0, 2.0, (4, 2)),
            rng.uniform(0.1, 0.5, 4),
        ]
    )
    directions = np.linspace(-2.0, 2.0, 9)
    speed = 0.5
    radius = 0.28
    distances = meeting_distances(discs, directions, radius, speed)
    if (np.hypot(*discs[:, :2].T) <= discs[:, 4] + radius).any():
        return  # touched already: only those count that come nearer
    way = np.arange(0.0, 4.0, 0.001)
    for direction, distance in zip(directions, distances, strict=True):
        robot = way[:, None] * [math.cos(direction), math.sin(direction)]
        positions = (
            discs[None, :, :2] + (way / speed)[:, None, None] * discs[None, :, 2:4]
        )
        offsets = np.moveaxis(positions - robot[:, None], 2, 0)
        gap = (np.hypot(*offsets) - discs[:, 4] - radius).min(axis=1)
        expected = way[gap <= 0.0][0] if (gap <= 0.0).any() else math.inf
        assert distance <= expected + 1e-9
        if distance < 4.0:
            step = min(round(distance / 0.001), len(gap) - 1)
            assert gap[step] <= 0.006


def test_discs_of_one_frame_in_another():
    disc = np.array([[2.0, 0.0, 0.0, 1.0, 0.3]])
    transformed = transform_discs(disc, Pose2D(1.0, 0.0, math.pi / 2).inverse())
    expected = np.array([[0.0, -1.0, 1.0, 0.0, 0.3]])
    assert transformed == pytest.approx(expected)
    assert transform_discs(transformed, Pose2D(1.0, 0.0, math.pi / 2)) == pytest.approx(
        disc
    )


def crossing(name: str, **overrides) -> tuple[float, float]:
    """Drive (exactly as told) to a goal 6 m ahead past a disc that crosses.

    Return smallest gap and final x.
    """
    planner = make_planner(name, "challenge", overrides)
    planner.start(Task(Pose2D(6.0, 0.0, 0.0)), 0)
    pose = Pose2D(0.0, 0.0, 0.0)
    velocity = STOP
    nearest = math.inf
    for step in range(240):
        time_s = 0.05 * step
        stamp_ns = step * PERIOD_NS
        x = 2.0
        y = -2.9 + 0.8 * time_s
        nearest = min(nearest, math.hypot(pose.x - x, pose.y - y) - 0.5)
        scan = scan_of(pose, [(x, y, 0.5)], stamp_ns)
        scan = replace(
            scan, ranges=np.minimum(scan.ranges, np.float32(9.0))
        )  # walls behind, which clear costmaps
        decision = planner.step(
            Observation(stamp_ns, Odometry(stamp_ns, pose, velocity), scan, pose)
        )
        velocity = decision.command or velocity
        assert velocity.is_finite() and decision.status is not PlannerStatus.FAILED
        yaw = pose.yaw + 0.05 * velocity.angular
        pose = Pose2D(
            pose.x + 0.05 * velocity.linear * math.cos(yaw),
            pose.y + 0.05 * velocity.linear * math.sin(yaw),
            yaw,
        )
    return nearest, pose.x


def test_predicting_keeps_farther_from_a_disc_that_crosses():
    plain = crossing("gap")
    predictive = crossing("gap_predictive")
    assert predictive[0] > plain[0] and predictive[0] > 0.28
    assert predictive[1] > 2.5


def test_trajectories_of_mppi_keep_clear_of_where_a_disc_will_be():
    plain = crossing("mppi", **{"mppi.samples": 300})
    predictive = crossing("mppi_predictive", **{"mppi.samples": 300})
    assert predictive[0] > plain[0] and predictive[0] > 0.28
    assert predictive[1] > 0.5


@pytest.mark.parametrize("name", ["gap_predictive", "mppi_predictive"])
def test_a_scan_without_ranges_stops_the_robot_with_a_reason(name):
    planner = make_planner(name)
    planner.start(Task(Pose2D(6.0, 0.0, 0.0)), 0)
    observation = observe(0, Pose2D(0.0, 0.0, 0.0), [])
    for ranges, reason in (
        (np.empty(0, np.float32), "empty"),
        (np.full(BEAMS, np.nan, np.float32), "no valid range"),
    ):
        decision = planner.step(
            replace(observation, scan=replace(observation.scan, ranges=ranges))
        )
        assert decision.command == STOP and decision.status is PlannerStatus.BLOCKED
        assert reason in decision.reason


@pytest.mark.parametrize(
    "name, own_config", [("gap", []), ("mppi", ["moving_margin_m"])]
)
def test_another_robot_changes_the_plain_planner_and_the_margin(name, own_config):
    husky = load_robot("husky")
    changes, plain = (
        fit_parameters(planner, "default", {}, husky)
        for planner in (f"{name}_predictive", name)
    )
    assert changes.keys() == {*plain, *own_config}
    assert {key: changes[key] for key in plain} == plain
    assert all(changes[key] > 0.1 for key in own_config)


def test_costs_of_meeting_discs_equal_a_plain_reference():
    rng = np.random.default_rng(4)
    xs, ys = rng.uniform(-1.0, 1.0, (2, 20, 30))
    poses = np.stack([xs, ys, np.zeros_like(xs)], axis=1)
    discs = np.column_stack(
        [
            rng.uniform(-2.0, 2.0, (3, 2)),
            rng.uniform(-1.0, 1.0, (3, 2)),
            [0.1, 0.2, 0.3],
        ]
    )
    costs = np.ones(30)
    add_moving_costs(costs, poses, 0.05, discs, 0.2, 10.0)
    times = 0.05 * np.arange(1, 21)[:, None, None]
    dx = discs[:, 0] + times * discs[:, 2] - xs[..., None]
    dy = discs[:, 1] + times * discs[:, 3] - ys[..., None]
    away = np.hypot(dx, dy)
    met = (away < discs[:, 4] + 0.2).any(axis=2)
    assert met.any() and not met[0].all()
    cost = 10.0 * (1.0 - 0.5 * met.argmax(axis=0) / 20)
    expected = np.where(met.any(axis=0), cost, 0.0)
    np.testing.assert_allclose(costs, 1.0 + expected, rtol=1e-12)
