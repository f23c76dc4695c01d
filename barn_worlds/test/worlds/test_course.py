"""Start and goal of worlds: given in files, given for a run, or chosen; refused where they cannot be driven."""

import math

import numpy as np
import pytest
from refusals import refused

from barn_worlds.base.errors import WorldError
from barn_worlds.base.types import ORIGIN, OccupancyMap, Pose2D
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.formats.map_server import write_map
from barn_worlds.formats.sdf import write_sdf
from barn_worlds.formats.world_yaml import write_world_yaml
from barn_worlds.robots.files import STANDARD_ROBOT, load_robot
from barn_worlds.worlds.course import draw_routes, fit_to_robot
from barn_worlds.worlds.cspace import configuration_space
from barn_worlds.worlds.routes import LONGEST_M
from barn_worlds.worlds.world import World

CELL_M = 0.1
CORNER_M = (-2.0, 1.0)
COURSE = (0.0, 3.0, 0.5, 1.0, 18.0)


def hall(gap_m: float = 2.0) -> np.ndarray:
    """Return a hall of 12 x 20 m, in cells, with a wall across it that leaves a gap at its right."""
    grid = np.zeros((120, 200), bool)
    grid[[0, -1]] = grid[:, [0, -1]] = True
    grid[: 120 - round(gap_m / CELL_M) - 1, 100:102] = True
    return grid


def written(tmp_path, grid, *course):
    path = tmp_path / "hall.yaml"
    cells = np.where(grid.T, 100, 0).astype(np.int8)
    write_map(OccupancyMap(cells, CELL_M, *CORNER_M), path)
    if course:
        lines = f"start: {list(course[:3])}\ngoal: {list(course[3:])}\n"
        path.write_text(path.read_text() + lines)
    return path


def opened(path, robot=STANDARD_ROBOT):
    return open_dataset(path, robot).load(0)


@pytest.fixture
def world(tmp_path):
    """The hall, opened without a course."""
    return opened(written(tmp_path, hall()))


@pytest.fixture
def driven(tmp_path):
    """The hall with a course in its file."""
    return opened(written(tmp_path, hall(), *COURSE))


def is_free(world):
    """Tell whether the robot touches nothing on the path."""
    cspace = configuration_space(world.grid, world.footprint_cells)
    return not cspace[tuple(world.path.T)].any()


def test_a_map_without_a_course_gets_far_apart_ends(tmp_path):
    grid = hall()
    grid[40:80, 20:60] = True  # in it a closed room, smaller than the hall
    grid[45:75, 25:55] = False
    world = opened(written(tmp_path, grid))
    ends = np.array([world.start.position, world.goal.position])
    assert np.allclose(world.path_m()[[0, -1]], ends)
    # A block may cut a corner of the way that is measured.
    assert 9.5 < world.path_length_m <= 1.05 * LONGEST_M
    low, high = np.array([[40, 20], [80, 60]]) * CELL_M + np.array(CORNER_M)
    assert not ((low < ends) & (ends < high)).all(axis=1).any()
    assert np.array_equal(world.grid, grid) and is_free(world)
    assert world.provenance.path_source == "chosen"
    assert opened(written(tmp_path, grid)).checksum == world.checksum


def test_a_chosen_start_looks_along_its_way(world):
    along = world.path_m()[10] - world.path_m()[0]
    assert world.start.yaw == pytest.approx(math.atan2(along[1], along[0]))


def test_a_large_map_gets_a_way_that_a_trial_has_time_for(tmp_path):
    grid = np.zeros((900, 900), bool)
    grid[450:460, 450:460] = True  # the ends are where the lidar sees something
    world = opened(written(tmp_path, grid))
    ends = [pose.position for pose in (world.start, world.goal)]
    away = np.abs(world.cylinders_m[:, None] - ends)
    assert (away.max(axis=2).min(axis=0) < 16.0).all()
    assert 9.5 < world.path_length_m <= 1.05 * LONGEST_M


def comb():
    """Return walls of 12 x 20 m, in cells, each with a gap at the other end than the next."""
    grid = hall()
    grid[:, 100:102] = False
    grid[[0, -1]] = True
    for number, column in enumerate(range(40, 180, 40)):
        grid[(20 if number % 2 else 0) : (None if number % 2 else 100), column] = True
    return grid


def test_routes_are_long_bent_narrow_and_spread(tmp_path):
    world = opened(written(tmp_path, comb()))
    routes = draw_routes(world, STANDARD_ROBOT, 12)
    assert all(9.5 < route.path_length_m <= 1.05 * LONGEST_M for route in routes)
    straight_m = [route.start.distance(route.goal) for route in routes]
    ratios = [
        route.path_length_m / length
        for route, length in zip(routes, straight_m, strict=True)
    ]
    assert np.mean(ratios) > 1.4
    starts = np.array([route.start.position for route in routes])
    assert (np.ptp(starts, axis=0) > [5.0, 8.0]).all()
    assert len({route.checksum for route in routes}) == 12
    assert all(map(is_free, routes))


def test_routes_follow_from_their_seed(world):
    def checksums(seed):
        routes = draw_routes(world, STANDARD_ROBOT, 3, seed)
        return [route.checksum for route in routes]

    assert checksums(4) == checksums(4) != checksums(5)


def test_more_routes_than_a_map_has_are_refused(tmp_path):
    grid = np.ones((9, 40), bool)
    grid[4, 2:-2] = False
    corridor = opened(written(tmp_path, np.kron(grid, np.ones((7, 1), bool))))
    with refused("finds [0-9]+ routes of 400", WorldError):
        draw_routes(corridor, STANDARD_ROBOT, 400)


def test_start_and_goal_come_from_the_file_of_the_map(driven):
    assert driven.start == Pose2D(0.0, 3.0, 0.5)
    assert driven.goal.position == (1.0, 18.0)
    assert driven.goal.yaw == pytest.approx(math.atan2(15.0, 1.0))
    path_m = driven.path_m()
    off_m = path_m[[0, -1]] - [[0.0, 3.0], [1.0, 18.0]]
    assert np.abs(off_m).max() <= CELL_M / 2 + 1e-9
    at_the_wall = np.abs(path_m[:, 1] - 11.1).argmin()
    assert path_m[at_the_wall, 0] > 8.0  # through the gap


def test_start_and_goal_stay_with_a_world_in_every_format(driven, tmp_path):
    write_dataset_file(tmp_path / "set.npz", "set", {0: driven})
    write_world_yaml(driven, tmp_path / "world_0.world.yaml")
    course = driven.course_numbers
    write_map(driven.occupancy_map(), tmp_path / "again_0.yaml", course=course)
    for name in ("set.npz", "world_0.world.yaml", "again_0.yaml"):
        copy = opened(tmp_path / name)
        assert copy.checksum == driven.checksum
        assert (copy.start, copy.goal) == (driven.start, driven.goal)


@pytest.mark.parametrize("flavour", ["classic", "gz"])
def test_start_and_goal_of_a_gazebo_world_are_frames_of_it(tmp_path, flavour):
    world = open_dataset("barn300").load(0)
    course = (-2.25, 3.0, 1.5, *np.round(world.path_m()[-4], 6).tolist(), 1.0)
    world = fit_to_robot(world, STANDARD_ROBOT, course)
    write_sdf(world, tmp_path / "w_0.world", flavour)
    assert opened(tmp_path / "w_0.world").course_numbers == course
    wide_hall = np.kron(hall(), np.ones((3, 3), bool))[:, ::3]
    copy = opened(written(tmp_path, wide_hall, *COURSE, 0.0))
    write_sdf(copy, tmp_path / "h_0.world", flavour)
    again = opened(tmp_path / "h_0.world")
    assert np.array_equal(again.grid, copy.grid)
    assert np.allclose(again.bounds_m, copy.bounds_m)
    assert np.allclose(again.course_numbers, copy.course_numbers)
    text = (tmp_path / "w_0.world").read_text()
    half = text.replace('frame name="goal"', 'frame name="other"')
    (tmp_path / "half_0.world").write_text(half)
    with refused("both frames start and goal, or neither", WorldError):
        opened(tmp_path / "half_0.world")


def test_a_larger_robot_gets_ends_and_a_way_of_its_own(world, tmp_path):
    husky = load_robot("husky")
    driven = fit_to_robot(world, husky)
    assert driven.footprint_cells == husky.footprint_cells(CELL_M)
    assert driven.footprint_cells > world.footprint_cells
    assert is_free(driven)
    assert driven.checksum == opened(tmp_path / "hall.yaml", husky).checksum
    assert fit_to_robot(world, STANDARD_ROBOT) is world


def test_benchmark_worlds_have_no_start_of_their_own():
    world = open_dataset("barn300").load(0)
    assert world.start is None
    assert fit_to_robot(world, load_robot("husky")) is world


def test_a_course_is_put_in_place_of_a_worlds_own(driven):
    other = fit_to_robot(driven, STANDARD_ROBOT, (2.0, 3.0, 1.0, 5.0, 8.0))
    assert other.start == Pose2D(2.0, 3.0, 1.0)
    assert other.goal.position == (5.0, 8.0)
    assert other.path_length_m < driven.path_length_m
    assert other.checksum != driven.checksum


@pytest.mark.parametrize(
    "gap_m, course, message",
    [
        (
            2.0,
            (0.0, 11.05, 0.0, 1.0, 18.0),
            r"start \(0, 11.05\) is blocked: robot jackal would touch",
        ),
        (
            2.0,
            (0.0, 10.8, 1.57, 1.0, 18.0),
            r"start \(0, 10.8\) is blocked",
        ),  # its front, not its middle
        (2.0, (0.0, 3.0, 0.0, 1.0, 11.3), r"goal \(1, 11.3\) is blocked"),
        (
            2.0,
            (0.0, 3.0, 0.0, 30.0, 18.0),
            r"goal \(30, 18\) is off the map, .* from \(-2, 1\) to \(10, 21\) m",
        ),
        (
            0.4,
            (0.0, 3.0, 0.0, 1.0, 18.0),
            r"goal \(1, 18\) cannot be reached from start \(0, 3\) by robot jackal",
        ),
        (
            2.0,
            (0.0, 3.0, math.nan, 1.0, 18.0),
            "course must be x, y, yaw of the start and x, y",
        ),
        (2.0, (0.0, 3.0, 1.0, 18.0), "course must be x, y, yaw of the start and x, y"),
        (2.0, (0.0, 3.0, 90.0, 1.0, 18.0), "must have yaws of at most 6.28 rad"),
    ],
)
def test_a_course_that_cannot_be_driven_is_refused_in_one_line(
    tmp_path, gap_m, course, message
):
    world = opened(written(tmp_path, hall(gap_m)))
    with refused(message, WorldError):
        fit_to_robot(world, STANDARD_ROBOT, course)


def test_a_start_beside_a_wall_may_be_nearer_to_it_than_the_way(world):
    driven = fit_to_robot(world, STANDARD_ROBOT, (0.0, 10.75, 0.0, 5.0, 5.0))
    cspace = configuration_space(world.grid, world.footprint_cells)
    assert cspace[tuple(driven.path[0])]


@pytest.mark.parametrize(
    "grid, message",
    [
        (
            np.tile(np.arange(60) % 4 == 0, (60, 1)),
            r"robot jackal, 7 x 7 cells, finds no path",
        ),
        (np.ones((20, 20), bool), "no cell is free"),
    ],
    ids=["narrow", "full"],
)
def test_a_map_without_room_for_the_robot_is_refused(tmp_path, grid, message):
    with refused(f"hall: {message}", WorldError):
        opened(written(tmp_path, grid))


def test_start_without_goal_is_refused(tmp_path):
    path = written(tmp_path, hall())
    path.write_text(path.read_text() + "start: [0, 3, 0]\n")
    with refused("goal must be set, too", WorldError):
        opened(path)
    start = ORIGIN
    with refused("give both start and goal, or neither", WorldError):
        World("w", np.zeros((3, 3), bool), np.zeros((1, 2), int), start=start)


def test_maps_of_moving_ai_have_their_first_row_on_top(tmp_path):
    path = tmp_path / "arena.map"
    wall = "@" * 14
    free = "@" + "." * 12 + "@"
    rows = [wall, free, free, "@TTTTTTTTTT..@", free, wall]
    path.write_text("type octile\nheight 6\nwidth 14\nmap\n" + "\n".join(rows) + "\n")
    world = opened(path)
    assert world.resolution_m == 1.0
    is_filled = np.array([[letter != "." for letter in row] for row in rows])
    assert np.array_equal(world.grid.T[::-1], is_filled)
    assert world.path_length_m > 12.0


@pytest.mark.parametrize(
    "text, message",
    [
        (
            "type tile\nheight 1\nwidth 1\nmap\n.\n",
            "must begin with the lines type octile, height N, width N and map",
        ),
        (
            "type octile\nheight 9999\nwidth 1\nmap\n.\n",
            "sides must be 1 to 2000 cells, got 1 x 9999",
        ),
        (
            "type octile\nheight 2\nwidth 2\nmap\n..\n",
            "must have 2 lines of 2 letters out of .*, got 1 lines",
        ),
        (
            "type octile\nheight 2\nwidth 2\nmap\n..\n.x\n",
            "must have 2 lines of 2 .*, got line 6",
        ),
    ],
)
def test_malformed_maps_of_moving_ai_are_refused(tmp_path, text, message):
    (tmp_path / "bad.map").write_text(text)
    with refused(message, WorldError):
        opened(tmp_path / "bad.map")
