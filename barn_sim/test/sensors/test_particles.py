"""Localisation by particles: its parts, and what it makes of scans in a world whose map is right, or is not."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from driving import difference, world_with

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
from barn_worlds.base.types import ORIGIN, Pose2D, nanoseconds
from barn_worlds.datasets.dataset import open_dataset

WIDE = LocalizationConfig(mode="particles", half_cell_low=False)
AT_START = replace(WIDE, initial_std_m=0.0, initial_yaw_std_rad=0.0)
START = Pose2D(-2.25, 5.0, math.pi / 2.0)
LIDAR = PRESETS["paper2020"].lidar
MOUNT = Pose2D(LIDAR.mount_x_m, 0.0, 0.0)
SPEED_M_S = 0.4


@pytest.fixture(scope="module")
def pillars():
    """Unevenly spaced pillars along both sides and two walls ahead, which fix all three coordinates from the start."""
    sides = (4, [1, 3, 8, 10, 16, 21, 29]), (25, [2, 6, 7, 13, 18, 24, 28])
    return world_with(*sides, np.s_[8:13, 20], np.s_[18:23, 24])


def believer(config, static_map, seed=0):
    rng = np.random.default_rng(seed)
    return ParticleLocalization(config, rng, static_map, START, MOUNT)


def drive(config, world, historical, meters, seed=0):
    """Return the errors (n, 3) of the pose while a robot drives straight ahead with perfect odometry."""
    lidar = Lidar(LIDAR, np.random.default_rng(seed + 1))
    particles = believer(config, localization_map(world, historical), seed)
    errors = []
    for x in np.arange(0.0, meters + 1e-9, 0.02).tolist():
        odometry = Pose2D(x, 0.0, 0.0)
        truth = START @ odometry
        scan = lidar.scan(0, truth, world.cylinders_m, world.cylinder_radius_m)
        now_ns = nanoseconds(x / SPEED_M_S)
        estimate = particles.estimate(now_ns, odometry, lambda scan=scan: scan)
        errors.append(difference(estimate, truth))
    return np.array(errors)


def test_distances_end_at_two_meters_and_are_center_to_center():
    occupied = np.zeros((3, 30), np.bool_)
    distances = obstacle_distances(occupied, 0.15)
    assert (distances == 2.0).all()
    occupied[0, 0] = True
    distances = obstacle_distances(occupied, 0.15)
    assert (distances[0, 0], distances[0, 29]) == (0.0, 2.0)
    assert distances[0, 2] == pytest.approx(0.3)
    assert distances[2, 1] == pytest.approx(0.15 * math.sqrt(5.0))


def test_particles_in_one_bin_do_not_show_that_few_are_enough():
    needed = needed_particles(500, 2000)
    assert (needed[1], needed[2], needed[1000]) == (2000, 500, 2000)
    # The bound of KLD-sampling for 101 bins, an error of 0.05 and a quantile of 0.99.
    share = 1.0 - 2 / 900 + math.sqrt(2 / 900) * 0.99
    assert needed[101] == math.ceil(1000.0 * share**3)


def test_bins_that_touch_form_a_cluster():
    bins = [[0, 0, 0], [1, 1, 1], [2, 1, 1], [4, 1, 1], [5, 0, 1]]
    labels = cluster_labels(np.array(bins))
    assert labels[0] == labels[1] == labels[2] != labels[3] == labels[4]


def test_bins_sort_by_their_keys_as_by_their_coordinates():
    rng = np.random.default_rng(2)
    bins = particle_bins(rng.normal([-2.0, 3.0, 0.0], [1.0, 2.0, 1.5], (500, 3)))
    numbers = {"return_index": True, "return_inverse": True}
    expected, first, member = np.unique(bins, axis=0, **numbers)
    _, first_by_key, member_by_key = np.unique(bin_keys(bins), **numbers)
    assert len(expected) > 50
    assert (first_by_key == first).all()
    assert (member_by_key == member.ravel()).all()


def test_the_fit_of_a_particle_is_the_plain_sum_over_its_hits():
    rng = np.random.default_rng(3)
    particles = rng.normal(1.0, 1.0, (40, 3))
    hits = rng.normal(0.0, 3.0, (25, 2))
    table = rng.random((30, 20))
    outside = 0.25
    padded = np.pad(table, 1, constant_values=outside)
    weights = particle_weights(particles, hits, padded, -1.0, -0.5, 0.15)
    off = 0
    for particle, weight in zip(particles, weights, strict=True):
        total = 1.0
        for x, y in hits:
            at = Pose2D(*particle) @ Pose2D(x, y, 0.0)
            row = math.floor((at.y + 0.5) / 0.15)
            col = math.floor((at.x + 1.0) / 0.15)
            on_map = 0 <= row < 30 and 0 <= col < 20
            off += not on_map
            total += table[row, col] if on_map else outside
        assert weight == pytest.approx(total, rel=1e-12)
    assert 0.1 < off / (len(particles) * len(hits)) < 0.9


def test_particles_spread_widely_gather_at_the_true_pose(pillars):
    last = np.abs(drive(WIDE, pillars, False, 1.0)[-1])
    assert last[:2].max() < 0.05
    assert last[2] < 0.02


def test_a_map_read_half_a_cell_low_gives_poses_half_a_cell_low(pillars):
    errors = drive(replace(WIDE, half_cell_low=True), pillars, False, 1.0)
    assert errors[-1, :2] == pytest.approx([-0.075, -0.075], abs=0.05)


def test_the_estimate_drifts_toward_a_map_that_is_off(pillars):
    off_y = drive(AT_START, pillars, True, 4.0)[:, 1]
    assert off_y[0] == pytest.approx(0.0, abs=1e-3)
    # an update corrects little: the particles lie close together
    assert np.abs(np.diff(off_y)).max() < 0.03
    later = off_y[[50, 100, 150, 200]]
    assert (np.diff(later) < 0.0).all()
    assert -0.15 < later[-1] < -0.015
    # Particles spread widely agree with the map within a meter.
    errors = drive(WIDE, pillars, True, 1.0)
    assert errors[-1, 1] == pytest.approx(-0.15, abs=0.06)


def test_between_updates_the_pose_follows_the_odometry(pillars):
    lidar = Lidar(LIDAR, np.random.default_rng(1))
    looked_at = []

    def look(odometry):
        looked_at.append(odometry)
        pose = START @ odometry
        return lidar.scan(0, pose, pillars.cylinders_m, pillars.cylinder_radius_m)

    particles = believer(WIDE, localization_map(pillars, False), 4)
    driven = [
        ORIGIN,
        Pose2D(0.09, 0.0, 0.3),
        Pose2D(0.11, 0.0, 0.3),
        Pose2D(0.11, 0.0, 0.62),
    ]
    for odometry in driven:
        particles.estimate(0, odometry, partial(look, odometry))
    assert looked_at == [driven[0], *driven[2:]]


def test_a_correction_is_late_if_configured_the_first_is_not(pillars):
    corrections = []
    for delay_s in (0.0, 1.0):
        config = replace(WIDE, correction_delay_s=delay_s)
        poses = []
        for step, (x, y, yaw) in enumerate(drive(config, pillars, True, 2.0)):
            odometry = Pose2D(0.02 * step, 0.0, 0.0)
            truth = START @ odometry
            estimate = Pose2D(truth.x + x, truth.y + y, truth.yaw + yaw)
            pose = estimate @ odometry.inverse()
            poses.append(pose.numbers)
        corrections.append(np.array(poses))
    prompt, late = corrections
    steps = round(1.0 * SPEED_M_S / 0.02)
    assert late[:steps] == pytest.approx(np.tile(prompt[0], (steps, 1)))
    assert late[steps:] == pytest.approx(prompt[:-steps])
    assert np.abs(late - prompt).max() > 0.01


def test_the_same_seed_gives_the_same_errors(pillars):
    first, again, other = (drive(WIDE, pillars, False, 0.3, seed) for seed in (3, 3, 4))
    assert (first == again).all()
    assert (first != other).any()


def test_the_simulator_localises_in_the_historical_map_if_asked(simulators):
    world = open_dataset("barn300").load(120)
    historical, map_now = (localization_map(world, is_old) for is_old in (True, False))
    assert (historical.data != map_now.data).any()
    start = Pose2D(-2.25, 4.0, math.pi / 2.0)
    sensors, other = (
        simulators(world, config, start, 0).sense()
        for config in (
            replace(PRESETS["paper2020"], localisation=localisation)
            for localisation in (AT_START, LocalizationConfig())
        )
    )
    assert sensors.localization.distance(start) < 1e-3
    # its looks disturb no other reading
    assert sensors.scan.ranges.tobytes() == other.scan.ranges.tobytes()


@pytest.mark.parametrize("slower, faster", [(0.0, 0.1), (0.001, 0.1), (0.0, 0.0)])
def test_random_particles_are_drawn_while_the_average_falls(pillars, slower, faster):
    config = replace(AT_START, recovery_alpha_slow=slower, recovery_alpha_fast=faster)
    particles = believer(config, localization_map(pillars, False))
    slow = fast = 0.0  # 0: to begin with the next average, as amcl has it
    shares = []
    for average in (4.0, 5.0, 3.0, 0.5, 0.4, 6.0, 5.0, 0.1):
        slow = average if slow == 0.0 else slow + slower * (average - slow)
        fast = average if fast == 0.0 else fast + faster * (average - fast)
        shares.append(max(0.0, 1.0 - fast / slow))
        if shares[-1] > 0.0:
            slow = fast = 0.0
        assert particles._random_share(average) == pytest.approx(shares[-1])
    assert (max(shares) > 0.0) == (faster > 0.0)


def test_random_particles_lie_in_free_cells(pillars):
    static_map = localization_map(pillars, False)
    poses = believer(AT_START, static_map)._random_poses(5000)
    away = poses[:, :2] - static_map.origin
    columns, rows = (away / static_map.resolution).astype(int).T
    free = static_map.data == 0
    assert free[rows, columns].all()
    assert len(set(zip(rows, columns, strict=True))) > 0.9 * free.sum()
    assert np.abs(poses[:, 2]).max() <= math.pi < np.ptp(poses[:, 2])
