"""The ray caster against a plain reference, against PyBullet's own rays, and REP-117."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from barn_sim.config import PRESETS, LidarConfig
from barn_sim.contact.bullet import bullet, connect, disconnect
from barn_sim.sensors.lidar import Lidar
from barn_sim.sensors.ray_casting import ROUGH_RAD, rough_angle
from barn_worlds.base.arrays import unit_vectors
from barn_worlds.base.types import ORIGIN, Pose2D, wrap_angle

QUIET = LidarConfig(noise_m=0.0)
AROUND = {"angle_min_rad": -math.pi, "angle_max_rad": math.pi}


def lidar(config, seed=0):
    return Lidar(config, np.random.default_rng(seed))


def reference(pose, scan, mount_x, centers, radius):
    """Every beam against every circle, by the quadratic equation, in float64."""
    sensor = pose @ Pose2D(mount_x, 0.0, 0.0)
    angles = scan.angles() + sensor.yaw
    beams = unit_vectors(angles)
    to_centre = centers - sensor.position
    along = beams @ to_centre.T
    square = (to_centre**2).sum(axis=1) - radius**2
    root = along**2 - square
    with np.errstate(invalid="ignore"):
        hits = along - np.sqrt(root)
    hits = np.where((root >= 0.0) & (hits >= 0.0), hits, np.inf)
    nearest = hits.min(axis=1, initial=np.inf)
    return np.zeros_like(nearest) if (square <= 0.0).any() else nearest


def limited(ranges, scan):
    """Return ranges as a scan tells them by its limits."""
    beyond = np.where(ranges > scan.range_max, np.inf, ranges)
    return np.where(ranges < scan.range_min, -np.inf, beyond).astype(np.float32)


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 40),
    radius=st.floats(0.01, 0.6),
    full_circle=st.booleans(),
    beams=st.sampled_from([1, 2, 37, 720]),
)
def test_agrees_with_the_reference(seed, count, radius, full_circle, beams):
    rng = np.random.default_rng(seed)
    centers = rng.uniform(-4.0, 4.0, (count, 2))
    pose = Pose2D(*rng.uniform(-2.0, 2.0, 2), rng.uniform(-3.2, 3.2))
    spread = AROUND if full_circle else {}
    config = replace(QUIET, beams=beams, range_max_m=5.0, **spread)
    scan = lidar(config).scan(0, pose, centers, radius)
    hits = reference(pose, scan, config.mount_x_m, centers, radius)
    expected = limited(hits, scan)
    # a beam along a tangent may be counted as a hit or a miss: the chord is then shorter than rounding tells
    same = (scan.ranges == expected) | np.isclose(scan.ranges, expected, atol=1e-5)
    assert (~same).sum() <= 1
    assert scan.ranges.dtype == np.float32


def test_upright_cylinders_cast_in_space_are_circles():
    rng = np.random.default_rng(5)
    centers = rng.uniform(-3.0, 3.0, (30, 2))
    pose = Pose2D(-3.5, 0.0, 0.4)
    upright = np.hstack([centers, np.tile([0.2, 0.0, 0.0, 1.0, 0.5], (30, 1))])
    flat = lidar(QUIET).scan(0, pose, centers, 0.075)
    solid = lidar(QUIET).scan(0, pose, np.full((30, 2), np.inf), 0.075, upright)
    differs = ~np.isclose(flat.ranges, solid.ranges, atol=1e-5)
    assert differs.sum() <= 1
    assert np.isfinite(flat.ranges).sum() > 100


def bullet_ranges(client, pose, scan):
    sensor = pose @ Pose2D(QUIET.mount_x_m, 0.0, 0.0)
    angles = scan.angles() + sensor.yaw
    reach = scan.range_max
    starts = np.tile([*sensor.position, 0.3], (len(angles), 1))
    beams = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    ends = (starts + reach * beams).tolist()
    hits = bullet.rayTestBatch(starts.tolist(), ends, physicsClientId=client)
    ranges = [hit[2] * reach if hit[0] >= 0 else np.inf for hit in hits]
    return limited(np.array(ranges), scan)


def test_tilted_cylinders_agree_with_the_rays_of_pybullet():
    rng = np.random.default_rng(11)
    client = connect()
    try:
        shape = bullet.createCollisionShape(
            bullet.GEOM_CYLINDER, radius=0.075, height=1.0, physicsClientId=client
        )
        rows = []
        for _ in range(12):
            position = [*rng.uniform(-2.5, 2.5, 2), rng.uniform(0.1, 0.6)]
            q = bullet.getQuaternionFromEuler(rng.uniform(-1.5, 1.5, 3).tolist())
            axis = np.array(bullet.getMatrixFromQuaternion(q)).reshape(3, 3)[:, 2]
            bullet.createMultiBody(0.0, shape, -1, position, q, physicsClientId=client)
            rows.append([*position[:2], position[2] - 0.3, *axis, 0.5])
        pose = Pose2D(-3.0, 0.0, 0.0)
        scan = lidar(QUIET).scan(0, pose, np.empty((0, 2)), 0.075, np.array(rows))
        theirs = bullet_ranges(client, pose, scan)
    finally:
        disconnect(client)
    same = np.isclose(scan.ranges, theirs, atol=0.01) | (scan.ranges == theirs)
    assert np.isfinite(scan.ranges).sum() > 60
    assert (~same).sum() <= 7  # 1% of the beams, at edges


def test_limits_hold_after_the_noise():
    config = LidarConfig(beams=720, noise_m=0.05, range_max_m=2.0, mount_x_m=0.0)
    angles = np.arange(0, 6.28, 0.05)
    ring = 2.075 * unit_vectors(angles)
    ranges = lidar(config).scan(0, ORIGIN, ring, 0.075).ranges
    finite = ranges[np.isfinite(ranges)]
    assert finite.max() <= np.float32(2.0)
    assert 0 < len(finite) < len(ranges)
    assert np.isposinf(ranges[~np.isfinite(ranges)]).all()


@pytest.mark.parametrize("name", ["default", "jazzy", "paper2020"])
def test_presets_see_a_wall_at_its_distance(name):
    config = replace(PRESETS[name].lidar, noise_m=0.0)
    scan = lidar(config).scan(0, ORIGIN, np.array([[3.0, 0.0]]), 0.075)
    assert len(scan.ranges) == config.beams
    middle = np.argmin(np.abs(scan.angles()))
    distance = 3.0 - 0.075 - config.mount_x_m
    assert scan.ranges[middle] == pytest.approx(distance, abs=1e-3)
    # numbers of a message are of single precision: a scan must not change on its way through one
    for number in (
        scan.angle_min,
        scan.angle_increment,
        scan.range_min,
        scan.range_max,
    ):
        assert float(np.float32(number)) == number


def test_a_rough_angle_is_near_the_exact_one():
    vectors = np.random.default_rng(0).uniform(-5.0, 5.0, (20_000, 2)).tolist()
    axes = [[0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [-1.0, 0.0]]
    for y, x in [*vectors, *axes, [1.0, 1.0], [-1e-9, -1.0]]:
        off = wrap_angle(rough_angle(y, x) - math.atan2(y, x))
        assert abs(off) < ROUGH_RAD
