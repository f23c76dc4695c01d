"""Start and goal of a world, and the path between them.

Given ones are checked for a robot. If a world has none, they are chosen far apart.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Cells
from barn_worlds.base.errors import WorldError
from barn_worlds.base.types import Pose2D
from barn_worlds.geometry.polygon import Corner
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.cells import STANDARD_CELL_M
from barn_worlds.worlds.cspace import configuration_space, label_regions
from barn_worlds.worlds.path_planner import plan_path
from barn_worlds.worlds.routes import draw_ends
from barn_worlds.worlds.world import Provenance, World

# Start and goal.
Course = tuple[Pose2D, Pose2D]

# A world's `path_source` where start and goal were chosen.
AUTOMATIC_COURSE = "chosen"
# Chosen ends keep this distance from obstacles, and lie within the other one of an
# obstacle: half the range of a usual lidar.
_SPACE_M = 0.25
_VISIBLE_M = 15.0
# A robot at a chosen start faces the point of the path this far ahead.
_AHEAD_M = 1.0


def parse_course(numbers: Sequence[float], where: str) -> Course:
    """Return start and goal poses (m, rad) from 5 or 6 numbers; WorldError for others.

    Args:
        numbers: x, y and yaw of the start, x, y and perhaps yaw of the goal. Without a
            yaw the goal faces away from the start.
        where: Beginning of the error message, such as the name of a file.

    Raises:
        WorldError: If these are not five or six finite numbers, or a yaw is in degrees.
    """
    if len(numbers) not in (5, 6) or not all(map(math.isfinite, numbers)):
        raise WorldError(
            f"{where} must be x, y, yaw of the start and x, y (, yaw) of the goal, "
            f"got {list(numbers)}"
        )
    if any(abs(yaw) > math.tau for yaw in numbers[2::3]):
        raise WorldError(
            f"{where} must have yaws of at most 6.28 rad, got {list(numbers)}"
        )

    x, y, yaw, goal_x, goal_y, *goal_yaw = map(float, numbers)
    # Away from the start, so that the robot need not turn when it arrives.
    heading = goal_yaw[0] if goal_yaw else math.atan2(goal_y - y, goal_x - x)
    return Pose2D(x, y, yaw), Pose2D(goal_x, goal_y, heading)


def build_world(
    name: str,
    grid: BoolGrid,
    cell_m: float,
    corner_m: Corner,
    robot: Robot,
    provenance: Provenance,
    course: Course | None = None,
) -> World:
    """Return a world without containment, its path planned; ends are chosen if None.

    Args:
        name: Name of the world.
        grid: (rows, cols), True where filled.
        cell_m: Size of a cell.
        corner_m: Outer corner of cell (0, 0) in the map frame.
        robot: Robot that the path is for.
        provenance: Where the grid comes from.
        course: Start and goal. By default they are chosen for the robot.

    Raises:
        WorldError: If start or goal is blocked, or no path connects them.
    """
    # A world needs a path: any free cell will do until the course is planned.
    free_cell = np.argwhere(~grid)[:1]
    if not len(free_cell):
        raise WorldError(f"{name}: no cell is free")

    world = World(
        name,
        grid,
        free_cell,
        cell_m,
        robot.footprint_cells(cell_m),
        provenance,
        corner_m=corner_m,
    )
    return plan_course(world, robot, course)


def fit_to_robot(world: World, robot: Robot, course: Sequence[float] = ()) -> World:
    """Return a world with a path for a robot; itself if it has no ends and no course.

    A world without start and goal stays as it is: its protocol says where to start.
    Given ends are kept, and chosen ones chosen anew for a robot of another size.

    Args:
        world: With start and goal of its own or without.
        robot: Its footprint decides which paths fit.
        course: Other start and goal, as numbers for `parse_course`.

    Raises:
        WorldError: If start or goal is blocked, or no path connects them.
    """
    if course:
        return plan_course(world, robot, parse_course(course, "course"))
    if world.start is None or world.goal is None:
        return world

    # Robots of as many cells share paths.
    fits = robot.footprint_cells(world.resolution_m) == world.footprint_cells
    if world.provenance.path_source == AUTOMATIC_COURSE:
        return world if fits else plan_course(world, robot)
    if not fits:
        return plan_course(world, robot, (world.start, world.goal))
    _require_free(world, robot, world.start, world.goal)
    return world


def cell_size_m(robot: Robot) -> float:
    """Return the cell size in m, in whole millimeters, of worlds made for a robot.

    It is the Jackal's 0.15 m scaled to the robot. The robot then takes 5 x 5 cells like
    the Jackal, and passages are as wide for it.
    """
    # Rounded up to whole millimeters, so that the robot still takes 5 x 5 cells.
    scale = 1000.0 * STANDARD_CELL_M * robot.reach_m
    return math.ceil(scale / STANDARD_ROBOT.reach_m - 1e-6) / 1000.0


def scale_to_robot(world: World, robot: Robot) -> World:
    """Return a world with a robot's cell size if its path is too narrow, else itself.

    The world itself is returned for other robots, and if it has a scene in meters.

    Args:
        world: World with the containment of BARN.
        robot: Robot that is to drive there.
    """
    path_width_m = world.footprint_cells * world.resolution_m
    fits = min(robot.length_m, robot.width_m) <= path_width_m
    if fits or world.corner_m is not None or world.moving or world.walls:
        return world
    return replace(world, resolution_m=cell_size_m(robot))


def plan_course(world: World, robot: Robot, course: Course | None = None) -> World:
    """Return a copy with start, goal and path for a robot; ends are chosen if None.

    Args:
        world: The world; its own path is replaced.
        robot: Robot that the path is for.
        course: Start and goal. By default they are chosen.

    Raises:
        WorldError: If start or goal is blocked, or no path connects them.
    """
    source = "planned"
    if course is None:
        (path,) = _choose_paths(world, robot, 1, 0)
        course = _end_poses(path, world)
        source = AUTOMATIC_COURSE
    else:
        _require_free(world, robot, *course)
        path = _plan_between(world, robot, *course)
    provenance = replace(world.provenance, path_source=source)
    return _with_course(world, robot, path, provenance, course)


def draw_routes(world: World, robot: Robot, count: int, seed: int = 0) -> list[World]:
    """Return copies of a world with a route each; WorldError if fewer than `count`.

    Routes are long, lead round corners and past narrow places where the map has some,
    and spread over it.

    Args:
        world: The world; its own course and path are replaced.
        robot: Robot that the routes are for.
        count: Number of routes.
        seed: Another seed draws other routes.

    Raises:
        WorldError: If the world has not as many routes.
    """
    # A data set file does not keep where its worlds were read from.
    parameters = {"map": world.provenance.path, "routes": count, "seed": seed}
    provenance = replace(world.provenance, parameters=parameters, path_source="planned")
    return [
        _with_course(world, robot, path, provenance, _end_poses(path, world))
        for path in _choose_paths(world, robot, count, seed)
    ]


def _with_course(
    world: World, robot: Robot, path: Cells, provenance: Provenance, course: Course
) -> World:
    """Return a copy of a world with a path for a robot, its origin, start and goal."""
    start, goal = course
    return replace(
        world,
        path=path,
        footprint_cells=robot.footprint_cells(world.resolution_m),
        provenance=provenance,
        start=start,
        goal=goal,
    )


def _configuration_space(world: World, robot: Robot) -> BoolGrid:
    """Return the C-space (rows, cols) of a world, its walls included, for a robot."""
    footprint_cells = robot.footprint_cells(world.resolution_m)
    return configuration_space(world.occupied, footprint_cells)


def _end_poses(path: Cells, world: World) -> Course:
    """Return start and goal poses at the two ends of a path, both facing along it."""
    ahead = min(len(path) - 1, round(_AHEAD_M / world.resolution_m))
    points = world.cell_centers_m(path[[0, ahead, -2, -1]])
    first, later, last_but_one, last = points.tolist()
    start_yaw = math.atan2(later[1] - first[1], later[0] - first[0])
    goal_yaw = math.atan2(last[1] - last_but_one[1], last[0] - last_but_one[0])
    start = Pose2D(first[0], first[1], start_yaw)
    return start, Pose2D(last[0], last[1], goal_yaw)


def _require_free(world: World, robot: Robot, start: Pose2D, goal: Pose2D) -> None:
    """Raise WorldError if start or goal is off the map or too close to an obstacle."""
    left, below, right, above = world.bounds_m
    for end, pose in (("start", start), ("goal", goal)):
        where = f"{world.name}: {end} ({pose.x:g}, {pose.y:g})"
        if not (left <= pose.x < right and below <= pose.y < above):
            raise WorldError(
                f"{where} is off the map, which reaches from "
                f"({left:g}, {below:g}) to ({right:g}, {above:g}) m"
            )

        x, y = pose.inverse().transform(world.cylinders_m).T
        if pose is start:
            distances_m = contact_footprint(robot.chassis).distances(x, y)
        else:
            # A robot may arrive at the goal at any heading.
            distances_m = np.hypot(x, y) - robot.chassis.inscribed_m
        touches = distances_m.min(initial=np.inf) <= world.cylinder_radius_m
        position = np.array([pose.position])
        ((row, column),) = world.containing_cells(position)
        if touches or (column >= 0 and world.occupied[row, column]):
            raise WorldError(
                f"{where} is blocked: robot {robot.name} would touch an obstacle there"
            )


def _plan_between(world: World, robot: Robot, start: Pose2D, goal: Pose2D) -> Cells:
    """Return path cells (n, 2) from start to goal; WorldError if there is no path."""
    points = np.array([start.position, goal.position])
    ends = np.clip(world.containing_cells(points), 0, np.array(world.grid.shape) - 1)

    # The robot may stand closer to obstacles at the ends than along the path, so around
    # them only filled cells block it.
    reach = (world.footprint_cells + 1) // 2
    cspace = _configuration_space(world, robot)
    for row, column in ends:
        around = (
            slice(max(0, row - reach), row + reach + 1),
            slice(max(0, column - reach), column + reach + 1),
        )
        cspace[around] = world.occupied[around]

    path = plan_path(cspace, *ends)
    if path is None:
        side_m = robot.footprint_cells(world.resolution_m) * world.resolution_m
        raise WorldError(
            f"{world.name}: goal ({goal.x:g}, {goal.y:g}) cannot be reached from start "
            f"({start.x:g}, {start.y:g}) by robot {robot.name}, "
            f"which takes {side_m:g} x {side_m:g} m"
        )
    return path


def _choose_paths(world: World, robot: Robot, count: int, seed: int) -> list[Cells]:
    """Return path cells of `count` routes in the largest free region, else WorldError.

    The ends have space to all sides and an obstacle in sight of the lidar, if there are
    such places. The same map and seed give the same routes.
    """
    cell_m = world.resolution_m
    footprint_cells = robot.footprint_cells(cell_m)
    cspace = _configuration_space(world, robot)
    near, visible = (
        configuration_space(cspace, 2 * round(reach_m / cell_m) + 1)
        for reach_m in (_SPACE_M, _VISIBLE_M)
    )
    labels, sizes = label_regions(~cspace)
    # Label 0 is what is blocked.
    region = labels == 1 + np.argmax(sizes[1:]) if len(sizes) > 1 else ~cspace
    paths: list[Cells] = []
    for blocked in (near | ~visible, near, cspace):
        paths = []
        ends = draw_ends(
            region,
            region & ~blocked,
            region & near,
            cell_m,
            max(1, footprint_cells // 3),
            count,
            seed,
        )
        for first, last in ends:
            path = plan_path(cspace, first, last)
            if path is not None and len(path) > 1:
                paths.append(path)
            if len(paths) == count:
                return paths

    finds = f"{len(paths)} routes of {count}" if paths else "no path"
    raise WorldError(
        f"{world.name}: robot {robot.name}, {footprint_cells} x {footprint_cells} "
        f"cells, finds {finds}"
    )
