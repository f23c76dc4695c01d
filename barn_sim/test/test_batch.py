"""Simulators that advance together against the same ones by themselves, to the last bit."""

import math
from dataclasses import replace

import numpy as np
import pytest

from barn_sim.batch import Batch
from barn_sim.body.drive import add_command
from barn_sim.config import LidarConfig, ObstacleConfig, SimulatorConfig, with_robot
from barn_sim.motion.lanes import LANES, advance_all
from barn_sim.motion.ticks import advance
from barn_sim.simulator import Simulator
from barn_worlds.base.types import Pose2D, Velocity2D
from barn_worlds.robots.files import load_robot

STARTS = [
    Pose2D(-2.25, 3.0, 1.57),
    Pose2D(-3.5, 4.5, 1.57),
    Pose2D(-3.4, 6.0, 2.2),
    Pose2D(-2.0, 5.0, 0.4),
] + [Pose2D(-2.25, 4.0, 0.1 * turn) for turn in range(4)]
STEPS = 60


@pytest.fixture
def simulator(walled_world, simulators):
    """Make simulators of robots in the open and at a wall."""

    def make(config, index, fleet=None):
        place = {} if fleet is None else {"fleet": fleet, "index": index}
        return simulators(walled_world, config, STARTS[index], index, **place)

    return make


def row(readings, index):
    """Return what a batch has read of a robot, as numbers."""
    poses = [
        *readings.truths[index],
        *readings.odometry[index],
        *readings.velocities[index],
    ]
    return [
        readings.stamps_ns[index],
        readings.collisions[index],
        *poses,
        *readings.ranges[index],
    ]


def expected(sensors):
    """Return the same numbers of the readings of a simulator."""
    poses = [
        part
        for pose in (sensors.truth.pose, sensors.odometry.pose)
        for part in pose.numbers
    ]
    return [
        sensors.stamp_ns,
        sensors.collision,
        *poses,
        *sensors.odometry.velocity.numbers,
        *sensors.scan.ranges,
    ]


@pytest.mark.parametrize(
    "robot, movable",
    [("jackal", False), ("jackal", True), ("turtlebot4", False), ("husky", False)],
)
def test_a_batch_reads_what_each_robot_reads_by_itself(simulator, robot, movable):
    obstacles = ObstacleConfig(movable=movable)
    config = SimulatorConfig(lidar=LidarConfig(beams=90), obstacles=obstacles)
    config = with_robot(config, load_robot(robot))
    indices = range(len(STARTS))
    numbers = np.array(indices)
    batch = Batch(len(STARTS), config)
    alone = [simulator(config, index) for index in indices]
    for index in indices:
        batch.put(index, simulator(config, index, batch.fleet))
    batch.read(numbers)
    for index, robot_alone in enumerate(alone):
        expected_ranges = robot_alone.sense().scan.ranges
        assert np.array_equal(batch.readings.ranges[index], expected_ranges)
    hit = np.zeros(len(STARTS), np.bool_)
    for step in range(STEPS):
        turns = 0.9 * np.sin(0.1 * step + numbers)
        commands = np.column_stack([np.full(len(STARTS), 0.6), turns])
        which = np.flatnonzero(step % 5 != numbers)  # one of them rests now and then
        batch.advance(which, commands)
        batch.read(which)
        for index in which.tolist():
            command = Velocity2D(*commands[index].tolist())
            assert row(batch.readings, index) == expected(alone[index].step(command))
        hit |= batch.readings.collisions
    batch.close()
    assert hit.any() and not hit.all()


def test_a_step_of_no_robot_changes_nothing(simulator):
    config = SimulatorConfig(lidar=LidarConfig(beams=90))
    batch = Batch(1, config)
    batch.put(0, simulator(config, 0, batch.fleet))
    batch.read(np.array([0]))
    before = row(batch.readings, 0)
    batch.advance(np.array([], np.int64), np.array([[0.5, 0.0]]))
    batch.read(np.array([], np.int64))
    assert row(batch.readings, 0) == before


@pytest.mark.parametrize(
    "robot, slip_mps",
    [("jackal", 0.0), ("jackal", 0.05), ("turtlebot4", 0.0), ("scout_mini", 0.0)],
)
def test_batched_robots_advance_as_each_alone(walled_world, robot, slip_mps):
    """More robots than lanes: some fall (friction without load is solved one by one), some come to a cylinder."""
    count = 3 * LANES - 5
    rng = np.random.default_rng(0)
    config = with_robot(SimulatorConfig(lidar=LidarConfig(beams=10)), load_robot(robot))
    physics = replace(config.physics, tire_slip_mps=slip_mps)
    config = replace(config, physics=physics)
    batches = [Batch(count, config) for _ in range(2)]
    for batch in batches:
        for index in range(count):
            start = Pose2D(-2.25, 1.0, 0.1 * index)
            place = {"fleet": batch.fleet, "index": index}
            batch.put(index, Simulator(walled_world, config, start, index, **place))
        batch.fleet.robots["position"][::3, 2] += 0.02
    abreast, alone = (batch.fleet for batch in batches)
    segments = np.full((count, 2, 4), 100.0)
    which = np.arange(count)
    reach_m = math.hypot(*abreast.settings["extent"][0, 2:])
    ahead_m = reach_m + abreast.robots["near_m"][0] + 0.02
    segments[:, 0] = [ahead_m - 2.25, 1.0, ahead_m - 2.25, 1.0]
    for _ in range(10):
        commands = rng.uniform([-0.5, -2.0], [2.0, 2.0], (count, 2))
        left = np.zeros(count, np.int64)
        cylinders = np.full(count, 2)
        advance_all(abreast, segments, cylinders, 10, which, commands, 0, left)
        for index in which:
            stamp_ns = alone.robots["stamp_ns"][index]
            add_command(alone, index, stamp_ns, *commands[index])
            wanted = advance(alone, index, segments[index], 10)
            assert left[index] == wanted
        which = which[left[which] == 0]
    assert LANES < len(which) < count
    for name in abreast.robots.dtype.names:
        state, expected = (fleet.robots[name] for fleet in (abreast, alone))
        if name == "wheels":
            # The rest of a wheel is room to compute in.
            fields = ["hub", "impulse_x", "impulse_y"]
            state, expected = state[fields], expected[fields]
        np.testing.assert_array_equal(state, expected, err_msg=name)
