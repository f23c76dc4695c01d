"""Reads one world from one file.

The file is a .npy grid, a Gazebo world, a map of map_server or MovingAI, or the suite's
YAML.
"""

import re
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Cells
from barn_worlds.base.errors import WorldError
from barn_worlds.formats import map_server, moving_ai, world_yaml
from barn_worlds.formats.gazebo import GazeboFile
from barn_worlds.formats.npz import read_npy
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.cells import STANDARD_CELL_M
from barn_worlds.worlds.course import Course, build_world, parse_course, plan_course
from barn_worlds.worlds.cspace import configuration_space
from barn_worlds.worlds.path_planner import plan_through
from barn_worlds.worlds.world import Provenance, World, validate_grid

GAZEBO_ENDINGS = (".world", ".world.gz", ".sdf", ".sdf.gz")
MAP_ENDINGS = (".yaml", ".yml")
ENDINGS = (*GAZEBO_ENDINGS, world_yaml.ENDING, *MAP_ENDINGS, moving_ai.ENDING, ".npy")
_FOLDERS = ("grid_files", "world_files", "map_files")


def ending(path: Path) -> str:
    """Return the longest of `ENDINGS` of a file name, such as .world.gz, or ""."""
    name = path.name.lower()
    # .world.yaml also ends in .yaml.
    matches = [candidate for candidate in ENDINGS if name.endswith(candidate)]
    return max(matches, key=len, default="")


def require_ending(path: Path) -> str:
    """Return the longest of `ENDINGS` that a file name has; WorldError if none."""
    kind = ending(path)
    if not kind:
        raise WorldError(
            f"{path}: a world's file name must end in one of {', '.join(ENDINGS)}; "
            "routes belong into the YAML file of a map: routes: FILE"
        )
    return kind


def number_in(path: Path) -> int | None:
    """Return the last number in a file name, None if absent or above 9 digits."""
    # Longer numbers are dates and the like.
    numbers = re.findall(r"\d+", path.name[: -len(ending(path))])
    return int(numbers[-1]) if numbers and len(numbers[-1]) <= 9 else None


def read_world(path: Path, robot: Robot, route: str = "") -> World:
    """Read the world in a file, with its own path, that in path_N.npy or a planned one.

    The path comes from path_N.npy in the same folder or in its sibling path_files,
    where N is the number in the name of the file. Otherwise it is planned for a robot.
    A .npy grid has cells of 0.15 m.

    A .world.yaml has its own name and path. A map that does not show a BARN world with
    its containment becomes a world at its own position. Start and goal come from its
    .yaml file, else they are chosen for the robot. Start and goal of a Gazebo world are
    its frames `start` and `goal`, if it has any.

    Args:
        path: File with one of `ENDINGS`.
        robot: Robot that paths, starts and goals are for.
        route: Name of one of a map's `routes`, whose start and goal are used.

    Raises:
        WorldError: If the file does not hold a world.
    """
    kind = require_ending(path)
    name = path.name[: -len(kind)]
    if kind == world_yaml.ENDING:
        return world_yaml.read_world_yaml(path)
    if kind in GAZEBO_ENDINGS:
        return _read_gazebo(path, robot, name)
    if kind in MAP_ENDINGS:
        return _read_map(path, robot, name, route)
    if kind == moving_ai.ENDING:
        return build_world(
            name,
            moving_ai.read_grid(path),
            moving_ai.CELL_M,
            (0.0, 0.0),
            robot,
            Provenance("map", str(path)),
        )
    grid = validate_grid(read_npy(path), str(path))
    return _build_beside(path, grid, STANDARD_CELL_M, robot, name, "npy")


def build_grid_world(
    name: str,
    grid: BoolGrid,
    resolution_m: float,
    footprint_cells: int,
    source: str,
    path: Path,
    path_file: Path | None,
) -> World:
    """Build a BARN world from a grid; plan its path if `path_file` is None.

    Args:
        name: Name of the world.
        grid: (rows, cols), True where filled.
        resolution_m: Size of a cell.
        footprint_cells: Side of the footprint of the robot, odd.
        source: Kind of source, as in `Provenance`.
        path: File that the grid is from.
        path_file: .npy file with the path of the world. If None, a path is planned.

    Raises:
        WorldError: If there is no path.
    """
    if path_file is None:
        cells = plan_grid_path(grid, footprint_cells, str(path))
        path_source = "planned"
    else:
        cells = read_npy(path_file)
        path_source = "given"
    provenance = Provenance(source, str(path), path_source=path_source)
    return World(name, grid, cells, resolution_m, footprint_cells, provenance)


def plan_grid_path(grid: BoolGrid, footprint_cells: int, where: str) -> Cells:
    """Plan path cells (n, 2) from the first to the last column; WorldError if none.

    Args:
        grid: (rows, cols), True where filled.
        footprint_cells: Side of the footprint of the robot, odd.
        where: Name or file of the world, to begin an error message with.

    Raises:
        WorldError: If there is no path.
    """
    path = plan_through(configuration_space(grid, footprint_cells))
    if path is None:
        raise WorldError(
            f"{where}: no path from the first to the last column for "
            f"a robot of {footprint_cells} x {footprint_cells} cells"
        )
    return path


def _read_gazebo(path: Path, robot: Robot, name: str) -> World:
    """Read the world in a Gazebo file; without a course it must be a BARN world."""
    file = GazeboFile.read(path)
    numbers = file.course()
    course = parse_course(numbers, str(path)) if numbers else None
    # Without a course, cylinders must stand as in the worlds of BARN.
    open_grid = file.open_grid(numbers[:2]) if numbers else None
    if open_grid is not None:
        provenance = Provenance("world_file", str(path))
        return build_world(name, *open_grid, robot, provenance, course)

    grid, resolution_m = file.grid()
    return _build_beside(path, grid, resolution_m, robot, name, "world_file", course)


def _read_map(path: Path, robot: Robot, name: str, route: str) -> World:
    """Read a map_server map as the BARN world that it shows, else as its own world."""
    map_file = map_server.read_map_file(path)
    occupancy = map_server.read_map(path, map_file)
    course = None
    numbers = (*map_file.start, *map_file.goal)
    if route:
        ends = map_file.routes[route]
        numbers = (*ends.start, *ends.goal)
        name = f"{name} route {route}"
    if numbers:
        course = parse_course(numbers, f"{path}: start and goal")

    resolution_m = occupancy.resolution
    grid = map_server.extract_grid(occupancy)
    if grid is None:
        is_filled = np.ascontiguousarray(map_server.filled_cells(occupancy).T)
        return build_world(
            name,
            validate_grid(is_filled, str(path)),
            resolution_m,
            occupancy.origin,
            robot,
            Provenance("map", str(path)),
            course,
        )
    grid = validate_grid(grid, str(path))
    return _build_beside(path, grid, resolution_m, robot, name, "map", course)


def _build_beside(
    path: Path,
    grid: BoolGrid,
    resolution_m: float,
    robot: Robot,
    name: str,
    source: str,
    course: Course | None = None,
) -> World:
    """Build a grid's world with a course, the path in path_N.npy, or a planned one."""
    # A path beside the file comes before one in the sibling folder.
    folders = [path.parent]
    if path.parent.name in _FOLDERS:
        folders.append(path.parent.parent / "path_files")
    path_file = None
    for folder in folders:
        file = folder / f"path_{number_in(path)}.npy"
        # The grid itself may be called path_N.npy.
        if file != path and file.is_file():
            path_file = file
            break
    footprint_cells = robot.footprint_cells(resolution_m)
    world = build_grid_world(
        name, grid, resolution_m, footprint_cells, source, path, path_file
    )
    return world if course is None else plan_course(world, robot, course)
