"""What robots' data sheets say of their sensors: slow and turning lidars, errors by range and at edges, drift."""

import math
from dataclasses import replace

import numpy as np
import pytest
from driving import readings_of

from barn_sim.config import (
    LidarConfig,
    ObstacleConfig,
    OdometryConfig,
    SimulatorConfig,
    with_robot,
)
from barn_sim.messages import SimulatorMessages
from barn_sim.sensors.lidar import NO_SHAPES, Lidar
from barn_sim.simulator import Simulator
from barn_worlds.base.types import ORIGIN, Pose2D, Velocity2D, wrap_angle
from barn_worlds.robots.files import load_robot

START = Pose2D(-2.25, 3.0, 1.57)
SLOW = SimulatorConfig(lidar=LidarConfig(rate_hz=5.0))
ANGLES = np.arange(0.0, 2.0 * math.pi, 0.35)
AROUND = 3.0 * np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])


def scans(config, count):
    lidar = Lidar(config, np.random.default_rng(0))
    pose = ORIGIN
    readings = [lidar.scan(0, pose, AROUND, 0.4) for _ in range(count)]
    return np.array([scan.ranges for scan in readings], float)


@pytest.mark.parametrize("share", [0.0, 0.035])
def test_noise_grows_with_range_where_it_is_said_to(share):
    config = LidarConfig(beams=181, noise_m=0.01, noise_share=share)
    true = scans(replace(config, noise_m=0.0, noise_share=0.0), 1)[0]
    is_hit = np.isfinite(true)
    errors = scans(config, 3000)[:, is_hit] - true[is_hit]
    expected = np.maximum(0.01, share * true[is_hit])
    assert np.std(errors, axis=0) == pytest.approx(expected, rel=0.08)
    slack = 5.0 / math.sqrt(3000)
    assert np.abs(np.mean(errors / expected, axis=0)).max() < slack
    beside = np.diag(np.corrcoef(errors.T), 1)
    assert np.abs(beside).max() < slack


def test_beams_drop_out_as_often_as_they_are_said_to():
    config = LidarConfig(beams=181, noise_m=0.0, dropout_share=0.1)
    is_hit = np.isfinite(scans(replace(config, dropout_share=0.0), 1)[0])
    lost = np.isposinf(scans(config, 2000)[:, is_hit])
    assert lost.mean() == pytest.approx(0.1, abs=0.004)
    assert np.corrcoef(lost[:, 3], lost[:, 4])[0, 1] == pytest.approx(0.0, abs=0.11)


def test_a_masked_sector_sees_nothing():
    config = LidarConfig(beams=181, masked_from_rad=-0.5, masked_to_rad=0.25)
    (masked,) = scans(config, 1)
    (plain,) = scans(replace(config, masked_to_rad=-0.5), 1)
    angles = np.linspace(config.angle_min_rad, config.angle_max_rad, 181)
    is_masked = (angles >= -0.5) & (angles <= 0.25)
    assert np.isposinf(masked[is_masked]).all()
    assert (masked[~is_masked] == plain[~is_masked]).all()


@pytest.mark.parametrize("burst_s", [0.02, 0.5])
def test_blackouts_have_their_share_of_the_time_and_their_length(burst_s):
    config = LidarConfig(beams=9, blackout_share=0.2, blackout_s=burst_s)
    is_blind = np.isposinf(scans(config, 60_000)).all(axis=1)
    bursts = np.diff(is_blind.astype(int)).clip(0).sum()
    mean_s = is_blind.sum() / bursts / config.rate_hz
    assert is_blind.mean() == pytest.approx(0.2, abs=0.02)
    assert mean_s == pytest.approx(burst_s, rel=0.1)


@pytest.mark.parametrize("movable", [False, True])
def test_cylinders_that_no_beam_sees_stand_all_the_same(walled_world, movable):
    """They are drawn for each trial, and a hidden one that was pushed over stays hidden."""
    lidar = LidarConfig(unseen_share=1.0)
    config = SimulatorConfig(lidar=lidar, obstacles=ObstacleConfig(movable=movable))
    ahead = [Velocity2D(1.0, 0.0)] * 60
    # Toward the wall.
    readings = readings_of(Simulator(walled_world, config, START, 0), ahead)
    assert np.isposinf([reading.scan.ranges for reading in readings]).all()
    half = replace(config, lidar=replace(lidar, unseen_share=0.5))
    simulators = [Simulator(walled_world, half, START, seed) for seed in (0, 0, 1)]
    same, again, other = (simulator.sense().scan.ranges for simulator in simulators)
    assert (same == again).all() and (np.isfinite(same) != np.isfinite(other)).any()
    for simulator in simulators:
        simulator.close()


def test_mixed_pixels_lie_between_both_sides_of_an_edge():
    config = LidarConfig(beams=181, noise_m=0.0, mixed_share=0.3, range_max_m=10.0)
    true = np.minimum(scans(replace(config, mixed_share=0.0), 1)[0], 10.0)
    ranges = np.minimum(scans(config, 4000), 10.0)
    steps = np.diff(true)
    edges = np.zeros(181, bool)
    edges[:-1] |= steps > 0.2
    edges[1:] |= steps < -0.2
    assert edges.any()
    off = ranges - true.astype(np.float32)
    assert (off[:, ~edges] == 0.0).all()
    is_mixed = off[:, edges] > 1e-6
    assert is_mixed.mean() == pytest.approx(0.3, abs=0.01)
    share = off[:, edges] / (10.0 - true[edges])
    mixed = share[share > 1e-6]
    assert mixed.mean() == pytest.approx(0.5, abs=0.02)
    assert mixed.std() == pytest.approx(1.0 / math.sqrt(12.0), abs=0.02)


@pytest.mark.parametrize("full_circle", [False, True])
def test_turning_beams_agree_with_a_scan_from_each_pose(full_circle):
    rng = np.random.default_rng(5)
    ends = {"angle_min_rad": -math.pi, "angle_max_rad": math.pi} if full_circle else {}
    config = LidarConfig(
        beams=97, noise_m=0.0, range_max_m=6.0, mount_yaw_rad=0.4, sweeps=True, **ends
    )
    lidar = Lidar(config, rng)
    for _ in range(60):
        centers = rng.uniform(-4.0, 4.0, (30, 2))
        radius = rng.uniform(0.05, 0.4)
        start = np.append(rng.uniform(-1.0, 1.0, 2), rng.uniform(-3.0, 3.0))
        move = rng.uniform(-0.5, 0.5, 3)
        poses = start + np.linspace(0.0, 1.0, 97)[:, None] * move
        turn = [math.cos(0.4), math.sin(0.4)]
        box = np.array([[*rng.uniform(-4.0, 4.0, 2), 0.0, 0.5, 0.3, *turn]])
        scene = (centers, radius, NO_SHAPES, box)
        swept = lidar.scan(0, Pose2D(*poses[-1]), *scene, sweep=poses).ranges
        scans = [lidar.scan(0, Pose2D(*pose), *scene) for pose in poses]
        single = np.array([scan.ranges[k] for k, scan in enumerate(scans)])
        same = np.isclose(swept, single, atol=1e-5) | (swept == single)
        # within a circle all of an instant's beams read -inf, of a sweep those that are in it
        assert (same | np.isneginf(single)).mean() > 0.99


def test_a_turning_lidar_casts_early_beams_from_earlier_poses(walled_world, simulators):
    config = replace(SLOW, lidar=replace(SLOW.lidar, sweeps=True, noise_m=0.0))
    simulator = simulators(walled_world, config, START, 0)
    for _ in range(40):
        truth = simulator.step(Velocity2D(0.0, 1.0)).truth
    poses = simulator.motion.poses_at(simulator.stamp_ns - simulator.lidar.ages_ns)
    turn_s = 1.5 * math.pi / (2.0 * math.pi * 5.0)
    turned = truth.velocity.angular * turn_s
    yaw = truth.pose.yaw
    assert wrap_angle(yaw - poses[0, 2]) == pytest.approx(turned, rel=0.02)
    assert wrap_angle(yaw - poses[-1, 2]) == pytest.approx(0.0, abs=1e-9)


def test_between_scans_the_last_one_is_read_with_its_stamp(walled_world):
    simulator = Simulator(walled_world, SLOW, START, 0)
    readings = readings_of(simulator, [Velocity2D(0.3, 0.2)] * 9)
    messages = SimulatorMessages(SLOW)
    for number, reading in enumerate(readings):
        assert reading.scan.stamp_ns == number // 4 * 200_000_000
        sent = messages.sensors(reading, reading.stamp_ns)
        is_sent = "scan" in [message.topic.name for message in sent]
        assert is_sent == (number % 4 == 0)
    assert readings[5].scan is readings[4].scan


@pytest.mark.parametrize(
    "rate_hz, steps",
    [(50.0, 1), (40.0, 1), (20.0, 1), (5.5555555556, 4), (5.0, 4), (2.0, 10)],
)
def test_scans_come_in_whole_control_periods(rate_hz, steps):
    assert SimulatorConfig(lidar=LidarConfig(rate_hz=rate_hz)).scan_steps == steps


def test_a_gyro_makes_the_heading_drift_as_far_as_it_is_biased(empty_world, scenes):
    odometry = OdometryConfig(yaw_noise_rad=0.0, gyro_bias_rad_s=0.02)
    config = SimulatorConfig(odometry=odometry)
    rates = []
    drifts = []
    for seed in range(150):
        simulator = Simulator(empty_world, config, START, seed, scenes)
        for _ in range(20):
            sensors = simulator.step(None)
        drifts.append(sensors.odometry.pose.yaw - (sensors.truth.pose.yaw - START.yaw))
        rates.append(sensors.odometry.velocity.angular)
    assert np.std(drifts) == pytest.approx(0.02, rel=0.2)  # after 1 s
    assert np.corrcoef(drifts, rates)[0, 1] > 0.9
    assert abs(np.mean(drifts)) < 4.0 * 0.02 / math.sqrt(150)


def test_wheels_of_another_radius_than_is_thought_misread_the_way(empty_world, scenes):
    def way_m(seed, error):
        odometry = OdometryConfig(yaw_noise_rad=0.0, wheel_radius_error=error)
        config = SimulatorConfig(odometry=odometry)
        simulator = Simulator(empty_world, config, START, seed, scenes)
        for _ in range(15):
            sensors = simulator.step(Velocity2D(0.5, 0.0))
        return sensors.odometry.pose.x

    shares = [way_m(seed, 0.02) / way_m(seed, 0.0) - 1.0 for seed in range(150)]
    assert np.std(shares) == pytest.approx(0.02, rel=0.2)
    assert abs(np.mean(shares)) < 4.0 * 0.02 / math.sqrt(150)


@pytest.mark.parametrize(
    "name, steps",
    [
        ("turtlebot4", 4),
        ("turtlebot3_burger", 4),
        ("turtlebot3_waffle", 4),
        ("husky", 1),
    ],
)
def test_robots_have_the_lidars_of_their_data_sheets(name, steps):
    config = with_robot(SimulatorConfig(), load_robot(name))
    assert config.scan_steps == steps
    assert config.lidar.sweeps


def test_the_standard_lidar_is_plain():
    config = SimulatorConfig()
    assert config.scan_steps == 1
    assert Lidar(config.lidar, np.random.default_rng(0)).is_plain


def test_the_same_seed_gives_the_same_errors_another_seed_others(walled_world):
    config = with_robot(SimulatorConfig(), load_robot("turtlebot4"))
    lidar = replace(config.lidar, mixed_share=0.2, dropout_share=0.1)
    config = replace(config, lidar=lidar)

    def ranges(seed):
        simulator = Simulator(walled_world, config, START, seed)
        readings = readings_of(simulator, [Velocity2D(0.3, 0.4)] * 9)
        return np.array([reading.scan.ranges for reading in readings])

    assert np.array_equal(ranges(1), ranges(1))
    assert not np.array_equal(ranges(1), ranges(2))
