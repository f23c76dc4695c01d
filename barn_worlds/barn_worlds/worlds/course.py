"""Start and goal of a world: given ones checked for a robot, or far-apart ones chosen, and the way between them."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit

from barn_worlds.base.arrays import BoolGrid, Cells, Integers
from barn_worlds.base.errors import WorldError
from barn_worlds.base.types import Pose2D
from barn_worlds.geometry.polygon import Corner
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.cspace import configuration_space, label_regions
from barn_worlds.worlds.path_planner import plan_path
from barn_worlds.worlds.world import Provenance, World

Course = tuple[Pose2D, Pose2D]  # start and goal
LONGEST_AUTOMATIC_M = (
    25.0  # of a way that is chosen: 50 s at 0.5 m/s, half the challenge's limit
)
_SEEN_M = 15.0  # how near an obstacle should be to ends that are chosen: half a usual lidar's range
_AHEAD_M = 1.0  # along the way, where a start that is chosen looks
AUTOMATIC_COURSE = "chosen"  # a world's path_source, where its start and goal are


def parse_course(numbers: Sequence[float], where: str) -> Course:
    """Return start and goal of the numbers x, y, yaw of the start and x, y (, yaw) of the goal; WorldError if not."""
    if len(numbers) not in (5, 6) or not all(
        math.isfinite(number) for number in numbers
    ):
        raise WorldError(
            f"{where} must be x, y, yaw of the start and x, y (, yaw) of the goal, got {list(numbers)}"
        )
    x, y, yaw, u, v = map(float, numbers[:5])
    heading = float(numbers[5]) if len(numbers) == 6 else math.atan2(v - y, u - x)
    return Pose2D(x, y, yaw), Pose2D(u, v, heading)


def build_world(
    name: str,
    grid: BoolGrid,
    cell_m: float,
    corner_m: Corner,
    robot: Robot,
    about: Provenance,
    ends: Course | None = None,
) -> World:
    """Return a world of any shape, its grid's outer corner at a place of the map frame; WorldError without a way.

    ends: its start and goal; None: they are chosen for the robot.
    """
    anywhere = np.argwhere(~grid)[:1]
    if not len(anywhere):
        raise WorldError(f"{name}: no cell of it is free")
    about = replace(about, path_source="planned" if ends else AUTOMATIC_COURSE)
    world = World(
        name,
        grid,
        anywhere,
        cell_m,
        robot.footprint_cells(cell_m),
        about,
        corner_m=corner_m,
    )
    return plan_course(world, robot, ends)


def fit_to_robot(world: World, robot: Robot, course: Sequence[float] = ()) -> World:
    """Return a world as a robot drives it: from start to goal of a course, its own, or those chosen for this robot.

    A world without a course of its own stays as it is; its protocol says where to start. course: numbers for
    `parse_course`. WorldError where start or goal is blocked or no way leads from one to the other.
    """
    if course:
        return plan_course(world, robot, parse_course(course, "course"))
    if world.start is None or world.goal is None:
        return world
    same = robot.footprint_cells(world.resolution_m) == world.footprint_cells
    if world.provenance.path_source == AUTOMATIC_COURSE:
        return world if same else plan_course(world, robot)
    _require_free(world, robot, world.start, world.goal)
    return world if same else plan_course(world, robot, (world.start, world.goal))


def plan_course(world: World, robot: Robot, ends: Course | None = None) -> World:
    """Return a world with start, goal and the way between them as its path; ends: None to choose them."""
    cells = robot.footprint_cells(world.resolution_m)
    occupied = world.occupied
    cspace = configuration_space(occupied, cells)
    if ends is None:
        path = _chosen(
            cspace,
            world.resolution_m,
            f"{world.name}: robot {robot.name}, {cells} x {cells} cells,",
        )
        points = world.cell_centers_m(
            path[[0, min(len(path) - 1, round(_AHEAD_M / world.resolution_m)), -2, -1]]
        )
        (x, y), (u, v), before, (p, q) = points.tolist()
        start = Pose2D(x, y, math.atan2(v - y, u - x))
        goal = Pose2D(p, q, math.atan2(q - before[1], p - before[0]))
    else:
        _require_free(world, robot, *ends)
        path, (start, goal) = _between(world, occupied, cspace, robot, ends), ends
    about = replace(
        world.provenance, path_source="planned" if ends else AUTOMATIC_COURSE
    )
    return replace(
        world,
        path=path,
        footprint_cells=cells,
        provenance=about,
        start=start,
        goal=goal,
    )


def _require_free(world: World, robot: Robot, start: Pose2D, goal: Pose2D) -> None:
    """Raise WorldError where an end is off the map, or the robot touches something there; of a goal, at any heading."""
    left, below, right, above = world.bounds_m
    for what, pose in (("start", start), ("goal", goal)):
        at = f"{world.name}: {what} ({pose.x:g}, {pose.y:g})"
        if not (left <= pose.x < right and below <= pose.y < above):
            reach = f"({left:g}, {below:g}) to ({right:g}, {above:g}) m"
            raise WorldError(f"{at} is off the map, which reaches from {reach}")
        x, y = pose.inverse().transform(world.cylinders_m).T
        body, radius_m = contact_footprint(robot.chassis), world.cylinder_radius_m
        gaps = (
            body.distances(x, y)
            if pose is start
            else np.hypot(x, y) - robot.chassis.inscribed_m
        )
        row, column = world.containing_cells(np.array([[pose.x, pose.y]]))[0]
        if (column >= 0 and world.occupied[row, column]) or gaps.min(
            initial=np.inf
        ) <= radius_m:
            raise WorldError(
                f"{at} is blocked: robot {robot.name} would touch an obstacle there"
            )


def _between(
    world: World, occupied: BoolGrid, cspace: BoolGrid, robot: Robot, ends: Course
) -> Cells:
    """Return the cells of a way (n, 2); the robot may stand nearer to obstacles at its ends than on the way."""
    points = np.array([(pose.x, pose.y) for pose in ends])
    inside = np.clip(world.containing_cells(points), 0, np.array(world.grid.shape) - 1)
    reach, open_cspace = (world.footprint_cells + 1) // 2, cspace.copy()
    for row, column in inside:
        near = (
            slice(max(0, row - reach), row + reach + 1),
            slice(max(0, column - reach), column + reach + 1),
        )
        open_cspace[near] = occupied[near]
    first, last = inside.tolist()
    path = plan_path(open_cspace, (first[0], first[1]), (last[0], last[1]))
    if path is None:
        (x, y), (u, v) = points.tolist()
        side = robot.footprint_cells(world.resolution_m) * world.resolution_m
        by = f"by robot {robot.name}, which takes {side:g} x {side:g} m"
        raise WorldError(
            f"{world.name}: goal ({u:g}, {v:g}) cannot be reached from start ({x:g}, {y:g}) {by}"
        )
    return path


def _chosen(cspace: BoolGrid, cell_m: float, where: str) -> Cells:
    """Return a way (n, 2) between two cells far apart in the largest free region, at most 25 m along the way.

    Ends are where there is room to all sides and the lidar sees something, if there is such a place; the same map gives
    the same ends.
    """
    roomy, seen = (
        configuration_space(cspace, 2 * round(reach_m / cell_m) + 1)
        for reach_m in (0.25, _SEEN_M)
    )
    for blocked in (roomy | ~seen, roomy, cspace):
        labels, sizes = label_regions(~blocked)
        if len(sizes) < 2:
            continue
        region = labels == 1 + int(np.argmax(sizes[1:]))
        seed = np.argwhere(region)[0]
        first = _farthest(region, seed, np.inf)
        last = _farthest(region, first, LONGEST_AUTOMATIC_M / cell_m)
        path = plan_path(
            cspace, (int(first[0]), int(first[1])), (int(last[0]), int(last[1]))
        )
        if path is not None and len(path) > 1:
            return path
    raise WorldError(f"{where} finds no way in it")


@njit(cache=True)
def _farthest(free: BoolGrid, start: Integers, most: float) -> Cells:
    """Return the free cell (2,) that is farthest along 4-connected ways, of those at most so many cells away."""
    rows, cols = free.shape
    distance = np.full((rows, cols), -1, np.int64)
    queue = np.empty((rows * cols, 2), np.int64)
    queue[0], distance[start[0], start[1]] = start, 0
    head, tail, found = 0, 1, np.array([start[0], start[1]])
    while head < tail:
        row, column = queue[head]
        head += 1
        if distance[row, column] > most:
            break
        found[0], found[1] = row, column
        for down, right in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            r, c = row + down, column + right
            if 0 <= r < rows and 0 <= c < cols and free[r, c] and distance[r, c] < 0:
                distance[r, c] = distance[row, column] + 1
                queue[tail, 0], queue[tail, 1] = r, c
                tail += 1
    return found
