"""Measures among moving obstacles against cases worked out by hand and plain references."""

import math
from dataclasses import replace

import pytest
from trials.test_trajectory import EXTENT, drive

from barn_eval.trials.encounters import measure_encounters
from barn_eval.trials.protocol import DYNABARN
from barn_worlds.base.types import Pose2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.moving.motion import Motion, MovingObstacle, Wall
from barn_worlds.worlds.world import World


def world_of(*keys: tuple[float, float, float], **shape: object) -> World:
    motion = Motion("linear", 10.0, keys)
    body = shape or {"radius_m": 0.5}
    arena = open_dataset("dynabarn60").load(0)
    far = Motion("linear", 10.0, ((0.0, 50.0, 60.0), (10.0, 50.0, 60.0)))
    distant = (
        MovingObstacle(name, motion=far, radius_m=0.5) for name in ("one", "two")
    )
    return replace(
        arena,
        walls=(),
        moving=(*distant, MovingObstacle("walker", motion=motion, **body)),
    )


def figures(
    world: World,
    poses,
    speeds,
    contacts=(),
    *,
    turn_radps=0.0,
    phase_s=0.0,
    traversal_s=None,
):
    trajectory = drive(poses, speeds, contacts)
    trajectory.velocity[:, 1] = turn_radps
    encounters = measure_encounters(
        trajectory, world, phase_s, EXTENT, DYNABARN, traversal_s
    )
    assert encounters is not None
    return encounters


def still(count: int) -> list[Pose2D]:
    return [Pose2D(0.0, 0.0, 0.0)] * count


def test_an_obstacle_runs_a_standing_robot_over():
    """It comes from ahead at 1 m/s; its edge is 0.8 m from the outline (0.25 m ahead) at first."""
    encounters = figures(
        world_of((0.0, 1.55, 0.0), (10.0, -8.45, 0.0)), still(18), [0.0] * 18, {17}
    )
    assert (
        encounters.touched,
        encounters.hit_robot_mps,
        encounters.moving_clearance_m,
    ) == (
        "walker",
        0.0,
        0.0,
    )
    assert (encounters.hit_closing_mps, encounters.hit_robot_share) == pytest.approx(
        (1.0, 0.0)
    )
    assert encounters.near_s == pytest.approx(
        0.6
    )  # readings from 0.3 s to 0.85 s, each for the 0.05 s before it
    assert encounters.time_to_collision_s == pytest.approx(0.0)


FRAME = Pose2D(2.0, -1.0, 0.6)  # so that x and y of the map are not those of the robot
BOX = {"shape": "box", "size_x_m": 1.0, "size_y_m": 4.0, "yaw_rad": FRAME.yaw}


def in_frame(x_m: float, y_m: float) -> tuple[float, float]:
    return (FRAME @ Pose2D(x_m, y_m, 0.0)).x, (FRAME @ Pose2D(x_m, y_m, 0.0)).y


@pytest.mark.parametrize(
    (
        "first",
        "last",
        "shape",
        "speed_mps",
        "turn_radps",
        "y_m",
        "contacts",
        "closing_mps",
        "share",
    ),
    [
        ((1.55, 0.0), (1.55, 0.0), {}, 1.0, 0.0, 0.0, {16}, 1.0, 1.0),  # it stands
        (
            (1.55, 0.0),
            (-13.45, 0.0),
            {},
            0.5,
            0.0,
            0.0,
            {9, 10},
            2.0,
            0.25,
        ),  # both drive
        (
            (0.2, 0.85),
            (0.2, -9.15),
            {},
            2.0,
            0.0,
            0.0,
            {3},
            1.0,
            0.0,
        ),  # it comes from the side
        (
            (1.15, 0.0),
            (1.15, 0.0),
            BOX,
            1.0,
            0.0,
            1.0,
            {8},
            1.0,
            1.0,
        ),  # a box, at its nearest point
        ((1.15, 0.0), (1.15, 0.0), BOX, 1.0, 0.0, 2.5, {0}, 0.8, 1.0),  # its corner
        (
            (-1.15, 0.0),
            (-1.15, 0.0),
            BOX,
            -1.0,
            0.0,
            -2.5,
            {0},
            0.8,
            1.0,
        ),  # the opposite corner, backwards
        (
            (0.8, 0.1),
            (0.8, 0.1),
            {},
            1.0,
            2.0,
            0.0,
            {0, 1},
            0.8,
            1.0,
        ),  # at once, turning away
        (
            (0.2, 0.75),
            (0.2, 0.75),
            {},
            0.0,
            2.0,
            0.0,
            {1},
            0.4,
            1.0,
        ),  # turning towards it
        ((1.55, 0.0), (11.55, 0.0), {}, 2.0, 0.0, 0.0, {1}, 1.0, 1.0),  # it flees
        (
            (1.55, 0.0),
            (1.05, 0.0),
            {},
            -1.0,
            0.0,
            0.0,
            {1},
            -0.95,
            0.0,
        ),  # the robot flees
        ((1.55, 0.0), (1.55, 0.0), {}, 0.05, 0.0, 0.0, {1}, 0.05, 1.0),  # slowly
        ((1.55, 0.0), (1.55, 0.0), {}, 0.0, 0.0, 0.0, {1}, 0.0, None),  # both stand
    ],
)
def test_who_drove_towards_whom_has_the_share(
    first, last, shape, speed_mps, turn_radps, y_m, contacts, closing_mps, share
):
    poses = [
        FRAME @ Pose2D(0.05 * speed_mps * k, y_m, 0.0) for k in range(max(contacts) + 1)
    ]
    speeds = [9.0] * len(poses)
    speeds[max(min(contacts) - 1, 0)] = speed_mps
    world = world_of((0.0, *in_frame(*first)), (10.0, *in_frame(*last)), **shape)
    encounters = figures(world, poses, speeds, contacts, turn_radps=turn_radps)
    assert (encounters.touched, encounters.hit_robot_mps) == ("walker", abs(speed_mps))
    assert (encounters.hit_closing_mps, encounters.hit_robot_share) == pytest.approx(
        (closing_mps, share)
    )


def test_the_time_to_collision_is_at_current_velocities():
    world = world_of((0.0, *in_frame(1.55, 0.1)), (10.0, *in_frame(-3.45, 0.1)))
    encounters = figures(world, [FRAME], [1.5], turn_radps=0.3)
    assert (
        encounters.moving_clearance_m,
        encounters.time_to_collision_s,
    ) == pytest.approx((0.8, 0.8 / 2.0))


@pytest.mark.parametrize(
    ("standing", "ahead_m", "gap_m", "speed_mps", "touched"),
    [
        ("wall", 0.15, 0.2, 0.0, ""),
        ("wall", 0.15, 0.27, 4.0, "walker"),  # 0.07 m as they touch
        ("wall", 0.15, 0.5, 4.0, ""),  # 0.1 m only later
        ("cylinder", 0.15, 0.2, 0.0, ""),
        ("cylinder", -0.1, 0.05, 0.0, ""),
        (
            "cylinder",
            -0.2,
            -0.1,
            0.0,
            "walker",
        ),  # of two that overlap the robot the one that moves
    ],
)
def test_a_contact_is_with_what_is_nearest_at_it_or_before(
    standing, ahead_m, gap_m, speed_mps, touched
):
    side_m = gap_m - 0.3  # of the center, beside the robot
    world = world_of((0.0, 2.5, side_m), (10.0, 2.5, side_m - 10.0 * speed_mps))
    grid = world.grid.copy()
    grid[26, 18] = standing == "cylinder"  # of radius 0.25 m at (3, -1)
    walls = (
        (Wall(x_m=2.85, y_m=-1.0, size_x_m=0.2, size_y_m=0.4),)
        if standing == "wall"
        else ()
    )
    poses = [Pose2D(2.5 - ahead_m - back_m, -1.0, 0.0) for back_m in (0.1, 0.0, 0.0)]
    encounters = figures(
        replace(world, grid=grid, walls=walls), poses, [0.0] * 3, {1, 2}
    )
    assert (encounters.touched, encounters.hit_robot_mps is None) == (
        touched,
        not touched,
    )


def test_the_phase_shifts_the_obstacle():
    world = world_of((0.0, 9.0, 0.0), (10.0, 9.0, 10.0))
    assert figures(
        world, still(1), [0.0], phase_s=4.0
    ).moving_clearance_m == pytest.approx(math.hypot(8.75, 3.8) - 0.5)
    assert figures(world, still(1), [0.0]).moving_clearance_m == pytest.approx(8.25)


def test_path_and_time_of_successes_are_to_arrival():
    poses = [Pose2D(11.0 - 0.5 * k, 0.0, math.pi) for k in range(39)]
    world = world_of((0.0, 0.0, 9.0), (10.0, 0.0, 9.0))
    encounters = figures(world, poses, [0.0] * 39, traversal_s=19.0)
    assert (
        encounters.path_over_straight,
        encounters.time_over_straight,
    ) == pytest.approx((1.0, 2.0))
    failed = figures(world, poses, [0.0] * 39)
    assert (failed.path_over_straight, failed.time_over_straight) == (None, None)


def test_nothing_measured_without_readings_or_movers():
    encounters = figures(world_of((0.0, 1.0, 0.0), (10.0, 1.0, 0.0)), [], [])
    assert (
        encounters.moving_clearance_m,
        encounters.time_to_collision_s,
        encounters.near_s,
        encounters.touched,
    ) == (None, None, 0.0, "")
    quiet = replace(world_of((0.0, 1.0, 0.0), (10.0, 1.0, 0.0)), moving=())
    assert (
        measure_encounters(drive(still(2)), quiet, 0.0, EXTENT, DYNABARN, None) is None
    )
