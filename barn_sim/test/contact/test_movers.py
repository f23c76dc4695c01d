"""Walls and moving obstacles: rays and distances against plain references, contacts, and free motion beside them."""

import math
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from driving import wander
from hypothesis import given, settings
from hypothesis import strategies as st

from barn_sim.config import ObstacleConfig, SimulatorConfig, with_robot
from barn_sim.contact.scene import ScenePool
from barn_sim.motion import robot_motion
from barn_sim.seeds import phase_s
from barn_sim.sensors.lidar import NO_SHAPES, Lidar
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import unit_vectors
from barn_worlds.base.types import ORIGIN, Pose2D, Velocity2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.datasets.generate_motion import add_motion, motion_class
from barn_worlds.geometry.bodies import shape_rows
from barn_worlds.moving.motion import Motion, MovingObstacle, Wall
from barn_worlds.robots.files import load_robot
from barn_worlds.worlds.world import World

QUIET = replace(SimulatorConfig().lidar, noise_m=0.0)
FROM_ZERO = SimulatorConfig(obstacles=ObstacleConfig(random_phase=False), lidar=QUIET)


def arena(*moving, walls=()):
    path = np.array([[row, 20] for row in range(42, 1, -1)])
    grid = np.zeros((45, 41), np.bool_)
    corner_m = (-10.25, -10.25)
    return World(
        "arena", grid, path, 0.5, walls=walls, moving=moving, corner_m=corner_m
    )


def person(*keys, period_s=10.0, **fields):
    motion = Motion("linear", period_s, keys)
    return MovingObstacle("person", radius_m=0.3, motion=motion, **fields)


def cart(*keys):
    motion = Motion("linear", 10.0, keys)
    return MovingObstacle("cart", "box", size_x_m=1.0, size_y_m=0.6, motion=motion)


@pytest.fixture
def simulator(simulators):
    """Make a simulator of a world with a robot at its middle."""
    return lambda world: simulators(world, FROM_ZERO, ORIGIN, 0)


def random_shapes(rng, count):
    box = rng.random(count) < 0.5
    radius = np.where(box, 0.0, rng.uniform(0.05, 1.0, count))
    size = np.where(box[:, None], rng.uniform(0.05, 3.0, (count, 2)), 0.0)
    where = rng.uniform(-4.0, 4.0, (count, 2))
    yaw = rng.uniform(-math.pi, math.pi, count)
    return shape_rows(where, radius, size, yaw)


def plain_hit(origin, beam, shape):
    """One beam against one shape: a circle by the quadratic equation, a box by each of its four sides."""
    center = shape[:2]
    if shape[2]:
        to = center - origin
        along = beam @ to
        square = to @ to - shape[2] ** 2
        root = along**2 - square
        near = along - math.sqrt(root) if root >= 0.0 else math.inf
        return 0.0 if square <= 0.0 else near if near >= 0.0 else math.inf
    ahead = shape[3] * shape[5:7]
    left = shape[4] * np.array([-shape[6], shape[5]])
    away = origin - center
    if abs(away @ ahead) <= ahead @ ahead and abs(away @ left) <= left @ left:
        return 0.0
    corners = [ahead + left, left - ahead, -ahead - left, ahead - left]
    hits = [math.inf]
    for start, other in zip(corners, [*corners[1:], corners[0]], strict=True):
        matrix = np.column_stack([beam, start - other])
        if abs(np.linalg.det(matrix)) > 1e-12:
            distance, share = np.linalg.solve(matrix, start - away)
            if distance >= 0.0 and 0.0 <= share <= 1.0:
                hits.append(distance)
    return min(hits)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 8))
def test_rays_agree_with_a_plain_reference(seed, count):
    rng = np.random.default_rng(seed)
    shapes = random_shapes(rng, count)
    pose = Pose2D(*rng.uniform(-2.0, 2.0, 2), rng.uniform(-3.2, 3.2))
    config = replace(QUIET, beams=90, range_max_m=5.0)
    scan = Lidar(config, rng).scan(0, pose, np.empty((0, 2)), 0.1, NO_SHAPES, shapes)
    sensor = pose @ Pose2D(config.mount_x_m, 0.0, 0.0)
    angles = scan.angles() + sensor.yaw
    beams = unit_vectors(angles)
    origin = np.array(sensor.position)
    expected = np.full(len(beams), np.inf)
    for k, beam in enumerate(beams):
        hits = [plain_hit(origin, beam, shape) for shape in shapes]
        expected[k] = min(hits, default=math.inf)
    expected[expected < scan.range_min] = -np.inf
    expected[expected > scan.range_max] = np.inf
    same = np.isclose(scan.ranges, expected, atol=1e-5) | (scan.ranges == expected)
    # a beam through a corner, along a tangent or at a limit may be told either way
    assert (~same).sum() <= 1


def test_the_lidar_sees_obstacles_where_they_are_at_its_own_time(simulator):
    world = arena(person((0.0, 2.0, 0.0), (10.0, 12.0, 0.0)))
    robot = simulator(world)
    for _ in range(20):
        sensors = robot.step(None)
        ranges = sensors.scan.ranges
        x, _ = world.tracks.at(sensors.stamp_ns * 1e-9)[0][0]
        ahead = x - 0.3 - FROM_ZERO.lidar.mount_x_m - sensors.truth.pose.x
        assert ranges[len(ranges) // 2] == pytest.approx(ahead, abs=1e-3)


def test_what_is_lower_than_the_scan_is_not_seen_but_touched(simulator):
    low = person((0.0, 2.0, 0.0), (1.0, 0.4, 0.0), height_m=0.2)
    robot = simulator(arena(low))
    readings = [robot.step(None) for _ in range(40)]
    assert all(np.isinf(sensors.scan.ranges).all() for sensors in readings)
    assert any(sensors.collision for sensors in readings)


@pytest.mark.parametrize("kind", [person, cart])
def test_an_obstacle_pushes_the_robot_and_is_not_pushed(kind, simulator):
    """The robot is struck from the side at 1 m/s, against its tires, and ends up moving with the obstacle."""
    robot = simulator(arena(kind((0.0, 0.0, 2.0), (5.0, 0.0, -3.0))))
    sensors = [robot.step(None) for _ in range(60)]
    touched = next(k for k, reading in enumerate(sensors) if reading.collision)
    at_s = sensors[touched].stamp_ns * 1e-9
    edge = 2.0 - at_s - 0.3  # the radius of the one, half the width of the other
    assert edge == pytest.approx(robot.motion.model.extent[3], abs=0.07)
    pushed = [reading.truth.pose.y for reading in sensors[touched + 5 : touched + 15]]
    assert np.diff(pushed) == pytest.approx(-0.05, abs=0.01)  # 1 m/s


def test_a_wall_stops_the_robot(simulator):
    wall = Wall(x_m=2.0, y_m=0.0, size_x_m=0.5, size_y_m=20.0)
    robot = simulator(arena(walls=(wall,)))
    sensors = [robot.step(Velocity2D(1.0, 0.0)) for _ in range(60)]
    front = robot.motion.model.extent[2]
    assert any(reading.collision for reading in sensors)
    assert sensors[-1].truth.pose.x + front == pytest.approx(1.75, abs=0.02)


def test_obstacles_pass_through_cylinders_walls_and_each_other(simulators):
    """What moves keeps to its track though a cylinder that could be pushed, another and a wall are in its way."""
    grid = np.zeros((45, 41), np.bool_)
    grid[22, 21] = True
    first = person((0.0, 0.9, 2.0), (5.0, 0.9, -3.0))
    second = cart((0.0, 0.9, -3.0), (5.0, 0.9, 2.0))
    wall = Wall(x_m=1.2, y_m=-0.8, size_x_m=0.4, size_y_m=0.4)
    world = replace(arena(first, second, walls=(wall,)), grid=grid)
    movable = ObstacleConfig(movable=True, random_phase=False)
    config = replace(FROM_ZERO, obstacles=movable)
    simulator = simulators(world, config, Pose2D(0.2, 0.0, 0.0), 0)
    for _ in range(80):
        simulator.step(None)
    assert len(simulator.moved_obstacles().indices) == 0


def test_an_obstacle_that_jumps_onto_the_robot_touches_it(simulator):
    """It is 5 m away when its motion begins anew, half a meter in front of the robot."""
    keys = ((0.0, 0.5, 0.0), (1.0, 5.0, 0.0))
    robot = simulator(arena(person(*keys, period_s=2.0, phase_s=0.25)))
    readings = [robot.step(None) for _ in range(60)]
    touched = next(reading for reading in readings if reading.collision)
    assert touched.stamp_ns * 1e-9 == pytest.approx(1.75, abs=0.051)
    pose = robot.read_truth().pose
    assert math.hypot(*pose.position) < 5.0


def test_the_phase_is_drawn_from_the_seed_and_can_be_zero(simulators):
    world = open_dataset("dynabarn60").load(50)
    config = replace(SimulatorConfig(), lidar=QUIET)
    start = Pose2D(11.0, 0.0, math.pi)
    phases = [phase_s(world, config, start, seed) for seed in range(200)]
    longest = max(obstacle.motion.period_s for obstacle in world.moving)
    assert len(set(phases)) == 200
    assert 0.0 <= min(phases) < 0.1 * longest
    assert 0.9 * longest < max(phases) <= longest
    from_zero = replace(config, obstacles=ObstacleConfig(random_phase=False))
    assert phase_s(world, from_zero, start, 3) == 0.0
    robots = [simulators(world, config, start, seed) for seed in (3, 3, 4)]
    assert [robot.phase_s for robot in robots] == [phases[k] for k in (3, 3, 4)]
    first, again, other = (robot.sense().scan.ranges.tobytes() for robot in robots)
    assert first == again != other


def wandering_robot(seed, scenes, rng, robot):
    """Return a robot among moving obstacles; where the seed is odd, cylinders move, too."""
    obstacles = ObstacleConfig(movable=bool(seed % 2))
    config = with_robot(SimulatorConfig(obstacles=obstacles), load_robot(robot))
    if seed % 3:
        world = open_dataset("dynabarn60").load(int(rng.integers(60)))
        start = Pose2D(*rng.uniform(-9.0, 9.0, 2), rng.uniform(-3.1, 3.1))
    else:
        still = open_dataset("barn300").load(int(rng.integers(300)))
        world = add_motion(still, motion_class("easy"), seed, 6)
        start = Pose2D(-2.25, 3.0, 1.57)
    return Simulator(world, config, start, seed, scenes)


def drive(seed, scenes, robot="jackal"):
    """Return the states after every step and how many steps ended freely."""
    rng = np.random.default_rng(seed)
    with closing(wandering_robot(seed, scenes, rng, robot)) as simulator:
        return wander(simulator, rng, 160)


@pytest.mark.parametrize("robot", ["jackal", "turtlebot4", "husky"])
def test_contacts_do_not_depend_on_the_clients_past(robot, scenes):
    for seed in range(9):
        with closing(ScenePool()) as new:
            expected, _ = drive(seed, new, robot)
        states, free = drive(seed, scenes, robot)
        assert states == expected
        assert free > 0 or any(state[0] for state in states)


@pytest.mark.parametrize("seed", range(12))
def test_no_contact_is_missed(seed, scenes, monkeypatch):
    """The robot moves as in PyBullet all the time, until they touch something together."""
    states, _ = drive(seed, scenes)
    monkeypatch.setattr(robot_motion, "contact_gap_m", lambda _: 1e3)
    expected, free = drive(seed, scenes)
    assert free == 0
    for (touched, truth, *_), (is_touched, pose, *_) in zip(
        states, expected, strict=True
    ):
        assert touched == is_touched
        if touched:
            break
        assert truth.pose.distance(pose.pose) < 1e-9


def test_the_drives_touch_obstacles_and_leave_them(scenes):
    drives = [drive(seed, scenes)[0] for seed in range(6)]
    touched = [[state[0] for state in states] for states in drives]
    assert any(any(states) and not states[-1] for states in touched)
    assert not all(any(states) for states in touched)
