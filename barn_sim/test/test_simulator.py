import hashlib
import math
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from driving import readings_of

from barn_sim.config import (
    PRESETS,
    DriveConfig,
    LidarConfig,
    LocalizationConfig,
    ObstacleConfig,
    OdometryConfig,
    PhysicsConfig,
    SimulatorConfig,
)
from barn_sim.contact.scene import ScenePool
from barn_sim.simulator import Simulator
from barn_worlds.base.types import ORIGIN, STOP, Pose2D, Velocity2D
from barn_worlds.formats.dataset_file import write_dataset_file

START = Pose2D(-2.25, 3.0, 1.57)
AT_THE_WALL = Pose2D(-3.5, 4.5, 1.57)
MOVABLE = ObstacleConfig(movable=True)
NO_DRIFT = SimulatorConfig(odometry=OdometryConfig(yaw_noise_rad=0.0))


def localized(**fields):
    return SimulatorConfig(localisation=LocalizationConfig(**fields))


def commands(count):
    return [
        None if k % 17 == 16 else Velocity2D(0.6, 0.9 * math.sin(0.1 * k))
        for k in range(count)
    ]


def drive(world, config=SimulatorConfig(), start=START, seed=0, steps=60):  # noqa: B008 (frozen)
    return readings_of(Simulator(world, config, start, seed), commands(steps))


def fingerprint(readings):
    digest = hashlib.sha256()
    for sensors in readings:
        digest.update(sensors.scan.ranges.tobytes())
        digest.update(repr(replace(sensors, scan=None)).encode())
    return digest.hexdigest()


CONFIGS = {
    "static": SimulatorConfig(),
    "movable": SimulatorConfig(obstacles=MOVABLE),
    "paper": PRESETS["paper2020"],
}


@pytest.mark.parametrize("name", CONFIGS)
def test_a_client_used_before_repeats_a_new_one_to_the_last_bit(
    walled_world, empty_world, name
):
    """Whatever was in the client, bodies that had been pushed over and a robot in motion included."""
    fresh = drive(walled_world, CONFIGS[name], AT_THE_WALL)
    coarse = SimulatorConfig(physics=PhysicsConfig(tick_s=0.01, gravity_m_s2=3.0))
    scenes = ScenePool()
    for world, config, start in (
        (walled_world, CONFIGS["paper"], AT_THE_WALL),
        (empty_world, CONFIGS["static"], START),
        (walled_world, coarse, AT_THE_WALL),
        (walled_world, CONFIGS[name], AT_THE_WALL),
    ):
        simulator = Simulator(world, config, start, 0, scenes)
        again = readings_of(simulator, commands(60))
    for world, start in ((empty_world, START), (walled_world, AT_THE_WALL)):
        simulator.begin(world, start, 0)
        anew = readings_of(simulator, commands(60))
    scenes.close()
    assert any(sensors.collision for sensors in fresh)
    assert fingerprint(fresh) == fingerprint(again) == fingerprint(anew)


def test_repeats_itself_in_another_process(walled_world, tmp_path):
    write_dataset_file(tmp_path / "world.npz", "walled", {0: walled_world})
    script = (
        "import sys, test_simulator as cases\n"
        "from barn_worlds.datasets.dataset import open_dataset\n"
        "world = open_dataset(sys.argv[1]).load(0)\n"
        "print(cases.fingerprint(cases.drive(world, cases.CONFIGS['paper'], cases.AT_THE_WALL)))\n"
    )
    output = subprocess.check_output(
        [sys.executable, "-c", script, tmp_path / "world.npz"],
        cwd=Path(__file__).parent,
        text=True,
        timeout=600,
    )
    here = fingerprint(drive(walled_world, CONFIGS["paper"], AT_THE_WALL))
    # and nothing else: PyBullet's banner is kept out of standard output
    assert output == f"{here}\n"


def test_seeds_differ(empty_world):
    first = drive(empty_world, seed=1, steps=1)
    second = drive(empty_world, seed=2, steps=1)
    assert (first[0].scan.ranges != second[0].scan.ranges).any()
    assert first[1].odometry.pose.yaw != second[1].odometry.pose.yaw


def test_one_sensor_does_not_change_the_noise_of_another(walled_world):
    plain = drive(walled_world)
    fewer_beams = drive(walled_world, SimulatorConfig(lidar=LidarConfig(beams=10)))
    amcl = drive(walled_world, localized(mode="amcl"))
    for other in (fewer_beams, amcl):
        assert [s.odometry for s in other] == [s.odometry for s in plain]
    for ours, theirs in zip(plain, amcl, strict=True):
        np.testing.assert_array_equal(ours.scan.ranges, theirs.scan.ranges)


def test_noise_does_not_move_the_robot(walled_world):
    noisy = drive(walled_world)
    quiet = drive(walled_world, NO_DRIFT)
    assert [s.truth for s in noisy] == [s.truth for s in quiet]


def test_starts_where_it_is_put_with_odometry_at_zero(empty_world, simulators):
    sensors = simulators(empty_world, NO_DRIFT, START, 0).sense()
    assert sensors.stamp_ns == 0
    assert sensors.truth.pose.distance(START) < 1e-9
    assert sensors.truth.pose.yaw == pytest.approx(START.yaw, abs=1e-9)
    assert sensors.odometry.pose.distance(ORIGIN) == 0.0
    assert sensors.localization == sensors.truth.pose
    assert not sensors.collision


def test_poses_are_as_they_come_out_of_messages(walled_world):
    for sensors in drive(walled_world, PRESETS["paper2020"]):
        for pose in (sensors.odometry.pose, sensors.truth.pose, sensors.localization):
            assert pose == pose.through_quaternion()


def test_time_passes_by_whole_control_periods(empty_world):
    for k, sensors in enumerate(drive(empty_world, steps=5)):
        assert sensors.stamp_ns == 50_000_000 * k
        for reading in (sensors.odometry, sensors.scan, sensors.truth):
            assert reading.stamp_ns == sensors.stamp_ns


def test_sensing_again_gives_the_same_readings(empty_world, simulators):
    simulator = simulators(empty_world, SimulatorConfig(), START, 0)
    simulator.step(Velocity2D(0.5, 0.0))
    assert simulator.sense() is simulator.sense()


def test_truth_velocity_is_the_change_of_the_truth(empty_world):
    readings = drive(empty_world, steps=60)[20:]
    for before, after in pairwise(sensors.truth for sensors in readings):
        turned = math.remainder(after.pose.yaw - before.pose.yaw, 2 * math.pi)
        mean = 0.5 * (before.velocity.angular + after.velocity.angular)
        assert turned / 0.05 == pytest.approx(mean, abs=0.06)
        traveled = before.pose.distance(after.pose) / 0.05
        assert traveled == pytest.approx(after.velocity.linear, abs=0.06)


def test_odometry_follows_the_truth_and_drifts_where_wheels_slip(empty_world):
    last = drive(empty_world, steps=80)[-1]
    measured = START @ last.odometry.pose
    true = last.truth.pose
    assert 0.001 < measured.distance(true) < 0.3
    assert abs(math.remainder(measured.yaw - true.yaw, 2 * math.pi)) < 0.025


def test_contact_is_reported_once_per_contact_between_readings(walled_world):
    readings = drive(walled_world, start=AT_THE_WALL)
    touched = [sensors.collision for sensors in readings]
    assert not any(touched[:5])
    assert any(touched)
    where = readings[touched.index(True)].truth.pose
    assert where.y + 0.229 == pytest.approx(5.175 - 0.075, abs=0.1)


def test_a_touch_between_two_readings_is_not_lost(walled_world, simulators):
    simulator = simulators(walled_world, SimulatorConfig(), AT_THE_WALL, 0)
    simulator.command(Velocity2D(2.0, 0.0))
    for _ in range(40):
        simulator.advance(5)
    assert simulator.read_collision()
    simulator.command(Velocity2D(-1.0, 0.0))
    simulator.advance(100)
    simulator.read_collision()
    simulator.advance(20)
    assert not simulator.read_collision()


def test_a_nan_command_stops_the_robot_and_is_counted(empty_world, simulators):
    simulator = simulators(empty_world, SimulatorConfig(), START, 0)
    for _ in range(20):
        simulator.step(Velocity2D(0.5, 0.0))
    for bad in (Velocity2D(math.nan, 0.0), Velocity2D(0.5, math.inf)):
        sensors = simulator.step(bad)
    for _ in range(6):
        sensors = simulator.step(None)
    assert simulator.invalid_commands == 2
    assert sensors.truth.velocity.linear == pytest.approx(0.0, abs=1e-3)


def test_without_commands_the_watchdog_stops_the_robot(empty_world, simulators):
    config = SimulatorConfig(drive=DriveConfig(command_timeout_s=0.25))
    simulator = simulators(empty_world, config, START, 0)
    simulator.step(Velocity2D(0.5, 0.0))
    speeds = [simulator.step(None).truth.velocity.linear for _ in range(15)]
    assert max(speeds) == pytest.approx(0.5, abs=0.02)
    assert speeds[-1] == pytest.approx(0.0, abs=1e-3)


def test_readings_at_rates_of_their_own_are_of_the_same_motion(
    walled_world, simulators
):
    stepped = simulators(walled_world, SimulatorConfig(), AT_THE_WALL, 0)
    ticked = simulators(walled_world, SimulatorConfig(), AT_THE_WALL, 0)
    for command in commands(40):
        if command is not None:
            ticked.command(command)
        for _ in range(10):
            ticked.advance(1)
            ticked.read_truth()
        assert stepped.step(command).truth == ticked.read_truth()


def test_closing_twice_does_nothing(empty_world):
    simulator = Simulator(empty_world, SimulatorConfig(), START, 0)
    expected = simulator.step(STOP)
    simulator.close()
    # may have got the client that was given back
    successor = Simulator(empty_world, SimulatorConfig(), START, 0)
    simulator.close()
    assert successor.step(STOP).truth == expected.truth
    successor.close()


def test_clients_are_given_back(walled_world):
    """PyBullet has room for a limited number of them in a process."""
    clients = set()
    for _ in range(10):
        simulator = Simulator(walled_world, SimulatorConfig(), AT_THE_WALL, 0)
        while not simulator.motion.is_in_contact:
            simulator.step(Velocity2D(0.5, 0.0))
        clients.add(simulator.motion._scene.client)
        simulator.close()
    assert len(clients) == 1


@pytest.mark.parametrize("mode", ["exact", "amcl"])
def test_an_offset_moves_what_is_believed_and_nothing_else(walled_world, mode):
    plain = drive(walled_world, localized(mode=mode))
    off = localized(mode=mode, offset_x_m=0.3, offset_y_m=-0.15)
    moved = drive(walled_world, off)
    assert [s.truth for s in moved] == [s.truth for s in plain]
    for ours, theirs in zip(moved, plain, strict=True):
        x = ours.localization.x - theirs.localization.x
        y = ours.localization.y - theirs.localization.y
        assert (x, y) == pytest.approx((0.3, -0.15))
        assert ours.localization.yaw == theirs.localization.yaw
