"""Measures among moving obstacles against cases worked out by hand and plain
references.
"""

import math
from dataclasses import replace

import pytest
import yaml
from text_tables import rows_of
from trials.test_trajectory import EXTENT, drive, still

from barn_eval.trials.encounters import Encounters, measure_encounters
from barn_eval.trials.protocol import DYNABARN
from barn_worlds.base.types import Pose2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.moving.motion import Motion, MovingObstacle, Wall


def world_of(*keys, **shape):
    motion = Motion("linear", 10.0, keys)
    body = shape or {"radius_m": 0.5}
    arena = open_dataset("dynabarn60").load(0)
    far = Motion("linear", 10.0, ((0.0, 50.0, 60.0), (10.0, 50.0, 60.0)))
    distant = (
        MovingObstacle(name, motion=far, radius_m=0.5) for name in ("one", "two")
    )
    walker = MovingObstacle("walker", motion=motion, **body)
    return replace(arena, walls=(), moving=(*distant, walker))


def figures(
    world, poses, speeds, contacts=(), *, turn_radps=0.0, phase_s=0.0, traversal_s=None
):
    trajectory = drive(poses, speeds, contacts)
    trajectory.velocity[:, 1] = turn_radps
    encounters = measure_encounters(
        trajectory, world, phase_s, EXTENT, DYNABARN, traversal_s
    )
    assert encounters is not None
    return encounters


def test_an_obstacle_runs_a_standing_robot_over():
    """It comes from ahead at 1 m/s.

    Its edge is 0.8 m from the outline (0.25 m ahead) at first.
    """
    world = world_of((0.0, 1.55, 0.0), (10.0, -8.45, 0.0))
    encounters = figures(world, still(18), [0.0] * 18, {17})
    assert (encounters.touched, encounters.hit_robot_mps) == ("walker", 0.0)
    assert encounters.moving_clearance_m == 0.0
    assert encounters.hit_closing_mps == pytest.approx(1.0)
    assert encounters.hit_robot_share == pytest.approx(0.0)
    assert encounters.hit_at_rest and encounters.not_at_fault
    # readings from 0.3 s to 0.85 s, each for the 0.05 s before it
    assert encounters.near_s == pytest.approx(0.6)
    assert encounters.time_to_collision_s == pytest.approx(0.0)


CONTACTS = """
- [null, null, false, false]
- [0.049, 1.0, true, true]
- [0.05, 0.099, false, true]
- [0.05, 0.1, false, false]
- [0.5, null, false, false]
"""


@pytest.mark.parametrize(
    "speed_mps, share, at_rest, innocent", yaml.safe_load(CONTACTS)
)
def test_a_contact_is_no_fault_of_who_rests_or_hardly_approaches(
    speed_mps, share, at_rest, innocent
):
    hit = Encounters(
        0.0, 0.0, 0.0, 0.0, None, None, hit_robot_mps=speed_mps, hit_robot_share=share
    )
    assert (hit.hit_at_rest, hit.not_at_fault) == (at_rest, innocent)


FRAME = Pose2D(2.0, -1.0, 0.6)  # so that x and y of the map are not those of the robot
BOX = {"shape": "box", "size_x_m": 1.0, "size_y_m": 4.0, "yaw_rad": FRAME.yaw}


def in_frame(x_m, y_m):
    return (FRAME @ Pose2D(x_m, y_m, 0.0)).position


# Place of the obstacle at first and after 10 s, its shape, the robot's speed, turn rate
# and offset to the left, readings in contact; closing speed at it and the robot's
# share.
MEETINGS = """
1.55 0    | 1.55 0     | post | 1    | 0 | 0    | 16   | 1     | 1    | it stands
1.55 0    | -13.45 0   | post | 0.5  | 0 | 0    | 9 10 | 2     | 0.25 | both drive
0.2 0.85  | 0.2 -9.15  | post | 2    | 0 | 0    | 3    | 1     | 0    | from the side
1.15 0    | 1.15 0     | box  | 1    | 0 | 1    | 8    | 1     | 1    | nearest point
1.15 0    | 1.15 0     | box  | 1    | 0 | 2.5  | 0    | 0.8   | 1    | its corner
-1.15 0   | -1.15 0    | box  | -1   | 0 | -2.5 | 0    | 0.8   | 1    | backwards
0.8 0.1   | 0.8 0.1    | post | 1    | 2 | 0    | 0 1  | 0.8   | 1    | turning away
0.2 0.75  | 0.2 0.75   | post | 0    | 2 | 0    | 1    | 0.4   | 1    | turning to it
1.55 0    | 11.55 0    | post | 2    | 0 | 0    | 1    | 1     | 1    | it flees
1.55 0    | 1.05 0     | post | -1   | 0 | 0    | 1    | -0.95 | 0    | the robot flees
1.55 0    | 1.55 0     | post | 0.05 | 0 | 0    | 1    | 0.05  | 1    | slowly
1.55 0    | 1.55 0     | post | 0    | 0 | 0    | 1    | 0     |      | both stand
"""


def numbers(cell):
    return [float(word) for word in cell.split()]


@pytest.mark.parametrize("meeting", rows_of(MEETINGS), ids=lambda cells: cells[-1])
def test_who_drove_towards_whom_has_the_share(meeting):
    first, last, shape, *figures_of_drive, _ = meeting
    (speed_mps,), (turn_radps,), (y_m,), contacts, closing_mps, share = map(
        numbers, figures_of_drive
    )
    count = int(max(contacts)) + 1
    poses = [FRAME @ Pose2D(0.05 * speed_mps * k, y_m, 0.0) for k in range(count)]
    speeds = [9.0] * count
    speeds[max(int(min(contacts)) - 1, 0)] = speed_mps
    keys = ((0.0, *in_frame(*numbers(first))), (10.0, *in_frame(*numbers(last))))
    world = world_of(*keys, **(BOX if shape == "box" else {}))
    encounters = figures(world, poses, speeds, contacts, turn_radps=turn_radps)
    assert (encounters.touched, encounters.hit_robot_mps) == ("walker", abs(speed_mps))
    assert [encounters.hit_closing_mps] == pytest.approx(closing_mps)
    assert [encounters.hit_robot_share] == pytest.approx(share or [None])


def test_the_time_to_collision_is_at_current_velocities():
    world = world_of((0.0, *in_frame(1.55, 0.1)), (10.0, *in_frame(-3.45, 0.1)))
    encounters = figures(world, [FRAME], [1.5], turn_radps=0.3)
    assert encounters.moving_clearance_m == pytest.approx(0.8)
    assert encounters.time_to_collision_s == pytest.approx(0.8 / 2.0)


NEIGHBORS = """
- [wall, 0.15, 0.2, 0.0, ""]
- [wall, 0.15, 0.27, 4.0, walker] # 0.07 m as they touch
- [wall, 0.15, 0.5, 4.0, ""] # 0.1 m only later
- [cylinder, 0.15, 0.2, 0.0, ""]
- [cylinder, -0.1, 0.05, 0.0, ""]
# of two that overlap the robot the one that moves
- [cylinder, -0.2, -0.1, 0.0, walker]
"""


@pytest.mark.parametrize(
    "standing, ahead_m, gap_m, speed_mps, touched", yaml.safe_load(NEIGHBORS)
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
    world = replace(world, grid=grid, walls=walls)
    encounters = figures(world, poses, [0.0] * 3, {1, 2})
    assert encounters.touched == touched
    assert (encounters.hit_robot_mps is None) == (not touched)


def test_the_phase_shifts_the_obstacle():
    world = world_of((0.0, 9.0, 0.0), (10.0, 9.0, 10.0))
    unshifted = figures(world, still(1), [0.0])
    assert unshifted.moving_clearance_m == pytest.approx(8.25)
    shifted = figures(world, still(1), [0.0], phase_s=4.0)
    assert shifted.moving_clearance_m == pytest.approx(math.hypot(8.75, 3.8) - 0.5)


def test_path_and_time_of_successes_are_to_arrival():
    poses = [Pose2D(11.0 - 0.5 * k, 0.0, math.pi) for k in range(39)]
    world = world_of((0.0, 0.0, 9.0), (10.0, 0.0, 9.0))
    encounters = figures(world, poses, [0.0] * 39, traversal_s=19.0)
    assert encounters.path_over_straight == pytest.approx(1.0)
    assert encounters.time_over_straight == pytest.approx(2.0)
    failed = figures(world, poses, [0.0] * 39)
    assert (failed.path_over_straight, failed.time_over_straight) == (None, None)


def test_nothing_measured_without_readings_or_movers():
    world = world_of((0.0, 1.0, 0.0), (10.0, 1.0, 0.0))
    encounters = figures(world, [], [])
    assert encounters.moving_clearance_m is encounters.time_to_collision_s is None
    assert (encounters.near_s, encounters.touched) == (0.0, "")
    quiet = replace(world, moving=())
    nothing = measure_encounters(drive(still(2)), quiet, 0.0, EXTENT, DYNABARN, None)
    assert nothing is None
