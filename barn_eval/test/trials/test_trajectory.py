"""Measures of trajectories against cases worked out by hand and a slow reference."""

import itertools
import math

import numpy as np
import pytest

from barn_eval.trials.trajectory import (
    Trajectory,
    TrajectoryLog,
    compute_clearances,
    measure_trajectory,
)
from barn_worlds.base.types import ORIGIN, Odometry, Pose2D, Velocity2D
from barn_worlds.geometry.footprint import Rectangle

EXTENT = Rectangle([-0.25, -0.2, 0.25, 0.2])
FAR = [[100.0, 100.0]]
PERIOD_NS = 50_000_000


def drive(poses, speeds=None, contacts=(), commands=True, stamps_ns=None):
    log = TrajectoryLog()
    for step, pose in enumerate(poses):
        speed = 0.0 if speeds is None else speeds[step]
        stamp_ns = (step + 20) * PERIOD_NS if stamps_ns is None else stamps_ns[step]
        log.reading(Odometry(stamp_ns, pose, Velocity2D(speed, 0.0)), step in contacts)
        if commands:
            log.command(Velocity2D(0.5 * step, 0.1))
    return log.trajectory()


def still(count):
    return [ORIGIN] * count


def measure(poses, centers=FAR, radius_m=0.075, **driven):
    """Return the measures of a drive by poses among cylinders."""
    trajectory = drive(poses, **driven)
    return measure_trajectory(trajectory, np.array(centers), radius_m, EXTENT)


def test_the_log_keeps_readings_with_their_commands():
    log = TrajectoryLog()
    log.command(Velocity2D(9.0, 9.0))  # answers nothing
    log.reading(Odometry(5, Pose2D(1.0, 2.0, 3.0), Velocity2D(0.4, 0.5)), False)
    log.reading(Odometry(7, Pose2D(1.5, 2.5, 3.5), Velocity2D(0.6, 0.7)), True)
    log.command(Velocity2D(0.1, 0.2))
    log.command(Velocity2D(0.3, 0.4))  # replaces it
    trajectory = log.trajectory()
    assert trajectory.stamps_ns.tolist() == [5, 7]
    assert trajectory.truth.tolist() == [[1.0, 2.0, 3.0], [1.5, 2.5, 3.5]]
    assert trajectory.velocity.tolist() == [[0.4, 0.5], [0.6, 0.7]]
    np.testing.assert_array_equal(trajectory.command, [[np.nan, np.nan], [0.3, 0.4]])
    assert trajectory.command_counts.tolist() == [0, 2]
    assert trajectory.contact.tolist() == [False, True]


def test_lengths_turns_and_times():
    poses = [
        Pose2D(5.0, 7.0, 0.0),
        Pose2D(6.0, 7.0, 3.0),
        Pose2D(6.0, 8.0, -3.0),
        Pose2D(6.0, 8.0, -3.0),
    ]
    figures = measure(poses)
    assert figures.driven_m == pytest.approx(2.0)
    assert figures.driven_ratio == pytest.approx(2.0 / math.sqrt(2.0))
    assert figures.rotation_rad == pytest.approx(3.0 + (2.0 * math.pi - 6.0))
    assert figures.mean_speed_mps == pytest.approx(2.0 / 0.15)


@pytest.mark.parametrize(
    "contacts, count, contact_s",
    [({1, 3}, 2, 0.1), ({2, 3, 4}, 1, 0.15), ({0, 2}, 2, 0.05)],
    ids=["two", "one that lasts", "one in the first reading, of no time"],
)
def test_contacts_are_counted_and_last_since_the_reading_before(
    contacts, count, contact_s
):
    figures = measure(still(6), contacts=contacts)
    assert (figures.contacts, figures.contact_s) == (count, pytest.approx(contact_s))


def test_a_motion_of_some_millimetres_has_a_speed_and_a_ratio():
    figures = measure([Pose2D(1.0, 1.0, 0.0), Pose2D(1.003, 1.004, 0.0)])
    assert figures.driven_m == pytest.approx(0.005)
    assert figures.driven_ratio == pytest.approx(1.0)
    assert figures.mean_speed_mps == pytest.approx(0.1)


def test_a_way_back_to_its_beginning_has_no_ratio():
    measures = measure([Pose2D(x, 1.0, 0.0) for x in (1.0, 2.0, 1.0)])
    assert (measures.driven_m, measures.driven_ratio) == (2.0, None)


def test_clearance_of_a_trajectory_is_its_smallest_and_its_mean():
    approach = [Pose2D(x, 0.0, 0.0) for x in (0.0, 0.1, 0.5)]
    measures = measure(approach, [[1.0, 0.0]])
    mean_m = (1.0 + 0.9 + 0.5) / 3.0
    assert measures.min_clearance_m == pytest.approx(0.5 - 0.25 - 0.075)
    assert measures.mean_clearance_m == pytest.approx(mean_m - 0.25 - 0.075)
    nothing_near = measure(approach, np.empty((0, 2)))
    assert nothing_near.min_clearance_m is nothing_near.mean_clearance_m is None


def test_jerk_between_readings_that_are_not_evenly_spaced():
    # speeds 0, 1, 4, 4 m/s after 0, 1, 3 and 4 s: accelerations 1, 1.5 and 0 m/s2, 1.5
    # s apart
    stamps_ns = [0, 1_000_000_000, 3_000_000_000, 4_000_000_000]
    measures = measure(still(4), speeds=[0.0, 1.0, 4.0, 4.0], stamps_ns=stamps_ns)
    mean_square = ((0.5 / 1.5) ** 2 + (1.5 / 1.5) ** 2) / 2.0
    assert measures.rms_jerk_mps3 == pytest.approx(math.sqrt(mean_square))


def test_jerk_needs_three_readings_at_different_times():
    def jerk(stamps_ns):
        return measure(still(len(stamps_ns)), stamps_ns=stamps_ns).rms_jerk_mps3

    assert jerk([0, PERIOD_NS]) is None
    assert jerk([0, PERIOD_NS, 2 * PERIOD_NS]) == 0.0
    assert jerk([0, PERIOD_NS, PERIOD_NS, 2 * PERIOD_NS]) is None


def plainly(trajectory):
    """The measures that controllers are compared by, in plain loops."""
    times = [stamp / 1e9 for stamp in trajectory.stamps_ns.tolist()]
    rates = trajectory.velocity[:, 1].tolist()
    changes = []
    for k in range(len(rates) - 1):
        changes.append((rates[k + 1] - rates[k]) / (times[k + 1] - times[k]))
    jerks = []
    for k in range(len(changes) - 1):
        middle_s = 0.5 * (times[k + 2] - times[k])
        jerks.append((changes[k + 1] - changes[k]) / middle_s)
    rows = trajectory.command.tolist()
    commands = [row for row in rows if all(map(math.isfinite, row))]
    pairs = list(itertools.pairwise(commands))
    speed_steps = [b[0] - a[0] for a, b in pairs]
    turn_steps = [b[1] - a[1] for a, b in pairs]
    return {
        "rms_yaw_jerk_radps3": rms(jerks),
        "speed_variation_mps": sum(map(abs, speed_steps)),
        "turn_variation_radps": sum(map(abs, turn_steps)),
        "rms_speed_step_mps": rms(speed_steps),
        "rms_turn_step_radps": rms(turn_steps),
    }


def rms(values):
    return math.sqrt(sum(value**2 for value in values) / len(values))


@pytest.mark.parametrize("seed", range(5))
def test_smoothness_measures_equal_plain_loops(seed):
    rng = np.random.default_rng(seed)
    count = 30
    stamps_ns = np.cumsum(rng.integers(1, 100, count)) * 1_000_000
    command = rng.uniform(-1.0, 1.0, (count, 2))
    # nothing was sent: the last command holds
    command[rng.random(count) < 0.2] = np.nan
    # no command, which ends a trial
    command[-1, seed % 2] = np.nan if seed // 2 % 2 == 0 else np.inf
    velocity = rng.uniform(-1.0, 1.0, (count, 2))
    poses = rng.uniform(0.0, 1.0, (count, 3))
    contact = np.zeros(count, np.bool_)
    off_plan_m = np.full(count, np.nan)
    command_counts = np.ones(count, np.int64)
    trajectory = Trajectory(
        stamps_ns, poses, velocity, command, contact, off_plan_m, command_counts
    )
    figures = measure_trajectory(trajectory, np.array(FAR), 0.075, EXTENT)
    for key, expected in plainly(trajectory).items():
        assert getattr(figures, key) == pytest.approx(expected), key
    assert figures.off_plan_m is None


def test_time_near_an_obstacle_is_that_up_to_readings_there():
    ahead = [Pose2D(x, 0.0, 0.0) for x in (0.0, 0.58, 0.65, 0.57, 0.66)]
    measures = measure(ahead, [[1.0, 0.0]])  # touched at 0.675 m
    assert measures.near_contact_s == pytest.approx(3 * PERIOD_NS / 1e9)
    assert measure(ahead, np.empty((0, 2))).near_contact_s == 0.0
    assert measure(still(2), [[0.5, 0.0]], 0.15).near_contact_s == 0.0


def test_two_commands_have_one_step():
    assert measure(still(2)).rms_speed_step_mps == 0.5


def test_no_two_commands_have_no_steps():
    for commands in (False, True):
        measures = measure(still(1), commands=commands)
        assert measures.speed_variation_mps is measures.rms_turn_step_radps is None
        assert measures.off_plan_m is None


def test_the_plan_distance_is_to_the_last_published_plan():
    log = TrajectoryLog()
    for stamp_ns in range(0, 1_600_000_000, 250_000_000):
        odometry = Odometry(stamp_ns, Pose2D(9.0, 9.0, 0.0), Velocity2D(0.0, 0.0))
        log.reading(odometry, False, Pose2D(1.0, 0.5, 0.0))
    near = np.array([[0.0, 0.9], [4.0, 0.9]])
    log.plan(np.array([[1.0, 0.0]]), 250_000_000)
    log.plan(near, 749_999_999)  # too soon
    log.plan(np.linspace([5.0, 0.5], [4.0, 0.5], 10_000), 750_000_000)
    log.plan(near, 1_249_999_999)  # too soon
    for wrong in (
        np.empty((0, 2)),
        np.array([[math.nan, 0.0]]),
        np.zeros((3, 3)),
        np.zeros((10_001, 2)),
    ):
        log.plan(wrong, 1_250_000_000)
    trajectory = log.trajectory()
    expected = [math.nan, math.nan, 0.5, 0.5, 3.0, 3.0, 3.0]
    np.testing.assert_allclose(trajectory.off_plan_m, expected)
    measures = measure_trajectory(trajectory, np.array(FAR), 0.075, EXTENT)
    assert measures.off_plan_m == pytest.approx(2.0)


def test_readings_without_an_answer_are_counted_but_for_the_last():
    assert measure(still(5), commands=False).unanswered_cycles == 4
    assert measure(still(5)).unanswered_cycles == 0


@pytest.mark.parametrize("count", [0, 1, 2])
def test_the_shortest_trajectories_have_measures(count):
    measures = measure(still(count))
    assert measures.driven_m == 0.0
    assert measures.driven_ratio is measures.rms_jerk_mps3 is None
    assert (measures.min_clearance_m is None) == (count == 0)


def clearance(pose, centers, outline=EXTENT):
    """Return the clearance of one pose among cylinders."""
    (gap_m,) = compute_clearances(np.array([pose]), np.array(centers), 0.075, outline)
    return gap_m


@pytest.mark.parametrize(
    "pose, expected",
    [
        ((0.0, 0.0, 0.0), 1.0 - 0.25 - 0.075),
        ((0.0, 0.0, math.pi / 2), 1.0 - 0.2 - 0.075),
        ((0.5, 0.3, 0.0), math.hypot(0.25, 0.1) - 0.075),
        ((1.0, 0.0, 0.0), -0.2 - 0.075),
    ],
)
def test_clearance_to_one_cylinder(pose, expected):
    assert clearance(pose, [[1.0, 0.0]]) == pytest.approx(expected)


@pytest.mark.parametrize(
    "ahead_m, left_m, expected",
    [
        (1.0, 0.45, math.hypot(0.6, 0.4) - 0.075),
        (-0.4, -0.75, math.hypot(0.3, 0.4) - 0.075),
        (0.1, -0.1, -0.15 - 0.075),
    ],
    ids=["ahead on the left", "behind on the right", "inside"],
)
def test_clearance_is_from_an_outline_that_need_not_be_centred(
    ahead_m, left_m, expected
):
    pose = Pose2D(0.3, -0.2, 0.6)
    outline = Rectangle([-0.1, -0.35, 0.4, 0.05])
    center = pose.transform(np.array([[ahead_m, left_m]]))
    assert clearance(pose.numbers, center, outline) == pytest.approx(expected)


def test_clearance_is_to_the_nearest_of_many():
    rng = np.random.default_rng(1)
    poses = rng.uniform(-2, 2, (200, 3))
    centers = rng.uniform(-2, 2, (50, 2))
    each = [
        compute_clearances(poses, center[None], 0.075, EXTENT) for center in centers
    ]
    gaps_m = compute_clearances(poses, centers, 0.075, EXTENT)
    np.testing.assert_array_equal(gaps_m, np.min(each, axis=0))
    assert compute_clearances(poses, np.empty((0, 2)), 0.075, EXTENT).size == 0
