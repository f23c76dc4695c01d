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
from barn_worlds.base.types import Odometry, Pose2D, Velocity2D
from barn_worlds.geometry.footprint import Rectangle

EXTENT = Rectangle([-0.25, -0.2, 0.25, 0.2])
FAR = np.array([[100.0, 100.0]])
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
    assert trajectory.contact.tolist() == [False, True]


def test_lengths_turns_and_times():
    poses = [
        Pose2D(5.0, 7.0, 0.0),
        Pose2D(6.0, 7.0, 3.0),
        Pose2D(6.0, 8.0, -3.0),
        Pose2D(6.0, 8.0, -3.0),
    ]
    figures = measure_trajectory(drive(poses), FAR, 0.075, EXTENT)
    assert (figures.driven_m, figures.driven_ratio) == pytest.approx(
        (2.0, 2.0 / math.sqrt(2.0))
    )
    assert figures.rotation_rad == pytest.approx(3.0 + (2.0 * math.pi - 6.0))
    assert figures.mean_speed_mps == pytest.approx(2.0 / 0.15)


@pytest.mark.parametrize(
    ("contacts", "count", "contact_s"),
    [({1, 3}, 2, 0.1), ({2, 3, 4}, 1, 0.15), ({0, 2}, 2, 0.05)],
    ids=["two", "one that lasts", "one in the first reading, of no time"],
)
def test_contacts_are_counted_and_last_since_the_reading_before(
    contacts, count, contact_s
):
    figures = measure_trajectory(
        drive([Pose2D(0.0, 0.0, 0.0)] * 6, contacts=contacts), FAR, 0.075, EXTENT
    )
    assert (figures.contacts, figures.contact_s) == (count, pytest.approx(contact_s))


def test_a_motion_of_some_millimetres_has_a_speed_and_a_ratio():
    figures = measure_trajectory(
        drive([Pose2D(1.0, 1.0, 0.0), Pose2D(1.003, 1.004, 0.0)]), FAR, 0.075, EXTENT
    )
    assert (
        figures.driven_m,
        figures.driven_ratio,
        figures.mean_speed_mps,
    ) == pytest.approx((0.005, 1.0, 0.1))


def test_a_way_back_to_its_beginning_has_no_ratio():
    round_trip = [
        Pose2D(1.0, 1.0, 0.0),
        Pose2D(2.0, 1.0, 0.0),
        Pose2D(1.0, 1.0, 0.0),
    ]
    measures = measure_trajectory(drive(round_trip), FAR, 0.075, EXTENT)
    assert (measures.driven_m, measures.driven_ratio) == (2.0, None)


def test_clearance_of_a_trajectory_is_its_smallest_and_its_mean():
    approach = [Pose2D(0.0, 0.0, 0.0), Pose2D(0.1, 0.0, 0.0), Pose2D(0.5, 0.0, 0.0)]
    measures = measure_trajectory(
        drive(approach), np.array([[1.0, 0.0]]), 0.075, EXTENT
    )
    gaps = (measures.min_clearance_m, measures.mean_clearance_m)
    assert gaps == pytest.approx(
        (0.5 - 0.25 - 0.075, (1.0 + 0.9 + 0.5) / 3.0 - 0.25 - 0.075)
    )
    nothing_near = measure_trajectory(drive(approach), np.empty((0, 2)), 0.075, EXTENT)
    assert (nothing_near.min_clearance_m, nothing_near.mean_clearance_m) == (None, None)


def test_jerk_between_readings_that_are_not_evenly_spaced():
    # speeds 0, 1, 4, 4 m/s after 0, 1, 3 and 4 s: accelerations 1, 1.5 and 0 m/s2, 1.5 s apart
    stamps_ns = [0, 1_000_000_000, 3_000_000_000, 4_000_000_000]
    trajectory = drive(
        [Pose2D(0.0, 0.0, 0.0)] * 4, speeds=[0.0, 1.0, 4.0, 4.0], stamps_ns=stamps_ns
    )
    expected = math.sqrt(((0.5 / 1.5) ** 2 + (1.5 / 1.5) ** 2) / 2.0)
    assert measure_trajectory(
        trajectory, FAR, 0.075, EXTENT
    ).rms_jerk_mps3 == pytest.approx(expected)


def test_jerk_needs_three_readings_at_different_times():
    def jerk(stamps_ns):
        poses = [Pose2D(0.0, 0.0, 0.0)] * len(stamps_ns)
        return measure_trajectory(
            drive(poses, stamps_ns=stamps_ns), FAR, 0.075, EXTENT
        ).rms_jerk_mps3

    assert jerk([0, PERIOD_NS]) is None
    assert jerk([0, PERIOD_NS, 2 * PERIOD_NS]) == 0.0
    assert jerk([0, PERIOD_NS, PERIOD_NS, 2 * PERIOD_NS]) is None


def plainly(trajectory):
    """The measures that controllers are compared by, in plain loops."""
    times = [stamp / 1e9 for stamp in trajectory.stamps_ns.tolist()]
    rates = trajectory.velocity[:, 1].tolist()
    changes = [
        (b - a) / (t - s)
        for a, b, s, t in zip(rates, rates[1:], times, times[1:], strict=False)
    ]
    jerks = [
        (b - a) / (0.5 * (times[k + 2] - times[k]))
        for k, (a, b) in enumerate(itertools.pairwise(changes))
    ]
    commands = [
        row for row in trajectory.command.tolist() if all(map(math.isfinite, row))
    ]
    steps = [
        [b[axis] - a[axis] for a, b in itertools.pairwise(commands)] for axis in (0, 1)
    ]
    return {
        "rms_yaw_jerk_radps3": math.sqrt(sum(value**2 for value in jerks) / len(jerks)),
        "speed_variation_mps": sum(abs(value) for value in steps[0]),
        "turn_variation_radps": sum(abs(value) for value in steps[1]),
        "rms_speed_step_mps": math.sqrt(
            sum(value**2 for value in steps[0]) / len(steps[0])
        ),
        "rms_turn_step_radps": math.sqrt(
            sum(value**2 for value in steps[1]) / len(steps[1])
        ),
    }


@pytest.mark.parametrize("seed", range(5))
def test_smoothness_measures_equal_plain_loops(seed):
    rng = np.random.default_rng(seed)
    count = 30
    stamps_ns = np.cumsum(rng.integers(1, 100, count)) * 1_000_000
    command = rng.uniform(-1.0, 1.0, (count, 2))
    command[rng.random(count) < 0.2] = (
        np.nan
    )  # nothing was sent: the last command holds
    command[-1, seed % 2] = (np.nan, np.inf)[
        seed // 2 % 2
    ]  # no command, which ends a trial
    velocity = rng.uniform(-1.0, 1.0, (count, 2))
    trajectory = Trajectory(
        stamps_ns,
        rng.uniform(0.0, 1.0, (count, 3)),
        velocity,
        command,
        np.zeros(count, np.bool_),
        np.full(count, np.nan),
        np.ones(count, np.int64),
    )
    figures = measure_trajectory(trajectory, FAR, 0.075, EXTENT)
    for key, expected in plainly(trajectory).items():
        assert getattr(figures, key) == pytest.approx(expected), key
    assert figures.off_plan_m is None


def test_time_near_an_obstacle_is_that_up_to_readings_there():
    ahead = [Pose2D(x, 0.0, 0.0) for x in (0.0, 0.58, 0.65, 0.57, 0.66)]
    measures = measure_trajectory(
        drive(ahead), np.array([[1.0, 0.0]]), 0.075, EXTENT
    )  # touched at 0.675 m
    assert measures.near_contact_s == pytest.approx(3 * PERIOD_NS / 1e9)
    assert (
        measure_trajectory(drive(ahead), np.empty((0, 2)), 0.075, EXTENT).near_contact_s
        == 0.0
    )
    assert (
        measure_trajectory(
            drive([Pose2D(0.0, 0.0, 0.0)] * 2), np.array([[0.5, 0.0]]), 0.15, EXTENT
        ).near_contact_s
        == 0.0
    )


def test_two_commands_have_one_step():
    assert (
        measure_trajectory(
            drive([Pose2D(0.0, 0.0, 0.0)] * 2), FAR, 0.075, EXTENT
        ).rms_speed_step_mps
        == 0.5
    )


def test_no_two_commands_have_no_steps():
    for commands in (False, True):
        measures = measure_trajectory(
            drive([Pose2D(0.0, 0.0, 0.0)] * 1, commands=commands), FAR, 0.075, EXTENT
        )
        assert (
            measures.speed_variation_mps,
            measures.rms_turn_step_radps,
            measures.off_plan_m,
        ) == (None, None, None)


def test_the_plan_distance_is_to_the_last_published_plan():
    log = TrajectoryLog()
    for stamp_ns in range(0, 1_600_000_000, 250_000_000):
        log.reading(
            Odometry(stamp_ns, Pose2D(9.0, 9.0, 0.0), Velocity2D(0.0, 0.0)),
            False,
            Pose2D(1.0, 0.5, 0.0),
        )
    log.plan(np.array([[1.0, 0.0]]), 250_000_000)
    log.plan(np.array([[0.0, 0.9], [4.0, 0.9]]), 749_999_999)  # too soon
    log.plan(np.linspace([5.0, 0.5], [4.0, 0.5], 10_000), 750_000_000)
    log.plan(np.array([[0.0, 0.9], [4.0, 0.9]]), 1_249_999_999)  # too soon
    for wrong in (
        np.empty((0, 2)),
        np.array([[math.nan, 0.0]]),
        np.zeros((3, 3)),
        np.zeros((10_001, 2)),
    ):
        log.plan(wrong, 1_250_000_000)
    trajectory = log.trajectory()
    np.testing.assert_allclose(
        trajectory.off_plan_m, [math.nan, math.nan, 0.5, 0.5, 3.0, 3.0, 3.0]
    )
    assert measure_trajectory(
        trajectory, FAR, 0.075, EXTENT
    ).off_plan_m == pytest.approx(2.0)


def test_readings_without_an_answer_are_counted_but_for_the_last():
    assert (
        measure_trajectory(
            drive([Pose2D(0.0, 0.0, 0.0)] * 5, commands=False), FAR, 0.075, EXTENT
        ).unanswered_cycles
        == 4
    )
    assert (
        measure_trajectory(
            drive([Pose2D(0.0, 0.0, 0.0)] * 5), FAR, 0.075, EXTENT
        ).unanswered_cycles
        == 0
    )


@pytest.mark.parametrize("count", [0, 1, 2])
def test_the_shortest_trajectories_have_measures(count):
    measures = measure_trajectory(
        drive([Pose2D(0.0, 0.0, 0.0)] * count), FAR, 0.075, EXTENT
    )
    assert (measures.driven_m, measures.driven_ratio, measures.rms_jerk_mps3) == (
        0.0,
        None,
        None,
    )
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
    assert compute_clearances(np.array([pose]), np.array([[1.0, 0.0]]), 0.075, EXTENT)[
        0
    ] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("ahead_m", "left_m", "expected"),
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
    assert compute_clearances(
        np.array([[pose.x, pose.y, pose.yaw]]), center, 0.075, outline
    )[0] == pytest.approx(expected)


def test_clearance_is_to_the_nearest_of_many():
    rng = np.random.default_rng(1)
    poses = rng.uniform(-2, 2, (200, 3))
    centers = rng.uniform(-2, 2, (50, 2))
    each = [
        compute_clearances(poses, center[None], 0.075, EXTENT) for center in centers
    ]
    np.testing.assert_array_equal(
        compute_clearances(poses, centers, 0.075, EXTENT), np.min(each, axis=0)
    )
    assert compute_clearances(poses, np.empty((0, 2)), 0.075, EXTENT).size == 0
