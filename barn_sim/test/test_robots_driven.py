"""Robots other than the Jackal in the simulator."""

from dataclasses import replace
from xml.etree.ElementTree import fromstring

import numpy as np
import pytest

from barn_sim.body import bounds_of
from barn_sim.config import PRESETS, SimulatorConfig, require_simulated, with_robot
from barn_sim.messages import SimulatorMessages
from barn_sim.model import WHEELS, description_text, fixed_frames, jackal, model_of, read_model, robot_description
from barn_sim.simulator import Simulator
from barn_worlds.config import as_dict, from_dict
from barn_worlds.errors import ConfigError
from barn_worlds.messages import decode
from barn_worlds.robot_files import ROBOTS, load_robot
from barn_worlds.types import Pose2D, Velocity2D
from barn_worlds.world import World

STEP_S = 0.05
START = Pose2D(-2.25, 3.0, 1.57)


@pytest.fixture(scope="module")
def plain():
    """A world with nothing but its side walls, 9 m wide."""
    grid = np.zeros((60, 60), np.bool_)
    grid[0] = grid[-1] = True
    return World("plain", grid, np.array([[30, column] for column in range(60)]))


def driven(world, config, command, steps, start=START, **options):
    """Return the readings after each step, and the first one."""
    simulator = Simulator(world, config, start, 0, **options)
    readings = [simulator.sense()] + [simulator.step(Velocity2D(*command)) for _ in range(steps)]
    simulator.close()
    return readings


def polygon_robot():
    """Return a Husky whose front ends in a point."""
    robot = load_robot("husky")
    corners = ((0.6, 0.0), (0.43, 0.335), (-0.495, 0.335), (-0.495, -0.335), (0.43, -0.335))
    return replace(robot, chassis=replace(robot.chassis, name="arrow", footprint_m=corners))


@pytest.mark.parametrize("name", ["husky", "scout_mini"])
def test_skid_steer_robots_drive_straight_turn_and_stop(plain, name):
    robot = load_robot(name)
    config = with_robot(PRESETS["ideal"], robot)
    straight = driven(plain, config, (0.8, 0.0), 60)
    distance = straight[-1].truth.pose.y - straight[40].truth.pose.y
    assert distance == pytest.approx(0.8 * 20 * STEP_S, rel=1e-3)
    assert straight[-1].truth.pose.yaw == pytest.approx(START.yaw, abs=1e-3)
    # four equally loaded wheels with Coulomb friction, turning in place
    slip = 1.0 + (robot.chassis.wheelbase_m / robot.chassis.track_m) ** 2
    wanted = robot.drive.wheel_separation_multiplier / slip
    yaw = np.unwrap([one.truth.pose.yaw for one in driven(plain, config, (0.0, 1.0), 60, Pose2D(-2.25, 4.0, 0.0))])
    assert (yaw[-1] - yaw[40]) / (20 * STEP_S) == pytest.approx(wanted, rel=0.01)
    assert not any(one.collision for one in straight)


@pytest.mark.parametrize("robot", [load_robot("husky"), polygon_robot()], ids=lambda robot: robot.name)
def test_free_motion_gives_the_bits_of_pybullet(plain, robot):
    config = with_robot(SimulatorConfig(), robot)
    free, bullet = (driven(plain, config, (0.7, 0.6), 40, free_motion=fast) for fast in (True, False))
    assert [one.truth for one in free] == [one.truth for one in bullet]


def test_a_robot_collides_where_its_footprint_ends(plain):
    for robot, front_m in ((load_robot("husky"), 0.495), (polygon_robot(), 0.6)):
        config = with_robot(PRESETS["ideal"], robot)
        wall = float(plain.cylinders_m[:, 0].min()) + plain.cylinder_radius_m
        start = Pose2D(wall + 1.0, float(plain.cylinders_m[40, 1]), np.pi)
        readings = driven(plain, config, (0.5, 0.0), 60, start)
        first = next(one for one in readings if one.collision)
        gap = first.truth.pose.x - wall
        assert gap == pytest.approx(front_m, abs=0.03)


def test_the_shapes_are_those_of_the_footprint():
    husky = load_robot("husky").chassis
    assert model_of(husky).extent() == pytest.approx(husky.extent_m)
    assert np.allclose(np.ptp(bounds_of(model_of(husky)), axis=0), [0.99, 0.67, 0.39], atol=0.005)
    arrow = polygon_robot().chassis
    assert model_of(arrow).extent() == pytest.approx(arrow.extent_m)
    assert np.allclose(np.ptp(bounds_of(model_of(arrow)), axis=0), [1.095, 0.67, 0.26], atol=0.005)
    round_one = load_robot("turtlebot4").chassis
    assert model_of(round_one).extent() == pytest.approx([-0.171, -0.171, 0.171, 0.171])
    assert model_of(load_robot("jackal").chassis) is jackal()


@pytest.mark.parametrize("name", ["turtlebot3_burger", "turtlebot4", "racecar"])
def test_other_drives_are_refused_in_one_line(plain, name):
    robot = load_robot(name)
    with pytest.raises(ConfigError, match=f"^robot {name}: a drive of kind {robot.chassis.kind} is not simulated"):
        Simulator(plain, with_robot(SimulatorConfig(), robot), START, 0)


@pytest.mark.parametrize(
    "part, key, value",
    [
        ("drive", "motor_lag_s", 0.1),
        ("drive", "max_reverse_m_s", 0.5),
        ("lidar", "mount_y_m", 0.1),
        ("lidar", "mount_yaw_rad", 0.1),
        ("lidar", "latency_s", 0.1),
    ],
)
def test_what_is_not_simulated_is_refused(part, key, value):
    config = SimulatorConfig()
    changed = replace(config, **{part: replace(getattr(config, part), **{key: value})})
    with pytest.raises(ConfigError, match=rf"^robot jackal: {part}\.{key} is not simulated"):
        require_simulated(changed)


def test_the_configuration_of_the_jackal_is_written_as_before():
    assert "chassis" not in as_dict(SimulatorConfig())
    husky = with_robot(SimulatorConfig(), load_robot("husky"))
    assert as_dict(husky)["chassis"]["name"] == "husky"
    assert from_dict(SimulatorConfig, as_dict(husky), "here") == husky
    assert husky.physics.wheel_friction == load_robot("husky").wheel_friction
    for preset in PRESETS.values():
        assert with_robot(preset, load_robot("jackal")) is preset


@pytest.mark.parametrize("name", [name for name in ROBOTS if name != "jackal"])
def test_the_description_is_a_urdf_of_the_same_body(name):
    robot = load_robot(name)
    chassis = robot.chassis
    root = fromstring(robot_description(robot.lidar, chassis))
    assert root.get("name") == name
    links = [link.get("name") for link in root.iter("link")]
    children = [child.get("link") for child in root.iter("child")]
    assert sorted(links) == sorted(["base_link", *children])  # one tree
    assert fixed_frames(robot.lidar, chassis)["lidar_link"] == (robot.lidar.mount_x_m, 0.0, robot.lidar.mount_z_m)
    if len(chassis.wheels_m) == len(WHEELS):
        read = read_model(description_text(chassis))
        made = model_of(chassis)
        assert read.extent() == pytest.approx(made.extent())
        assert read.inertia == pytest.approx(made.inertia, rel=1e-6)
        assert read.wheels == pytest.approx(made.wheels)


def test_the_messages_describe_the_robot():
    robot = load_robot("husky")
    (_, text), _ = SimulatorMessages(with_robot(SimulatorConfig(), robot)).constant()
    assert decode.text(text) == robot_description(robot.lidar, robot.chassis)
