"""Measures of trajectories against cases worked out by hand and a slow reference."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from barn_eval.trials.trajectory import TrajectoryLog, clearances, measure
from barn_worlds.types import Odometry, Pose2D, Velocity2D

EXTENT = np.array([-0.25, -0.2, 0.25, 0.2])
FAR = np.array([[100.0, 100.0]])
PERIOD_NS = 50_000_000


def drive(poses, speeds=None, contacts=(), commands=True):
    log = TrajectoryLog()
    for step, pose in enumerate(poses):
        speed = 0.0 if speeds is None else speeds[step]
        log.reading(Odometry(step * PERIOD_NS, pose, Velocity2D(speed, 0.0)), step in contacts)
        if commands:
            log.command(Velocity2D(0.5, 0.1))
    return log.trajectory()


def test_lengths_turns_and_times():
    poses = [Pose2D(0.0, 0.0, 0.0), Pose2D(1.0, 0.0, 3.0), Pose2D(1.0, 1.0, -3.0), Pose2D(1.0, 1.0, -3.0)]
    measures = measure(drive(poses, contacts={1, 3}), FAR, 0.075, EXTENT)
    assert measures.driven_m == pytest.approx(2.0)
    assert measures.driven_ratio == pytest.approx(2.0 / math.sqrt(2.0))
    assert measures.rotation_rad == pytest.approx(3.0 + (2.0 * math.pi - 6.0))
    assert measures.mean_speed_mps == pytest.approx(2.0 / 0.15)
    assert (measures.contact_s, measures.contacts) == (pytest.approx(0.1), 2)


def test_contact_that_lasts_is_one_contact():
    measures = measure(drive([Pose2D(0.0, 0.0, 0.0)] * 6, contacts={2, 3, 4}), FAR, 0.075, EXTENT)
    assert (measures.contacts, measures.contact_s) == (1, pytest.approx(0.15))


def test_jerk_of_a_known_speed():
    times = np.arange(40) * 0.05
    measures = measure(drive([Pose2D(0.0, 0.0, 0.0)] * 40, speeds=0.5 * 3.0 * times**2), FAR, 0.075, EXTENT)
    assert measures.rms_jerk_mps3 == pytest.approx(3.0)


def test_readings_without_an_answer_are_counted_but_for_the_last():
    assert measure(drive([Pose2D(0.0, 0.0, 0.0)] * 5, commands=False), FAR, 0.075, EXTENT).unanswered_cycles == 4
    assert measure(drive([Pose2D(0.0, 0.0, 0.0)] * 5), FAR, 0.075, EXTENT).unanswered_cycles == 0


@pytest.mark.parametrize("count", [0, 1, 2])
def test_the_shortest_trajectories_have_measures(count):
    measures = measure(drive([Pose2D(0.0, 0.0, 0.0)] * count), FAR, 0.075, EXTENT)
    assert (measures.driven_m, measures.driven_ratio, measures.rms_jerk_mps3) == (0.0, None, None)
    assert (measures.min_clearance_m is None) == (count == 0)


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        ((0.0, 0.0, 0.0), 1.0 - 0.25 - 0.075),
        ((0.0, 0.0, math.pi / 2), 1.0 - 0.2 - 0.075),
        ((0.5, 0.3, 0.0), math.hypot(0.25, 0.1) - 0.075),
        ((1.0, 0.0, 0.0), -0.2 - 0.075),
    ],
)
def test_clearance_to_one_cylinder(pose, expected):
    assert clearances(np.array([pose]), np.array([[1.0, 0.0]]), 0.075, EXTENT)[0] == pytest.approx(expected)


def distance_by_search(pose, centre):
    """Return the distance from a point to the outline's rectangle, by trying its points; 0 inside."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = centre[0] - pose[0], centre[1] - pose[1]
    local = np.array([c * x + s * y, c * y - s * x])
    u, v = np.meshgrid(np.linspace(EXTENT[0], EXTENT[2], 201), np.linspace(EXTENT[1], EXTENT[3], 161))
    return float(np.hypot(u - local[0], v - local[1]).min())


coordinate = st.floats(-1.5, 1.5)


@settings(max_examples=100, deadline=None)
@given(pose=st.tuples(coordinate, coordinate, st.floats(-4.0, 4.0)), centre=st.tuples(coordinate, coordinate))
def test_clearance_is_that_of_a_search_over_the_outline(pose, centre):
    found = clearances(np.array([pose]), np.array([centre]), 0.075, EXTENT)[0]
    slow = distance_by_search(pose, centre) - 0.075
    if found > -0.075:
        assert found == pytest.approx(slow, abs=2e-3)
    else:
        assert slow == pytest.approx(-0.075, abs=2e-3)


def test_clearance_is_to_the_nearest_of_many():
    rng = np.random.default_rng(1)
    poses, centres = rng.uniform(-2, 2, (200, 3)), rng.uniform(-2, 2, (50, 2))
    each = [clearances(poses, centre[None], 0.075, EXTENT) for centre in centres]
    np.testing.assert_array_equal(clearances(poses, centres, 0.075, EXTENT), np.min(each, axis=0))
    assert clearances(poses, np.empty((0, 2)), 0.075, EXTENT).size == 0
