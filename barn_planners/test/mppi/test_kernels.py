"""The kernels of MPPI against plain NumPy, one term of one sample at a time."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.distance import cdist

from barn_planners.costmap.config import CostmapConfig, rectangle
from barn_planners.costmap.costmap import RollingCostmap
from barn_planners.mppi import kernels, sampling
from barn_planners.mppi.planner import lowest_cost_in_reach
from barn_worlds.base.types import ORIGIN, Pose2D, Scan

SAMPLES = 40
STEPS = 30
DT = 0.05
SPREAD = np.array([0.2, 0.4])
CHANGE = DT * np.array([[3.0, 2.0], [3.5, 3.5]])
START = (0.3, -0.2, 0.7, 0.25, -0.4)
POSE = Pose2D(*START[:3])
PATH = np.column_stack([0.3 + 0.05 * np.arange(20), -0.2 + 0.04 * np.arange(20)])
BODY = rectangle(0.25, 0.2)


@pytest.fixture
def samples():
    """Return (controls, poses, nominal, noise) of a rollout, samples last."""
    rng = np.random.default_rng(5)
    rates = 0.5 * np.sin(np.arange(STEPS) / 5.0)
    nominal = np.column_stack([np.full(STEPS, 0.4), rates])
    noise = rng.standard_normal((STEPS, 2, SAMPLES)).astype(np.float32)
    controls = np.empty((STEPS, 2, SAMPLES), np.float32)
    poses = np.empty((STEPS, 3, SAMPLES), np.float32)
    sampling.rollout(nominal, noise, SPREAD, CHANGE, START, DT, controls, poses)
    return controls, poses, nominal, noise


@pytest.fixture
def poses(samples):
    return samples[1]


@pytest.fixture
def places(poses):
    """Return the x, y and yaw (steps, samples) of all poses."""
    return poses.swapaxes(0, 1)


def scan_of(ranges, increment):
    return Scan(0, ranges.astype(np.float32), -1.5, increment, 0.1, 30.0)


def add_obstacle_costs(costs, poses, costmap, lowest, every, near_goal):
    return kernels.add_obstacle_costs(
        costs,
        poses,
        costmap.costs,
        costmap.grid,
        BODY,
        lowest,
        every,
        3.0,
        300.0,
        1e6,
        near_goal,
    )


@pytest.mark.parametrize("seed", [0, 7])
def test_noise_is_that_of_numpy_to_the_last_bit(seed):
    state = sampling.noise_state(seed)
    generator = np.random.Generator(np.random.SFC64(seed))
    # rows of one and three leave half a draw behind
    for rows, columns in ((1, 3), (112, 4000), (3, 1), (112, 4000)):
        numbers = np.empty((rows, columns), np.float32)
        sampling.fill_normal(state, numbers)
        expected = generator.standard_normal((columns, rows), dtype=np.float32).T
        assert numbers.tobytes() == expected.tobytes()
    assert np.abs(numbers).max() > 3.7, "some numbers must come from the tail"


def test_length_is_hypot():
    rng = np.random.default_rng(3)
    for scale in (1.0, 1e-9, 0.0):
        for x, y in rng.normal(size=(500, 2)) * (1.0, scale):
            assert kernels.length(x, y) == pytest.approx(math.hypot(x, y), rel=3e-16)
            assert kernels.length(y, x) == kernels.length(x, y)
    assert kernels.length(0.0, 0.0) == 0.0


def test_smoothing_and_limits():
    rng = np.random.default_rng(4)
    controls = rng.normal(size=(STEPS, 2))
    sent = rng.normal(size=(2, 2))
    weights = rng.uniform(0.0, 1.0, 5)
    smooth = sampling.smooth(controls, sent, weights)
    whole = np.concatenate([sent, controls, controls[-1:], controls[-1:]])
    expected = [np.convolve(column, weights[::-1], mode="valid") for column in whole.T]
    assert_allclose(smooth, np.stack(expected, axis=1), rtol=1e-12)
    held = smooth.copy()
    sampling.limit_controls(held, np.array([-0.1, 0.4, 0.5]), CHANGE, (0.2, -0.1))
    last = np.array([0.2, -0.1])
    for smoothed, control in zip(smooth, held, strict=True):
        last = changed(last, np.clip(smoothed, [-0.1, -0.5], [0.4, 0.5]))
        assert control == pytest.approx(last, abs=1e-12)


def changed(last, wanted):
    """Return speed and rate as near to what is wanted as they can be a step later."""
    slower, faster = CHANGE.T
    return np.clip(wanted, last - slower, last + faster)


def wrapped(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


def test_rollout(samples, places):
    controls, _, nominal, noise = samples
    for k in range(SAMPLES):
        x, y, yaw, *last = START
        for t in range(STEPS):
            wanted = nominal[t] + SPREAD * noise[t, :, k]
            last = changed(np.array(last), wanted)
            speed, rate = last
            x += speed * DT * math.cos(yaw)
            y += speed * DT * math.sin(yaw)
            yaw += rate * DT
            assert controls[t, :, k] == pytest.approx(last, abs=1e-6)
            assert places[:, t, k] == pytest.approx([x, y, yaw], abs=1e-6)


def test_heading_by_series_stays_exact_at_the_fastest_turn():
    steps = 400
    noise = np.zeros((steps, 2, 1), np.float32)
    nominal = np.tile([1.0, 1.9], (steps, 1))
    controls = np.empty_like(noise)
    poses = np.empty((steps, 3, 1), np.float32)
    start = (0.0, 0.0, 0.0, 1.0, 1.9)
    free = np.full((2, 2), 9.0)
    sampling.rollout(nominal, noise, SPREAD, free, start, DT, controls, poses)
    headings = 1.9 * DT * np.arange(steps)
    xs, ys, _ = poses[:, :, 0].T
    assert_allclose(xs, DT * np.cumsum(np.cos(headings)), atol=2e-6)
    assert_allclose(ys, DT * np.cumsum(np.sin(headings)), atol=2e-6)


def footprint_touches(costmap, pose):
    """Tell by dense points along the outline whether it touches a lethal cell."""
    for a, b in zip(BODY, np.roll(BODY, -1, axis=0), strict=True):
        line = np.linspace(a, b, 200)
        if any(costmap.cost_at(*point) == 254 for point in pose.transform(line)):
            return True
    return False


@pytest.mark.parametrize("near_goal", [False, True])
def test_obstacle_costs(poses, near_goal):
    config = CostmapConfig(
        resolution_m=0.02, size_m=5.0, inflation_radius_m=0.5, cost_scaling_per_m=3.0
    )
    costmap = RollingCostmap(config)
    angles = np.linspace(-1.5, 1.5, 601)
    ranges = np.where(np.abs(angles) > 1.2, 0.6, np.inf)
    ranges[np.abs(angles - 0.2) < 0.25] = 0.8
    costmap.update(POSE, scan_of(ranges, 0.005), ORIGIN)
    costs = np.full(SAMPLES, 7.0)
    collisions = add_obstacle_costs(costs, poses, costmap, 0, 2, near_goal)
    expected = np.full(SAMPLES, 7.0)
    collided = np.zeros(SAMPLES, bool)
    for k in range(SAMPLES):
        looked_at = [Pose2D(*pose) for pose in poses[::2, :, k].tolist()]
        cells = [costmap.cost_at(*pose.position) for pose in looked_at]
        collided[k] = 254 in cells or any(
            cell > 0 and footprint_touches(costmap, pose)
            for cell, pose in zip(cells, looked_at, strict=True)
        )
        free = [0.0 if near_goal else cell for cell in cells if cell < 253]
        soft = sum(free) + 300.0 * (len(cells) - len(free))
        expected[k] += 1e6 if collided[k] else 3.0 / 254.0 * soft / len(cells)
    same = np.isclose(costs, expected, rtol=1e-9)
    # only outlines that graze the corner of a cell may be judged differently
    assert same.mean() >= 0.95
    assert abs(collisions - collided.sum()) <= (~same).sum()
    assert 3 <= collided.sum() <= SAMPLES - 3
    assert (expected[~collided] > 7.0).any() or near_goal


def test_checking_the_footprint_rarely_changes_nothing(poses):
    config = CostmapConfig(
        resolution_m=0.05,
        size_m=5.0,
        inflation_radius_m=0.8,
        cost_scaling_per_m=3.0,
        footprint_half_length_m=0.25,
        footprint_half_width_m=0.2,
        footprint_padding_m=0.0,
    )
    rng = np.random.default_rng(1)
    lowest = lowest_cost_in_reach(config, 0.05)
    counts = []
    for _ in range(40):
        costmap = RollingCostmap(config)
        scan = scan_of(rng.uniform(0.5, 3.0, 30), 0.1)
        costmap.update(POSE, scan, ORIGIN)
        always, rarely = np.zeros((2, SAMPLES))
        counts.append(add_obstacle_costs(always, poses, costmap, 0, 1, False))
        counts.append(add_obstacle_costs(rarely, poses, costmap, lowest, 1, False))
        assert_array_equal(always, rarely)
    assert lowest > 50
    assert min(counts) < SAMPLES // 2
    assert max(counts) > 0


def test_the_furthest_point_reached(poses):
    ends = poses[-1, :2].T
    nearest = cdist(ends, PATH).argmin(axis=1)
    assert kernels.find_furthest_point(PATH, poses) == nearest.max()


def test_costs_of_the_end(poses):
    x, y, yaw = poses[-1]
    costs = np.zeros(SAMPLES)
    kernels.add_follow_costs(costs, poses, 1.0, 0.5, 5.0)
    assert_allclose(costs, 5.0 * np.hypot(x - 1.0, y - 0.5), rtol=1e-6)
    costs[:] = 0.0
    kernels.add_angle_costs(costs, poses, -1.0, 0.5, 2.0)
    turn = wrapped(np.arctan2(0.5 - y, -1.0 - x) - yaw)
    assert_allclose(costs, 2.0 * np.abs(turn), atol=1e-5)


@pytest.mark.parametrize("hidden", [3, range(5)])
def test_align_costs(poses, hidden):
    lengths = np.hypot(*np.diff(PATH, axis=0).T)
    arc = np.cumsum([0.0, *lengths])
    clear = ~np.isin(np.arange(len(PATH)) % 5, hidden)
    costs = np.zeros(SAMPLES)
    kernels.add_align_costs(costs, poses, START[:2], PATH, arc, clear, 4, 14.0)
    for k in range(SAMPLES):
        places = [START[:2], *poses[4::4, :2, k]]
        traveled = np.cumsum([math.dist(a, b) for a, b in pairwise(places)])
        beside = cdist(traveled[:, None], arc[:, None]).argmin(axis=1)
        away = np.hypot(*(PATH[beside] - places[1:]).T)[clear[beside]]
        expected = 14.0 * away.mean() if len(away) else 0.0
        assert costs[k] == pytest.approx(expected, abs=1e-5)


def test_goal_costs(poses, places):
    xs, ys, yaws = places
    costs = np.zeros(SAMPLES)
    kernels.add_goal_costs(costs, poses, (1.0, 0.3, -2.5), 5.0, 3.0)
    distance = np.hypot(xs - 1.0, ys - 0.3).mean(axis=0)
    angle = np.abs(wrapped(yaws.astype(float) + 2.5)).mean(axis=0)
    assert_allclose(costs, 5.0 * distance + 3.0 * angle, rtol=1e-5)


def test_control_costs(samples):
    controls, _, nominal, _ = samples
    costs = np.zeros(SAMPLES)
    limits = np.array([-0.1, 0.4, 0.5])
    kernels.add_control_costs(
        costs, controls, nominal, SPREAD, limits, DT, 0.015, 4.0, 5.0
    )
    speed, rate = controls.astype(float).swapaxes(0, 1)
    away = controls - nominal[..., None]
    weights = (nominal / SPREAD**2)[..., None]
    deviation = (weights * away).sum(axis=(0, 1))
    beyond = np.maximum(speed - 0.4, 0)
    beyond += np.maximum(-0.1 - speed, 0)
    beyond += np.maximum(np.abs(rate) - 0.5, 0)
    penalties = 4.0 * beyond + 5.0 * np.maximum(-speed, 0)
    expected = 0.015 * deviation + DT * penalties.sum(axis=0)
    assert_allclose(costs, expected, atol=1e-5)


def test_weighted_mean(samples):
    controls = samples[0]
    costs = np.random.default_rng(2).uniform(1e6, 1e6 + 3.0, SAMPLES)
    mean = np.empty((STEPS, 2))
    sampling.weighted_mean(costs, controls, 0.3, mean)
    weights = np.exp((costs.min() - costs) / 0.3)
    expected = np.average(controls, axis=2, weights=weights)
    assert_allclose(mean, expected, atol=1e-6)


@pytest.mark.parametrize("most", [4, 100])
def test_resample(most):
    corner = np.array([[0.0, 0.0], [0.33, 0.0], [0.33, 0.0], [0.33, 0.4]])
    traveled = [*np.arange(0.0, 0.73, 0.1), 0.73]
    along = [(min(d, 0.33), max(0.0, d - 0.33)) for d in traveled]
    points = kernels.resample(corner, 0.1, most)
    assert_allclose(points, along[:most], atol=1e-12)
    assert_array_equal(kernels.resample(corner[:1], 0.1, most), corner[:1])
