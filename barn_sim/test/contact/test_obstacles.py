import math
from contextlib import closing

import numpy as np
import pytest
from driving import world_with
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist, pdist

from barn_sim.config import ObstacleConfig, PhysicsConfig, SimulatorConfig
from barn_sim.contact.cylinders import (
    intersect_cylinders,
    near_cylinders,
    nearest_gap,
    robot_gap,
    segment_gap,
)
from barn_sim.simulator import Simulator
from barn_worlds.base.types import Pose2D, Velocity2D

MOVABLE = SimulatorConfig(obstacles=ObstacleConfig(movable=True))
HERE = Pose2D(-2.25, 5.0, 0.5 * math.pi)


def row(length):
    """Return a world with cylinders one behind the other, ahead of the robot's middle."""
    return world_with(*((14, 5 + k) for k in range(length)), row=0)


def push(world, config, steps, speed=0.5, start=HERE):
    """Drive straight on; return the last readings and the displaced obstacles."""
    with closing(Simulator(world, config, start, 0)) as simulator:
        for _ in range(steps):
            sensors = simulator.step(Velocity2D(speed, 0.0))
        return sensors, simulator.moved_obstacles()


def test_a_single_cylinder_is_pushed_along():
    world = row(1)
    sensors, moved = push(world, MOVABLE, 60)
    assert moved.indices.tolist() == [0]
    assert sensors.truth.pose.y > world.obstacles_m[0, 1] + 0.2
    assert moved.positions[0, 1] > world.obstacles_m[0, 1] + 0.3


def test_the_same_cylinder_stops_the_robot_if_it_cannot_move():
    world = row(1)
    sensors, moved = push(world, SimulatorConfig(), 60)
    assert len(moved.indices) == 0
    assert sensors.truth.pose.y < world.obstacles_m[0, 1] - 0.2


def test_cylinders_that_nothing_comes_near_stand_still():
    world = world_with((14, 5), (14, 12), (3, 5), (27, 5), row=0)  # numbered by row
    _, moved = push(world, MOVABLE, 30)
    assert moved.indices.tolist() == [1]


def test_a_push_is_handed_on_along_a_row():
    world = row(4)
    _, moved = push(world, MOVABLE, 80)
    assert moved.indices.tolist() == [0, 1, 2, 3]
    assert (moved.positions[:, 1] > world.obstacles_m[:, 1] + 0.05).all()


def test_pushed_cylinders_do_not_end_inside_one_another(simulators):
    world = world_with(*((14 + k % 3, 5 + k // 3) for k in range(9)), row=0)
    simulator = simulators(world, MOVABLE, HERE, 0)
    for _ in range(80):
        simulator.step(Velocity2D(0.5, 0.0))
    centers, tilted = simulator.motion.obstacles.cross_section(0.3)
    upright = centers[np.isfinite(centers[:, 0])][: 9 - len(tilted)]
    assert pdist(upright).min() > 0.15 - 0.01


def test_the_robot_cannot_push_a_long_row():
    """Each of 1 kg with friction 1 resists 9.8 N; wheels with friction 0.5 under 18.4 kg push 90 N at most."""
    at_short, _ = push(row(3), MOVABLE, 100)
    at_long, _ = push(row(24), MOVABLE, 100)
    assert at_short.truth.pose.y > at_long.truth.pose.y + 0.3


@pytest.mark.parametrize("movable", [True, False])
def test_containment_can_be_left_standing(movable):
    obstacles = ObstacleConfig(movable=True, containment_movable=movable)
    config = SimulatorConfig(obstacles=obstacles)
    _, moved = push(world_with(), config, 60, start=Pose2D(-0.6, 2.0, 0.0))
    assert (len(moved.indices) > 0) is movable


def test_the_lidar_sees_a_pushed_cylinder_where_it_is_now(simulators):
    simulator = simulators(row(1), MOVABLE, HERE, 0)
    for _ in range(60):
        sensors = simulator.step(Velocity2D(0.5, 0.0))
    (x, y, _) = simulator.moved_obstacles().positions[0]
    centers, _ = simulator.motion.obstacles.cross_section(0.3)
    place = (sensors.truth.pose @ Pose2D(0.055, 0.0, 0.0)).inverse() @ Pose2D(x, y, 0.0)
    bearing = math.atan2(place.y, place.x)
    beam = np.argmin(np.abs(sensors.scan.angles() - bearing))
    if np.isfinite(centers[0, 0]):
        expected = math.hypot(*place.position) - 0.075
        assert sensors.scan.ranges[beam] == pytest.approx(expected, abs=0.02)
    else:  # it has fallen over: what is seen there lies behind
        assert sensors.scan.ranges[beam] > 0.5


@pytest.mark.parametrize("friction, tips", [(0.5, False), (3.0, True)])
def test_a_pushed_cylinder_tips_where_the_ground_holds_its_foot(friction, tips):
    """Pushed at height h at least (the chassis' lower edge, 0.0635 m), it tips if friction x h exceeds its radius."""
    assert (friction * 0.0635 > 0.075) is tips
    smooth = PhysicsConfig(chassis_friction=0.0)  # or the chassis holds it upright
    obstacles = ObstacleConfig(movable=True, friction=friction)
    config = SimulatorConfig(physics=smooth, obstacles=obstacles)
    # gently: a blow could tip it as well
    _, moved = push(row(1), config, 140, speed=0.2)
    x, y, _, _ = moved.quaternions[0].tolist()
    assert (abs(1.0 - 2.0 * (x * x + y * y)) < 0.5) is tips


def test_driving_away_takes_the_bodies_out_again(simulators):
    simulator = simulators(row(1), MOVABLE, HERE, 0)
    for steps, speed, bodies in ((80, 0.2, 1), (100, -0.5, 0)):
        for _ in range(steps):
            simulator.step(Velocity2D(speed, 0.0))
        assert len(simulator.motion.obstacles._bodies) == bodies
        assert len(simulator.moved_obstacles().positions) == 1


# The kernels against plain geometry.

EXTENT = np.array([-0.229, -0.2078, 0.229, 0.2078])
coordinates = st.floats(-1.5, 1.5)
points = st.tuples(coordinates, coordinates)
ROBOT = (0.1, -0.2, 0.5, EXTENT)  # with its pose


@given(points, points, points, st.floats(-3.2, 3.2))
def test_the_gap_to_the_robot_is_that_of_many_points(a, b, place, yaw):
    gap = robot_gap(np.array([*a, *b]), *place, yaw, EXTENT)
    local = Pose2D(*place, yaw).inverse().transform(np.linspace(a, b, 400))
    outside = np.maximum(np.maximum(EXTENT[:2] - local, local - EXTENT[2:]), 0.0)
    exact = np.hypot(*outside.T).min()
    spacing = math.dist(a, b) / 8
    assert exact - 1e-3 * spacing - 1e-9 <= gap <= exact + 0.5 * spacing + 1e-9


@given(points, points, points, points)
def test_the_gap_between_cylinders_is_that_of_many_points(a, b, c, d):
    gap = segment_gap(np.array([*a, *b]), np.array([*c, *d]))
    exact = cdist(np.linspace(a, b, 200), np.linspace(c, d, 200)).min()
    slack = math.dist(a, b) / 8 + math.dist(c, d) / 199
    assert abs(gap - exact) <= slack + 1e-9


def test_the_nearest_gap_is_the_smallest_of_all():
    rng = np.random.default_rng(0)
    extent = np.array([-0.3, -0.2, 0.25, 0.2])
    for _ in range(200):
        segments = np.tile(rng.uniform(-3.0, 3.0, (40, 2)), 2)
        segments[::4, 2:] += rng.uniform(-0.7, 0.7, (10, 2))  # lying
        x, y, yaw = rng.uniform(-3.0, 3.0, 3)
        expected = min(robot_gap(segment, x, y, yaw, extent) for segment in segments)
        assert nearest_gap(segments, x, y, yaw, extent) == expected


def test_near_cylinders_are_found_by_distance_alone():
    rng = np.random.default_rng(2)
    points = rng.uniform(-1.0, 1.0, (300, 2))
    segments = np.hstack([points, points])
    none = np.zeros(300, np.bool_)
    pushed = none.copy()
    pushed[:3] = True
    near, free_m = near_cylinders(segments, ~none, pushed, *ROBOT, 0.075, 0.03, 0.005)
    gaps = np.array([robot_gap(segment, *ROBOT) for segment in segments])
    near_pushed = cdist(points, points[:3]).min(axis=1) < 0.155
    assert near.tolist() == np.flatnonzero((gaps < 0.105) | near_pushed).tolist()
    few, _ = near_cylinders(segments, none, pushed, *ROBOT, 0.075, 0.03, 0.005)
    assert len(few) == 0
    assert free_m <= 0.0  # what is pushed may come near by itself


def test_the_robot_moves_safely_within_the_free_distance():
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (60, 2))
    segments = np.hstack([points, points])
    none = np.zeros(60, np.bool_)
    near, free_m = near_cylinders(segments, ~none, none, *ROBOT, 0.075, 0.03, 0.005)
    gaps = np.array([robot_gap(segment, *ROBOT) for segment in segments])
    assert 0.0 < free_m <= np.delete(gaps, near).min() - 0.105


@pytest.mark.parametrize("tilt", [0.0, 0.005, 0.3, 1.5])
def test_a_tilted_cylinder_is_handed_over_as_such(tilt):
    q = [math.sin(tilt / 2), 0.0, 0.0, math.cos(tilt / 2)]  # about x: leans to -y
    states = np.array([[1.0, 2.0, 0.5, *q]])
    centers = np.array([[1.0, 2.0]])
    tilted = np.empty((1, 7))
    count = intersect_cylinders(np.array([0]), states, 0.5, 0.3, centers, tilted)
    if tilt < math.radians(0.5):
        assert count == 0
        assert centers[0] == pytest.approx([1.0, 2.0 + 0.2 * math.tan(tilt)])
    else:
        assert count == 1
        assert np.isinf(centers).all()
        axis = [0.0, -math.sin(tilt), math.cos(tilt)]
        assert tilted[0] == pytest.approx([1.0, 2.0, 0.2, *axis, 0.5])
