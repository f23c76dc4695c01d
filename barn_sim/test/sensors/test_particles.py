"""Localisation by particles: its parts, and what it makes of scans in a world whose map is right, or is not."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from barn_sim.config import PRESETS, LocalizationConfig
from barn_sim.sensors.lidar import Lidar
from barn_sim.sensors.localization import localization_map
from barn_sim.sensors.particles import (
    ParticleLocalization,
    bin_keys,
    cluster_labels,
    needed_particles,
    obstacle_distances,
    particle_bins,
    particle_weights,
)
from barn_worlds.base.types import Pose2D, nanoseconds
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.worlds.world import World

WIDE = LocalizationConfig(mode="particles", half_cell_low=False)
AT_START = replace(WIDE, initial_std_m=0.0, initial_yaw_std_rad=0.0)
START = Pose2D(-2.25, 5.0, math.pi / 2.0)
LIDAR = PRESETS["paper2020"].lidar
MOUNT = Pose2D(LIDAR.mount_x_m, 0.0, 0.0)
SPEED_M_S = 0.4


@pytest.fixture(scope="module")
def pillars():
    """Unevenly spaced pillars along both sides and two walls ahead, which fix all three coordinates from the start."""
    grid = np.zeros((30, 30), np.bool_)
    grid[4, [1, 3, 8, 10, 16, 21, 29]] = grid[25, [2, 6, 7, 13, 18, 24, 28]] = True
    grid[8:13, 20] = grid[18:23, 24] = True
    return World("pillars", grid, np.array([[15, column] for column in range(30)]))


def drive(
    config,
    world,
    static_map,
    meters,
    seed=0,
):
    """Return the errors (n, 3) of the pose while a robot drives straight ahead with perfect odometry."""
    lidar = Lidar(LIDAR, np.random.default_rng(seed + 1))
    believer = ParticleLocalization(
        config, np.random.default_rng(seed), static_map, START, MOUNT
    )
    errors = []
    for x in np.arange(0.0, meters + 1e-9, 0.02):
        truth = START @ Pose2D(float(x), 0.0, 0.0)
        scan = lidar.scan(0, truth, world.cylinders_m, world.cylinder_radius_m)
        estimate = believer.estimate(
            nanoseconds(x / SPEED_M_S),
            Pose2D(float(x), 0.0, 0.0),
            lambda scan=scan: scan,
        )
        errors.append(
            (estimate.x - truth.x, estimate.y - truth.y, estimate.yaw - truth.yaw)
        )
    return np.array(errors)


def test_distances_end_at_two_meters_and_are_center_to_center():
    data = np.zeros((3, 30), np.int8)
    data[0, 0] = 100
    distances = obstacle_distances(data >= 65, 0.15)
    assert (distances[0, 0], distances[0, 2], distances[0, 29]) == (
        0.0,
        pytest.approx(0.3),
        2.0,
    )
    assert distances[2, 1] == pytest.approx(0.15 * math.sqrt(5.0))
    assert (obstacle_distances(np.zeros((2, 2), np.bool_), 0.15) == 2.0).all()


def test_particles_in_one_bin_do_not_show_that_few_are_enough():
    assert needed_particles(500, 2000)[1] == 2000
    assert needed_particles(500, 2000)[2] == 500
    # The bound of KLD-sampling for 101 bins, an error of 0.05 and a quantile of 0.99.
    assert needed_particles(500, 2000)[101] == math.ceil(
        1000.0 * (1.0 - 2 / 900 + math.sqrt(2 / 900) * 0.99) ** 3
    )
    assert needed_particles(500, 2000)[1000] == 2000


def test_bins_that_touch_form_a_cluster():
    labels = cluster_labels(
        np.array([[0, 0, 0], [1, 1, 1], [2, 1, 1], [4, 1, 1], [5, 0, 1]])
    )
    assert labels[0] == labels[1] == labels[2] != labels[3] == labels[4]


def test_bins_sort_by_their_keys_as_by_their_coordinates():
    particles = np.random.default_rng(2).normal(
        [-2.0, 3.0, 0.0], [1.0, 2.0, 1.5], (500, 3)
    )
    bins = particle_bins(particles)
    expected, first, member = np.unique(
        bins, axis=0, return_index=True, return_inverse=True
    )
    _, first_by_key, member_by_key = np.unique(
        bin_keys(bins), return_index=True, return_inverse=True
    )
    assert len(expected) > 50
    assert (first_by_key == first).all()
    assert (member_by_key == member.ravel()).all()


def test_the_fit_of_a_particle_is_the_plain_sum_over_its_hits():
    rng = np.random.default_rng(3)
    particles = rng.normal(1.0, 1.0, (40, 3))
    hits = rng.normal(0.0, 3.0, (25, 2))
    table = rng.random((30, 20))
    outside = 0.25
    weights = particle_weights(
        particles, hits, np.pad(table, 1, constant_values=outside), -1.0, -0.5, 0.15
    )
    off = 0
    for (x, y, yaw), weight in zip(particles, weights, strict=True):
        total = 1.0
        for hit in hits:
            at = Pose2D(x, y, yaw) @ Pose2D(hit[0], hit[1], 0.0)
            row = math.floor((at.y + 0.5) / 0.15)
            col = math.floor((at.x + 1.0) / 0.15)
            on_map = 0 <= row < 30 and 0 <= col < 20
            off += not on_map
            total += table[row, col] if on_map else outside
        assert weight == pytest.approx(total, rel=1e-12)
    assert 0.1 < off / (len(particles) * len(hits)) < 0.9


def test_particles_spread_widely_gather_at_the_true_pose(pillars):
    errors = np.abs(drive(WIDE, pillars, localization_map(pillars, False), 1.0))
    assert errors[-1, :2].max() < 0.05
    assert errors[-1, 2] < 0.02


def test_a_map_read_half_a_cell_low_gives_poses_half_a_cell_low(pillars):
    errors = drive(
        replace(WIDE, half_cell_low=True),
        pillars,
        localization_map(pillars, False),
        1.0,
    )
    assert errors[-1, :2] == pytest.approx([-0.075, -0.075], abs=0.05)


def test_the_estimate_drifts_toward_a_map_that_is_off(
    pillars,
):
    off_y = drive(AT_START, pillars, localization_map(pillars, True), 4.0)[:, 1]
    assert off_y[0] == pytest.approx(0.0, abs=1e-3)
    steps = np.abs(np.diff(off_y))
    assert (
        steps.max() < 0.03
    )  # an update corrects little: the particles lie close together
    later = off_y[[50, 100, 150, 200]]
    assert (np.diff(later) < 0.0).all()
    assert -0.15 < later[-1] < -0.015
    # Particles spread widely agree with the map within a meter.
    assert drive(WIDE, pillars, localization_map(pillars, True), 1.0)[
        -1, 1
    ] == pytest.approx(-0.15, abs=0.06)


def test_between_updates_the_pose_follows_the_odometry(pillars):
    lidar = Lidar(LIDAR, np.random.default_rng(1))
    looked_at = []

    def look(odometry):
        looked_at.append(odometry)
        return lidar.scan(
            0, START @ odometry, pillars.cylinders_m, pillars.cylinder_radius_m
        )

    believer = ParticleLocalization(
        WIDE, np.random.default_rng(4), localization_map(pillars, False), START, MOUNT
    )
    driven = [
        Pose2D(0.0, 0.0, 0.0),
        Pose2D(0.09, 0.0, 0.3),
        Pose2D(0.11, 0.0, 0.3),
        Pose2D(0.11, 0.0, 0.62),
    ]
    for odometry in driven:
        believer.estimate(0, odometry, partial(look, odometry))
    assert looked_at == [driven[0], *driven[2:]]


def test_a_correction_is_late_if_configured_the_first_is_not(
    pillars,
):
    static_map = localization_map(pillars, True)
    corrections = []
    for delay_s in (0.0, 1.0):
        errors = drive(
            replace(WIDE, correction_delay_s=delay_s), pillars, static_map, 2.0
        )
        traveled = [Pose2D(0.02 * step, 0.0, 0.0) for step in range(len(errors))]
        truths = [START @ odometry for odometry in traveled]
        believed = [
            Pose2D(t.x + x, t.y + y, t.yaw + yaw)
            for t, (x, y, yaw) in zip(truths, errors, strict=True)
        ]
        estimates = [
            pose @ odometry.inverse()
            for pose, odometry in zip(believed, traveled, strict=True)
        ]
        corrections.append(np.array([(pose.x, pose.y, pose.yaw) for pose in estimates]))
    prompt, late = corrections
    steps = round(1.0 * SPEED_M_S / 0.02)
    assert late[:steps] == pytest.approx(np.tile(prompt[0], (steps, 1)))
    assert late[steps:] == pytest.approx(prompt[:-steps])
    assert np.abs(late - prompt).max() > 0.01


def test_the_same_seed_gives_the_same_errors(pillars):
    static_map = localization_map(pillars, False)
    first, again, other = (
        drive(WIDE, pillars, static_map, 0.3, seed) for seed in (3, 3, 4)
    )
    assert (first == again).all()
    assert (first != other).any()


def test_the_simulator_localises_in_the_historical_map_if_asked(simulators):
    world = open_dataset("barn300").load(120)
    assert (
        localization_map(world, True).data != localization_map(world, False).data
    ).any()
    wide = Pose2D(-2.25, 4.0, math.pi / 2.0)
    sensors, other = (
        simulators(
            world, replace(PRESETS["paper2020"], localisation=config), wide, 0
        ).sense()
        for config in (AT_START, LocalizationConfig())
    )
    assert sensors.localization.distance(wide) < 1e-3
    assert (
        sensors.scan.ranges.tobytes() == other.scan.ranges.tobytes()
    )  # its looks disturb no other reading


@pytest.mark.parametrize("alphas", [(0.0, 0.1), (0.001, 0.1), (0.0, 0.0)])
def test_random_particles_are_drawn_while_the_average_falls(pillars, alphas):
    config = replace(
        AT_START, recovery_alpha_slow=alphas[0], recovery_alpha_fast=alphas[1]
    )
    believer = ParticleLocalization(
        config, np.random.default_rng(0), localization_map(pillars, False), START, MOUNT
    )
    slow = fast = 0.0  # 0: to begin with the next average, as amcl has it
    shares = []
    for average in (4.0, 5.0, 3.0, 0.5, 0.4, 6.0, 5.0, 0.1):
        slow = average if slow == 0.0 else slow + alphas[0] * (average - slow)
        fast = average if fast == 0.0 else fast + alphas[1] * (average - fast)
        shares.append(max(0.0, 1.0 - fast / slow))
        if shares[-1] > 0.0:
            slow = fast = 0.0
        assert believer._random_share(average) == pytest.approx(shares[-1])
    assert (max(shares) > 0.0) == (alphas[1] > 0.0)


def test_random_particles_lie_in_free_cells(
    pillars,
):
    static_map = localization_map(pillars, False)
    believer = ParticleLocalization(
        AT_START, np.random.default_rng(0), static_map, START, MOUNT
    )
    poses = believer._random_poses(5000)
    columns = ((poses[:, 0] - static_map.origin_x) / static_map.resolution).astype(int)
    rows = ((poses[:, 1] - static_map.origin_y) / static_map.resolution).astype(int)
    assert (static_map.data[rows, columns] == 0).all()
    assert (
        len(set(zip(rows, columns, strict=True))) > 0.9 * (static_map.data == 0).sum()
    )
    assert np.abs(poses[:, 2]).max() <= math.pi < np.ptp(poses[:, 2])
