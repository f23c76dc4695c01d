"""Robots other than the Jackal in the simulator."""

import math
from contextlib import closing
from dataclasses import replace
from operator import attrgetter
from xml.etree.ElementTree import fromstring

import numpy as np
import pytest
from driving import readings_of, world_with

from barn_sim.body.model import (
    description_text,
    fixed_frames,
    joint_names,
    model_of,
    robot_description,
)
from barn_sim.config import (
    PRESETS,
    PhysicsConfig,
    SimulatorConfig,
    robot_of,
    with_robot,
)
from barn_sim.contact.bullet import bullet
from barn_sim.contact.cylinders import nearest_gap
from barn_sim.contact.obstacles import contact_gap_m
from barn_sim.contact.scene import ContactScene
from barn_sim.messages import SimulatorMessages
from barn_sim.simulator import Simulator
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.types import ORIGIN, Pose2D, Velocity2D
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.messages import decode
from barn_worlds.robots.files import ROBOTS, load_robot
from barn_worlds.robots.urdf import read_chassis

STEP_S = 0.05
START = Pose2D(-2.25, 3.0, 1.57)
NAME = attrgetter("name")


@pytest.fixture(scope="module")
def plain():
    """A world with nothing but its side walls, 9 m wide."""
    return world_with(0, -1, row=30, size=60)


def driven(world, config, command, steps, start=START):
    simulator = Simulator(world, config, start, 0)
    return readings_of(simulator, [Velocity2D(*command)] * steps)


@pytest.mark.parametrize("part", ["drive", "lidar", "odometry", "wheel_friction"])
def test_a_robot_with_another_part_is_not_taken_for_its_namesake(part):
    jackal = load_robot("jackal")
    others = {
        "drive": replace(jackal.drive, max_speed_m_s=1.0),
        "lidar": replace(jackal.lidar, beams=360),
        "odometry": replace(jackal.odometry, gyro_bias_rad_s=0.1),
        "wheel_friction": 0.7,
    }
    robot = replace(jackal, **{part: others[part]})
    driven_robot = robot_of(with_robot(SimulatorConfig(), robot))
    assert getattr(driven_robot, part) == others[part]


@pytest.mark.parametrize("turn_radps", [0.4, -1.0, 2.0])
def test_a_dead_band_takes_its_share_of_each_turn(plain, turn_radps):
    jackal = load_robot("jackal")
    ideal = with_robot(SimulatorConfig(), jackal)
    drive = replace(jackal.drive, turn_deadband_rad_s=0.5)
    measured = with_robot(SimulatorConfig(), replace(jackal, drive=drive))
    left_radps = math.copysign(max(abs(turn_radps) - 0.5, 0.0), turn_radps)
    last = driven(plain, measured, (0.0, turn_radps), 20)[-1]
    expected = driven(plain, ideal, (0.0, left_radps), 20)[-1]
    assert last.truth == expected.truth


def polygon_robot():
    """Return a Husky whose front ends in a point."""
    robot = load_robot("husky")
    sides = ((0.43, 0.335), (-0.495, 0.335), (-0.495, -0.335), (0.43, -0.335))
    corners = ((0.6, 0.0), *sides)
    chassis = replace(robot.chassis, name="arrow", footprint_m=corners)
    return replace(robot, chassis=chassis)


@pytest.mark.parametrize("name", ["husky", "scout_mini"])
def test_skid_steer_robots_drive_straight_turn_and_stop(plain, name):
    robot = load_robot(name)
    config = with_robot(PRESETS["ideal"], robot)
    straight = driven(plain, config, (0.8, 0.0), 60)
    distance = straight[-1].truth.pose.y - straight[40].truth.pose.y
    assert distance == pytest.approx(0.8 * 20 * STEP_S, rel=1e-3)
    assert straight[-1].truth.pose.yaw == pytest.approx(START.yaw, abs=1e-3)
    assert not any(reading.collision for reading in straight)
    # four equally loaded wheels with Coulomb friction, turning in place
    slip = 1.0 + (robot.chassis.wheelbase_m / robot.chassis.track_m) ** 2
    multiplier = robot.drive.wheel_separation_multiplier / slip
    turning = driven(plain, config, (0.0, 1.0), 60, Pose2D(-2.25, 4.0, 0.0))
    yaw = np.unwrap([reading.truth.pose.yaw for reading in turning])
    assert (yaw[-1] - yaw[40]) / (20 * STEP_S) == pytest.approx(multiplier, rel=0.01)


def in_bullet(chassis):
    """Return the bounds (2, 3) in base_link of the shapes that Bullet has of a robot."""
    model = model_of(chassis)
    still = (0.0, 0.0, 0.0)
    center = tuple(model.center_of_mass.tolist())
    with closing(ContactScene(model, PhysicsConfig())) as scene:
        scene.place_robot((center, (0.0, 0.0, 0.0, 1.0), still, still))
        return np.array(bullet.getAABB(scene.robot, physicsClientId=scene.client))


@pytest.mark.parametrize(
    "robot, sizes_m",
    [(load_robot("husky"), [0.99, 0.67, 0.39]), (polygon_robot(), [1.095, 0.67, 0.26])],
    ids=["husky", "arrow"],
)
def test_the_shapes_are_those_of_the_footprint(robot, sizes_m):
    chassis = robot.chassis
    assert model_of(chassis).extent == pytest.approx(chassis.extent_m)
    assert np.allclose(np.ptp(in_bullet(chassis), axis=0), sizes_m, atol=0.005)


def test_the_shape_of_a_round_robot_is_its_circle():
    chassis = load_robot("turtlebot4").chassis
    assert model_of(chassis).extent == pytest.approx([-0.171, -0.171, 0.171, 0.171])


def gap_to(chassis, pose, point):
    """Distance in m from the outline of a robot to a point outside."""
    local = pose.inverse() @ Pose2D(*point, 0.0)
    outline = Footprint(np.array(chassis.hull_m), chassis.footprint_radius_m)
    return float(outline.distances(np.array([local.x]), np.array([local.y]))[0])


@pytest.fixture(scope="module")
def pillar():
    """A world with one pillar."""
    return world_with((30, 30), row=20, size=60)


@pytest.mark.parametrize("turned", [0.0, 0.5, 2.4])
@pytest.mark.parametrize("aside_m", [0.0, 0.12, -0.2])
@pytest.mark.parametrize(
    "robot",
    [load_robot("turtlebot4"), polygon_robot(), load_robot("turtlebot3_waffle")],
    ids=NAME,
)
def test_robots_touch_a_pillar_where_their_outline_does(
    pillar, robot, aside_m, turned, simulators
):
    config = with_robot(PRESETS["ideal"], robot)
    x, y = pillar.obstacles_m[0].tolist()
    start = Pose2D(x, y, turned) @ Pose2D(-1.0, aside_m, 0.0)
    simulator = simulators(pillar, config, start, 0)
    before = np.inf
    for _ in range(1200):
        simulator.command(Velocity2D(0.2, 0.0))
        simulator.advance(1)
        away = gap_to(robot.chassis, simulator.read_truth().pose, (x, y))
        gap = away - pillar.cylinder_radius_m
        if simulator.read_collision():
            break
        before = gap
    assert min(gap, before) == pytest.approx(0.0, abs=0.003)


@pytest.mark.parametrize("robot", [load_robot("turtlebot4"), polygon_robot()], ids=NAME)
def test_obstacles_are_never_nearer_than_the_bounds_say(robot):
    """The rectangle that decides when PyBullet takes over encloses the shapes and the footprint."""
    rng = np.random.default_rng(0)
    low, high = in_bullet(robot.chassis)[:, :2]
    extent = model_of(robot.chassis).extent
    assert (extent[:2] <= low + 0.002).all() and (high - 0.002 <= extent[2:]).all()
    for x, y, yaw, px, py in rng.uniform(-1.5, 1.5, (200, 5)).tolist():
        bound = nearest_gap(np.array([[px, py, px, py]]), x, y, yaw, extent)
        gap = gap_to(robot.chassis, Pose2D(x, y, yaw), (px, py))
        assert bound <= gap + 1e-9 or bound == 0.0


def test_obstacles_are_left_more_than_a_fast_tick():
    assert contact_gap_m(SimulatorConfig()) == 0.03
    robot = load_robot("husky")
    drive = replace(robot.drive, max_speed_m_s=6.0)
    fast = with_robot(SimulatorConfig(), replace(robot, drive=drive))
    fastest_mps = 6.0 + drive.max_yaw_rate_rad_s * np.hypot(0.495, 0.335)
    assert contact_gap_m(fast) > fast.physics.tick_s * fastest_mps


@pytest.mark.parametrize("name, count", [("jackal", 4), ("turtlebot4", 2)])
def test_joints_are_those_that_a_robot_has(plain, name, count):
    robot = load_robot(name)
    radius_m = robot.chassis.wheel_radius_m
    config = with_robot(PRESETS["ideal"], robot)
    first, *_, last = driven(plain, config, (0.2, 0.0), 20)
    joints = last.joints
    names = joint_names(robot.chassis)
    assert len(joints.positions) == len(joints.velocities) == len(names) == count
    turned = joints.positions[0] - first.joints.positions[0]
    distance_m = first.truth.pose.distance(last.truth.pose)
    assert turned * radius_m == pytest.approx(distance_m, abs=0.03)
    wheels = len(robot.chassis.wheels_m)
    assert joints.velocities[:wheels] == pytest.approx([0.2 / radius_m] * wheels)


def test_motors_lag_in_the_simulator_too(plain):
    config = with_robot(PRESETS["ideal"], load_robot("turtlebot4"))
    drive = replace(config.drive, motor_lag_s=0.2, command_latency_s=0.0)
    readings = driven(plain, replace(config, drive=drive), (0.1, 0.0), 20)
    speeds = [reading.truth.velocity.linear for reading in readings]
    assert speeds[4] < 0.08
    assert speeds[-1] == pytest.approx(0.1, rel=0.02)


def test_the_lidar_sees_from_where_it_is_mounted(plain):
    robot = load_robot("turtlebot4")
    mount = Pose2D(0.1, -0.07, 1.1)
    pose = Pose2D(-2.0, 3.0, 0.7)
    ranges = []
    for place, start in ((mount, pose), (ORIGIN, pose @ mount)):
        lidar = replace(
            robot.lidar,
            mount_x_m=place.x,
            mount_y_m=place.y,
            mount_yaw_rad=place.yaw,
            noise_m=0.0,
        )
        config = with_robot(PRESETS["ideal"], replace(robot, lidar=lidar))
        ranges.append(driven(plain, config, (0.0, 0.0), 0, start)[0].scan.ranges)
    np.testing.assert_allclose(*ranges, atol=1e-6)
    assert np.isfinite(ranges[0]).any()


def test_fixed_frames_are_turned_as_the_lidar_is():
    robot = load_robot("turtlebot4")
    messages = SimulatorMessages(with_robot(SimulatorConfig(), robot))
    _, (_, data) = messages.constant()
    yaws = {
        transform.child: transform.pose.yaw for transform in decode.transforms(data)
    }
    assert yaws.pop("lidar_link") == pytest.approx(robot.lidar.mount_yaw_rad)
    assert set(yaws.values()) == {0.0}


def test_the_configuration_of_the_jackal_is_written_as_before():
    assert "chassis" not in as_dict(SimulatorConfig())
    husky = with_robot(SimulatorConfig(), load_robot("husky"))
    assert as_dict(husky)["chassis"]["name"] == "husky"
    assert from_dict(SimulatorConfig, as_dict(husky), "here") == husky
    assert husky.physics.wheel_friction == load_robot("husky").wheel_friction
    for preset in PRESETS.values():
        assert with_robot(preset, load_robot("jackal")) is preset


@pytest.mark.parametrize("name", ROBOTS)
def test_the_description_is_a_urdf_of_the_same_body(name, tmp_path):
    robot = load_robot(name)
    chassis = robot.chassis
    root = fromstring(robot_description(robot.lidar, chassis))
    assert root.get("name") == name
    links = [link.get("name") for link in root.iter("link")]
    children = [child.get("link") for child in root.iter("child")]
    assert sorted(links) == sorted(["base_link", *children])  # one tree
    file = tmp_path / "robot.urdf"
    file.write_text(description_text(chassis), "utf-8")
    for key, value in read_chassis(file)[0].items():
        assert value == pytest.approx(getattr(chassis, key), rel=1e-6)
    frames = fixed_frames(robot.lidar, chassis)
    assert frames["lidar_link"] == (robot.lidar.mount_x_m, 0.0, robot.lidar.mount_z_m)
    assert frames["base_footprint"] == (0.0, 0.0, -chassis.base_height_m)
    joints = {joint.get("name") for joint in root.iter("joint")}
    assert set(joint_names(chassis)) <= joints
    if chassis.is_rectangular and name != "jackal":
        (box,) = root.iterfind("link/collision/geometry/box")
        height_m = chassis.body_height_m - chassis.ground_clearance_m
        sizes_m = np.array(box.attrib["size"].split(), float)
        assert sizes_m == pytest.approx([robot.length_m, robot.width_m, height_m])
