"""What robots' data sheets say of their sensors: slow and turning lidars, errors by range and at edges, drift."""

import math
from dataclasses import replace

import numpy as np
import pytest
from driving import readings_of

from barn_sim.config import LidarConfig, OdometryConfig, SimulatorConfig, with_robot
from barn_sim.messages import SimulatorMessages
from barn_sim.sensors.lidar import NO_SHAPES, Lidar
from barn_sim.simulator import Simulator
from barn_worlds.base.types import Pose2D, Velocity2D, wrap_angle
from barn_worlds.robots.files import load_robot

START = Pose2D(-2.25, 3.0, 1.57)
SLOW = SimulatorConfig(lidar=LidarConfig(rate_hz=5.0))
AROUND = 3.0 * np.array(
    [(math.cos(a), math.sin(a)) for a in np.arange(0.0, 2.0 * math.pi, 0.35)]
)


def scans(config, count, seed=0):
    lidar = Lidar(config, np.random.default_rng(seed))
    return np.array(
        [
            lidar.scan(0, Pose2D(0.0, 0.0, 0.0), AROUND, 0.4).ranges
            for _ in range(count)
        ],
        float,
    )


@pytest.mark.parametrize("share", [0.0, 0.035])
def test_noise_grows_with_range_where_it_is_said_to(share):
    config = LidarConfig(beams=181, noise_m=0.01, noise_share=share)
    true = scans(replace(config, noise_m=0.0, noise_share=0.0), 1)[0]
    is_hit = np.isfinite(true)
    errors = scans(config, 3000)[:, is_hit] - true[is_hit]
    expected = np.maximum(0.01, share * true[is_hit])
    assert np.std(errors, axis=0) == pytest.approx(expected, rel=0.08)
    assert np.abs(np.mean(errors / expected, axis=0)).max() < 5.0 / math.sqrt(3000)
    beside = [
        np.corrcoef(errors[:, k], errors[:, k + 1])[0, 1]
        for k in range(errors.shape[1] - 1)
    ]
    assert np.abs(beside).max() < 5.0 / math.sqrt(3000)


def test_beams_drop_out_as_often_as_they_are_said_to():
    config = LidarConfig(beams=181, noise_m=0.0, dropout_share=0.1)
    is_hit = np.isfinite(scans(replace(config, dropout_share=0.0), 1)[0])
    lost = np.isposinf(scans(config, 2000)[:, is_hit])
    assert lost.mean() == pytest.approx(0.1, abs=0.004)
    assert np.corrcoef(lost[:, 3], lost[:, 4])[0, 1] == pytest.approx(0.0, abs=0.11)


def test_mixed_pixels_lie_between_both_sides_of_an_edge():
    config = LidarConfig(beams=181, noise_m=0.0, mixed_share=0.3, range_max_m=10.0)
    true = np.minimum(scans(replace(config, mixed_share=0.0), 1)[0], 10.0)
    ranges = scans(config, 4000)
    edges = np.zeros(181, bool)
    edges[:-1] |= true[1:] - true[:-1] > 0.2
    edges[1:] |= true[:-1] - true[1:] > 0.2
    assert edges.any()
    assert (
        np.minimum(ranges[:, ~edges], 10.0) == true[~edges].astype(np.float32)
    ).all()
    at = np.minimum(ranges[:, edges], 10.0) - true[edges].astype(np.float32)
    share = at / (10.0 - true[edges])
    assert (at > 1e-6).mean() == pytest.approx(0.3, abs=0.01)
    assert share[share > 1e-6].mean() == pytest.approx(0.5, abs=0.02)
    assert share[share > 1e-6].std() == pytest.approx(1.0 / math.sqrt(12.0), abs=0.02)


@pytest.mark.parametrize("full_circle", [False, True])
def test_turning_beams_agree_with_a_scan_from_each_pose(full_circle):
    rng = np.random.default_rng(5)
    spread = (
        {"angle_min_rad": -math.pi, "angle_max_rad": math.pi} if full_circle else {}
    )
    config = LidarConfig(
        beams=97, noise_m=0.0, range_max_m=6.0, mount_yaw_rad=0.4, sweeps=True, **spread
    )
    lidar = Lidar(config, rng)
    for _ in range(60):
        centers = rng.uniform(-4.0, 4.0, (30, 2))
        radius = rng.uniform(0.05, 0.4)
        start = np.append(rng.uniform(-1.0, 1.0, 2), rng.uniform(-3.0, 3.0))
        move = rng.uniform(-0.5, 0.5, 3)
        poses = start + np.linspace(0.0, 1.0, 97)[:, None] * move
        shapes = np.array(
            [[*rng.uniform(-4.0, 4.0, 2), 0.0, 0.5, 0.3, math.cos(0.4), math.sin(0.4)]]
        )
        swept = lidar.scan(
            0, Pose2D(*poses[-1]), centers, radius, NO_SHAPES, shapes, sweep=poses
        ).ranges
        single_scans = [
            lidar.scan(0, Pose2D(*pose), centers, radius, NO_SHAPES, shapes).ranges[k]
            for k, pose in enumerate(poses)
        ]
        # within a circle all of an instant's beams read -inf, of a sweep those that are in it
        same = np.isclose(swept, single_scans, atol=1e-5) | (
            swept == np.array(single_scans)
        )
        assert (same | np.isneginf(single_scans)).mean() > 0.99


def test_a_turning_lidar_casts_early_beams_from_earlier_poses(walled_world, simulators):
    config = replace(SLOW, lidar=replace(SLOW.lidar, sweeps=True, noise_m=0.0))
    simulator = simulators(walled_world, config, START, 0)
    for _ in range(40):
        sensors = simulator.step(Velocity2D(0.0, 1.0))
    now = sensors.truth.pose
    poses = simulator.motion.poses_at(simulator.stamp_ns - simulator.lidar.ages_ns)
    turn_s = 1.5 * math.pi / (2.0 * math.pi * 5.0)
    assert wrap_angle(now.yaw - poses[0, 2]) == pytest.approx(
        sensors.truth.velocity.angular * turn_s, rel=0.02
    )
    assert wrap_angle(now.yaw - poses[-1, 2]) == pytest.approx(0.0, abs=1e-9)


def test_between_scans_the_last_one_is_read_with_its_stamp(walled_world):
    readings = readings_of(
        Simulator(walled_world, SLOW, START, 0), [Velocity2D(0.3, 0.2)] * 9
    )
    assert [r.scan.stamp_ns // 50_000_000 for r in readings] == [
        0,
        0,
        0,
        0,
        4,
        4,
        4,
        4,
        8,
        8,
    ]
    assert readings[5].scan is readings[4].scan
    messages = SimulatorMessages(SLOW)
    sent = [
        any(m.topic.name == "scan" for m in messages.sensors(r, r.stamp_ns))
        for r in readings
    ]
    assert sent == [number % 4 == 0 for number in range(10)]


@pytest.mark.parametrize(
    "rate_hz, steps",
    [(50.0, 1), (40.0, 1), (20.0, 1), (5.5555555556, 4), (5.0, 4), (2.0, 10)],
)
def test_scans_come_in_whole_control_periods(rate_hz, steps):
    assert SimulatorConfig(lidar=LidarConfig(rate_hz=rate_hz)).scan_steps == steps


def test_a_gyro_makes_the_heading_drift_as_far_as_it_is_biased(empty_world, scenes):
    config = replace(
        SimulatorConfig(),
        odometry=OdometryConfig(yaw_noise_rad=0.0, gyro_bias_rad_s=0.02),
    )
    rates = []
    drifts = []
    for seed in range(150):
        simulator = Simulator(empty_world, config, START, seed, scenes)
        for _ in range(20):
            simulator.step(None)
        sensors = simulator.sense()
        drifts.append(sensors.odometry.pose.yaw - (sensors.truth.pose.yaw - START.yaw))
        rates.append(sensors.odometry.velocity.angular)
    assert np.std(drifts) == pytest.approx(0.02, rel=0.2)  # after 1 s
    assert np.corrcoef(drifts, rates)[0, 1] > 0.9
    assert abs(np.mean(drifts)) < 4.0 * 0.02 / math.sqrt(150)


def test_wheels_of_another_radius_than_is_thought_misread_the_way(empty_world, scenes):
    config = replace(
        SimulatorConfig(),
        odometry=OdometryConfig(yaw_noise_rad=0.0, wheel_radius_error=0.02),
    )
    shares = []
    for seed in range(150):
        readings_by_error = []
        for odometry in (
            config.odometry,
            replace(config.odometry, wheel_radius_error=0.0),
        ):
            simulator = Simulator(
                empty_world, replace(config, odometry=odometry), START, seed, scenes
            )
            for _ in range(15):
                sensors = simulator.step(Velocity2D(0.5, 0.0))
            readings_by_error.append(sensors.odometry.pose.x)
        shares.append(readings_by_error[0] / readings_by_error[1] - 1.0)
    assert np.std(shares) == pytest.approx(0.02, rel=0.2)
    assert abs(np.mean(shares)) < 4.0 * 0.02 / math.sqrt(150)


def test_robots_have_the_lidars_of_their_data_sheets():
    assert (
        SimulatorConfig().scan_steps == 1
        and Lidar(SimulatorConfig().lidar, np.random.default_rng(0)).is_plain
    )
    for name, steps in {
        "turtlebot4": 4,
        "turtlebot3_burger": 4,
        "turtlebot3_waffle": 4,
        "husky": 1,
    }.items():
        config = with_robot(SimulatorConfig(), load_robot(name))
        assert config.scan_steps == steps and config.lidar.sweeps


def test_the_same_seed_gives_the_same_errors_another_seed_others(walled_world):
    config = with_robot(SimulatorConfig(), load_robot("turtlebot4"))
    config = replace(
        config, lidar=replace(config.lidar, mixed_share=0.2, dropout_share=0.1)
    )

    def ranges(seed):
        readings = readings_of(
            Simulator(walled_world, config, START, seed), [Velocity2D(0.3, 0.4)] * 9
        )
        return np.array([reading.scan.ranges for reading in readings])

    assert np.array_equal(ranges(1), ranges(1))
    assert not np.array_equal(ranges(1), ranges(2))
