"""The kernels of MPPI against plain NumPy, one term of one sample at a time."""

import math
from itertools import pairwise

import numpy as np
import pytest

from barn_planners.costmap.config import CostmapConfig, rectangle
from barn_planners.costmap.costmap import RollingCostmap
from barn_planners.mppi import kernels, sampling
from barn_planners.mppi.planner import lowest_cost_in_reach
from barn_worlds.base.types import Pose2D, Scan

SAMPLES = 40
STEPS = 30
DT = 0.05
SPREAD = np.array([0.2, 0.4])
CHANGE = DT * np.array([[3.0, 2.0], [3.5, 3.5]])
START = (0.3, -0.2, 0.7, 0.25, -0.4)
PATH = np.array([[0.3 + 0.05 * i, -0.2 + 0.04 * i] for i in range(20)])


@pytest.fixture
def samples():
    """Return (controls, poses, nominal, noise) of a rollout, samples last."""
    rng = np.random.default_rng(5)
    nominal = np.stack(
        [np.full(STEPS, 0.4), 0.5 * np.sin(np.arange(STEPS) / 5.0)], axis=1
    )
    noise = rng.standard_normal((STEPS, 2, SAMPLES)).astype(np.float32)
    controls = np.empty((STEPS, 2, SAMPLES), np.float32)
    poses = np.empty((STEPS, 3, SAMPLES), np.float32)
    sampling.rollout(nominal, noise, SPREAD, CHANGE, START, DT, controls, poses)
    return controls, poses, nominal, noise


@pytest.mark.parametrize("seed", [0, 7])
def test_noise_is_that_of_numpy_to_the_last_bit(seed):
    state = sampling.noise_state(seed)
    generator = np.random.Generator(np.random.SFC64(seed))
    for rows, columns in (
        (1, 3),
        (112, 4000),
        (3, 1),
        (112, 4000),
    ):  # rows of one and three leave half a draw behind
        numbers = np.empty((rows, columns), np.float32)
        sampling.fill_normal(state, numbers)
        expected = generator.standard_normal((columns, rows), dtype=np.float32).T
        np.testing.assert_array_equal(
            numbers.view(np.uint32), np.ascontiguousarray(expected).view(np.uint32)
        )
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
    np.testing.assert_allclose(smooth, np.stack(expected, axis=1), rtol=1e-12)
    held = smooth.copy()
    sampling.limit_controls(held, np.array([-0.1, 0.4, 0.5]), CHANGE, (0.2, -0.1))
    speed = 0.2
    rate = -0.1
    for smoothed, got in zip(smooth, held, strict=True):
        speed = np.clip(
            np.clip(smoothed[0], -0.1, 0.4), speed - CHANGE[0, 0], speed + CHANGE[0, 1]
        )
        rate = np.clip(
            np.clip(smoothed[1], -0.5, 0.5), rate - CHANGE[1, 0], rate + CHANGE[1, 1]
        )
        assert got == pytest.approx((speed, rate), abs=1e-12)


def wrapped(angle):
    return np.arctan2(np.sin(angle), np.cos(angle))


def test_rollout(samples):
    controls, poses, nominal, noise = samples
    xs, ys, yaws = poses.swapaxes(0, 1)
    for k in range(SAMPLES):
        x, y, yaw, speed, rate = START
        for t in range(STEPS):
            control = nominal[t] + SPREAD * noise[t, :, k]
            speed = float(
                np.clip(control[0], speed - CHANGE[0, 0], speed + CHANGE[0, 1])
            )
            rate = float(np.clip(control[1], rate - CHANGE[1, 0], rate + CHANGE[1, 1]))
            x, y, yaw = (
                x + speed * DT * math.cos(yaw),
                y + speed * DT * math.sin(yaw),
                yaw + rate * DT,
            )
            assert controls[t, :, k] == pytest.approx((speed, rate), abs=1e-6)
            assert (xs[t, k], ys[t, k], yaws[t, k]) == pytest.approx(
                (x, y, yaw), abs=1e-6
            )


def test_heading_by_series_stays_exact_at_the_fastest_turn():
    steps = 400
    noise = np.zeros((steps, 2, 1), np.float32)
    nominal = np.tile([1.0, 1.9], (steps, 1))
    controls = np.empty_like(noise)
    poses = np.empty((steps, 3, 1), np.float32)
    start = (0.0, 0.0, 0.0, 1.0, 1.9)
    sampling.rollout(
        nominal, noise, SPREAD, np.full((2, 2), 9.0), start, DT, controls, poses
    )
    headings = 1.9 * DT * np.arange(steps)
    xs = poses[:, 0]
    ys = poses[:, 1]
    np.testing.assert_allclose(xs[:, 0], DT * np.cumsum(np.cos(headings)), atol=2e-6)
    np.testing.assert_allclose(ys[:, 0], DT * np.cumsum(np.sin(headings)), atol=2e-6)


def footprint_touches(costmap, x, y, yaw, half_length, half_width):
    """Tell by dense points along the outline whether it touches a lethal cell."""
    corners = rectangle(half_length, half_width)
    pose = Pose2D(x, y, yaw)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        line = np.linspace(a, b, 200)
        if any(costmap.cost_at(*point) == 254 for point in pose.transform(line)):
            return True
    return False


@pytest.mark.parametrize("near_goal", [False, True])
def test_obstacle_costs(samples, near_goal):
    _, poses, _, _ = samples
    xs, ys, yaws = poses.swapaxes(0, 1)
    costmap = RollingCostmap(
        CostmapConfig(
            resolution_m=0.02,
            size_m=5.0,
            inflation_radius_m=0.5,
            cost_scaling_per_m=3.0,
        )
    )
    angles = np.linspace(-1.5, 1.5, 601)
    ranges = np.where(
        np.abs(angles - 0.2) < 0.25, 0.8, np.where(np.abs(angles) > 1.2, 0.6, np.inf)
    )
    costmap.update(
        Pose2D(0.3, -0.2, 0.7),
        Scan(0, ranges.astype(np.float32), -1.5, 0.005, 0.1, 30.0),
        Pose2D(0.0, 0.0, 0.0),
    )
    costs = np.full(SAMPLES, 7.0)
    collisions = kernels.add_obstacle_costs(
        costs,
        poses,
        costmap.costs,
        costmap.grid,
        rectangle(0.25, 0.2),
        0,
        2,
        3.0,
        300.0,
        1e6,
        near_goal,
    )
    expected = []
    collided = []
    for k in range(SAMPLES):
        looked_at = range(0, STEPS, 2)
        cells = [costmap.cost_at(float(xs[t, k]), float(ys[t, k])) for t in looked_at]
        touching = [
            cell > 0
            and footprint_touches(
                costmap, float(xs[t, k]), float(ys[t, k]), float(yaws[t, k]), 0.25, 0.2
            )
            for cell, t in zip(cells, looked_at, strict=True)
        ]
        collided.append(any(touching) or 254 in cells)
        soft = sum(
            300.0 if cell >= 253 else 0.0 if near_goal else cell for cell in cells
        )
        expected.append(
            7.0 + (1e6 if collided[-1] else 3.0 / 254.0 * soft / len(cells))
        )
    same = np.isclose(costs, expected, rtol=1e-9)
    assert same.mean() >= 0.95, (
        "only outlines that graze the corner of a cell may be judged differently"
    )
    assert abs(collisions - sum(collided)) <= (~same).sum()
    assert 3 <= sum(collided) <= SAMPLES - 3
    assert (
        any(
            not hit and cost > 7.0 for hit, cost in zip(collided, expected, strict=True)
        )
        or near_goal
    )


def test_checking_the_footprint_rarely_changes_nothing(samples):
    _, poses, _, _ = samples
    body = {
        "footprint_half_length_m": 0.25,
        "footprint_half_width_m": 0.2,
        "footprint_padding_m": 0.0,
    }
    config = CostmapConfig(
        resolution_m=0.05,
        size_m=5.0,
        inflation_radius_m=0.8,
        cost_scaling_per_m=3.0,
        **body,
    )
    rng = np.random.default_rng(1)
    counts = []
    for _ in range(40):
        costmap = RollingCostmap(config)
        scan = Scan(
            0, rng.uniform(0.5, 3.0, 30).astype(np.float32), -1.5, 0.1, 0.1, 30.0
        )
        costmap.update(Pose2D(0.3, -0.2, 0.7), scan, Pose2D(0.0, 0.0, 0.0))
        both = np.zeros((2, SAMPLES))
        for costs, lowest in zip(
            both, (0, lowest_cost_in_reach(config, 0.05)), strict=True
        ):
            counts.append(
                kernels.add_obstacle_costs(
                    costs,
                    poses,
                    costmap.costs,
                    costmap.grid,
                    rectangle(0.25, 0.2),
                    lowest,
                    1,
                    3.0,
                    300.0,
                    1e6,
                    False,
                )
            )
        np.testing.assert_array_equal(both[0], both[1])
    assert lowest_cost_in_reach(config, 0.05) > 50
    assert min(counts) < SAMPLES // 2
    assert max(counts) > 0


def test_the_furthest_point_reached(samples):
    _, poses, _, _ = samples
    xs, ys, _ = poses.swapaxes(0, 1)
    ends = np.stack([xs[-1], ys[-1]], axis=1)
    nearest = np.hypot(*(ends[:, None] - PATH[None]).transpose(2, 0, 1)).argmin(axis=1)
    assert kernels.find_furthest_point(PATH, poses) == nearest.max()


def test_costs_of_the_end(samples):
    _, poses, _, _ = samples
    xs, ys, yaws = poses.swapaxes(0, 1)
    costs = np.zeros(SAMPLES)
    kernels.add_follow_costs(costs, poses, 1.0, 0.5, 5.0)
    np.testing.assert_allclose(
        costs, 5.0 * np.hypot(xs[-1] - 1.0, ys[-1] - 0.5), rtol=1e-6
    )
    costs[:] = 0.0
    kernels.add_angle_costs(costs, poses, -1.0, 0.5, 2.0)
    expected = 2.0 * np.abs(wrapped(np.arctan2(0.5 - ys[-1], -1.0 - xs[-1]) - yaws[-1]))
    np.testing.assert_allclose(costs, expected, atol=1e-5)


@pytest.mark.parametrize("hidden", [3, range(5)])
def test_align_costs(samples, hidden):
    _, poses, _, _ = samples
    xs, ys, _ = poses.swapaxes(0, 1)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(PATH, axis=0).T))])
    clear = ~np.isin(np.arange(len(PATH)) % 5, hidden)
    costs = np.zeros(SAMPLES)
    kernels.add_align_costs(costs, poses, START[:2], PATH, arc, clear, 4, 14.0)
    for k in range(SAMPLES):
        places = [START[:2]] + [(xs[t, k], ys[t, k]) for t in range(4, STEPS, 4)]
        traveled = np.cumsum([math.dist(a, b) for a, b in pairwise(places)])
        beside = [int(np.abs(arc - length).argmin()) for length in traveled]
        distances = [
            math.dist(PATH[i], pose)
            for i, pose in zip(beside, places[1:], strict=True)
            if clear[i]
        ]
        assert costs[k] == pytest.approx(
            14.0 * np.mean(distances) if distances else 0.0, abs=1e-5
        )


def test_goal_costs(samples):
    _, poses, _, _ = samples
    xs, ys, yaws = poses.swapaxes(0, 1)
    costs = np.zeros(SAMPLES)
    kernels.add_goal_costs(costs, poses, (1.0, 0.3, -2.5), 5.0, 3.0)
    distance = np.hypot(xs - 1.0, ys - 0.3).mean(axis=0)
    angle = np.abs(wrapped(yaws.astype(float) + 2.5)).mean(axis=0)
    np.testing.assert_allclose(costs, 5.0 * distance + 3.0 * angle, rtol=1e-5)


def test_control_costs(samples):
    controls, _, nominal, _ = samples
    costs = np.zeros(SAMPLES)
    kernels.add_control_costs(
        costs,
        controls,
        nominal,
        SPREAD,
        np.array([-0.1, 0.4, 0.5]),
        DT,
        0.015,
        4.0,
        5.0,
    )
    speed = controls[:, 0].astype(float)
    rate = controls[:, 1].astype(float)
    deviation = (
        (nominal / SPREAD**2)[..., None] * (controls - nominal[..., None])
    ).sum(axis=(0, 1))
    beyond = (
        np.maximum(speed - 0.4, 0)
        + np.maximum(-0.1 - speed, 0)
        + np.maximum(np.abs(rate) - 0.5, 0)
    )
    expected = 0.015 * deviation + DT * (
        4.0 * beyond + 5.0 * np.maximum(-speed, 0)
    ).sum(axis=0)
    np.testing.assert_allclose(costs, expected, atol=1e-5)


def test_weighted_mean(samples):
    controls = samples[0]
    costs = np.random.default_rng(2).uniform(1e6, 1e6 + 3.0, SAMPLES)
    mean = np.empty((STEPS, 2))
    sampling.weighted_mean(costs, controls, 0.3, mean)
    weights = np.exp(-(costs - costs.min()) / 0.3)
    expected = (weights * controls).sum(axis=2) / weights.sum()
    np.testing.assert_allclose(mean, expected, atol=1e-6)


@pytest.mark.parametrize("most", [4, 100])
def test_resample(most):
    corner = np.array([[0.0, 0.0], [0.33, 0.0], [0.33, 0.0], [0.33, 0.4]])
    along = [(min(d, 0.33), max(0.0, d - 0.33)) for d in np.arange(0.0, 0.73, 0.1)] + [
        (0.33, 0.4)
    ]
    np.testing.assert_allclose(
        kernels.resample(corner, 0.1, most), along[:most], atol=1e-12
    )
    np.testing.assert_array_equal(kernels.resample(corner[:1], 0.1, most), corner[:1])
