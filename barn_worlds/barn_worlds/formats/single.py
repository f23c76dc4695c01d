"""One world from one file: .npy grid, Gazebo world, map of map_server or MovingAI, or the suite's own YAML."""

import re
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Cells
from barn_worlds.base.errors import WorldError
from barn_worlds.formats import gazebo, map_server, moving_ai, world_yaml
from barn_worlds.formats.npz import read_npy
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.course import build_world, parse_course, plan_course
from barn_worlds.worlds.cspace import configuration_space
from barn_worlds.worlds.path_planner import plan_through
from barn_worlds.worlds.world import Provenance, World, validate_grid

STANDARD_RESOLUTION_M = 0.15
GAZEBO_ENDINGS = (".world", ".world.gz", ".sdf", ".sdf.gz")
MAP_ENDINGS = (".yaml", ".yml")
ENDINGS = (*GAZEBO_ENDINGS, world_yaml.ENDING, *MAP_ENDINGS, moving_ai.ENDING, ".npy")

_FOLDERS = ("grid_files", "world_files", "map_files")


def ending(path: Path) -> str:
    """Return the ending of a file that holds a world, `.gz` included; empty for any other."""
    return next(
        (
            known
            for known in sorted(ENDINGS, key=len, reverse=True)
            if path.name.lower().endswith(known)
        ),
        "",
    )


def check_ending(path: Path) -> None:
    """Raise WorldError if a file's name does not have the ending of a world."""
    if not ending(path):
        raise WorldError(
            f"{path}: a world must be in a file that ends in {', '.join(ENDINGS)}"
        )


def number_in(path: Path) -> int | None:
    """Return the last number in a file's name, which is the number of the world, or None."""
    found = re.findall(r"\d+", path.name[: -len(ending(path))])
    return int(found[-1]) if found and len(found[-1]) <= 9 else None


def read_world(path: Path, robot: Robot = STANDARD_ROBOT, name: str = "") -> World:
    """Return the world of a file, named after it; WorldError if it holds none.

    The path comes from path_N.npy in the same folder or in a sibling folder path_files (N: the number in the file's
    name). Without such a file it is planned through the C-space of `robot`. A .npy grid has cells of 0.15 m. A
    .world.yaml has a name and a path of its own. A map that does not show a world of BARN with its containment is taken
    as it is, in its place; start and goal are those of its .yaml file, else chosen for `robot`. Those of a Gazebo world
    are its frames `start` and `goal`, if it has any.
    """
    check_ending(path)
    kind, resolution_m = ending(path), STANDARD_RESOLUTION_M
    called = name or path.name[: -len(kind)]
    if kind == world_yaml.ENDING:
        return world_yaml.read_world_yaml(path)
    course = gazebo.read_course(path) if kind in GAZEBO_ENDINGS else []
    if kind in GAZEBO_ENDINGS:
        if course and (found := gazebo.read_open_grid(path, course[:2])):
            return build_world(
                called,
                *found,
                robot,
                Provenance("world_file", str(path)),
                parse_course(course, str(path)),
            )
        source, (grid, resolution_m) = "world_file", gazebo.read_grid(path)
    elif kind in (*MAP_ENDINGS, moving_ai.ENDING):
        return _of_map(path, kind, robot, called)
    else:
        source, grid = "npy", validate_grid(read_npy(path), str(path))
    footprint_cells = robot.footprint_cells(resolution_m)
    world = build_grid_world(
        called, grid, resolution_m, footprint_cells, source, path, _path_beside(path)
    )
    return (
        plan_course(world, robot, parse_course(course, str(path))) if course else world
    )


def build_grid_world(
    name: str,
    grid: BoolGrid,
    resolution_m: float,
    footprint_cells: int,
    source: str,
    path: Path,
    given: Path | None,
) -> World:
    """Return the world of a grid read from `path`, with the path in the .npy file `given`, else a planned one."""
    cells = (
        read_npy(given) if given else plan_grid_path(grid, footprint_cells, str(path))
    )
    about = Provenance(source, str(path), path_source="given" if given else "planned")
    return World(name, grid, cells, resolution_m, footprint_cells, about)


def _of_map(path: Path, kind: str, robot: Robot, name: str) -> World:
    if kind == moving_ai.ENDING:
        grid = moving_ai.read_grid(path)
        return build_world(
            name,
            grid,
            moving_ai.CELL_M,
            (0.0, 0.0),
            robot,
            Provenance("map", str(path)),
        )
    about = map_server.read_map_file(path)
    occupancy = map_server.read_map(path, about)
    ends = (
        parse_course((*about.start, *about.goal), f"{path}: start and goal")
        if about.start
        else None
    )
    inside = map_server.extract_grid(occupancy)
    if inside is None:
        whole = validate_grid(np.ascontiguousarray((occupancy.data != 0).T), str(path))
        corner = occupancy.origin_x, occupancy.origin_y
        return build_world(
            name,
            whole,
            occupancy.resolution,
            corner,
            robot,
            Provenance("map", str(path)),
            ends,
        )
    grid, cell_m = validate_grid(inside, str(path)), occupancy.resolution
    world = build_grid_world(
        name,
        grid,
        cell_m,
        robot.footprint_cells(cell_m),
        "map",
        path,
        _path_beside(path),
    )
    return plan_course(world, robot, ends) if ends else world


def plan_grid_path(grid: BoolGrid, footprint_cells: int, where: str) -> Cells:
    """Return a planned path (n, 2) through a grid; WorldError if there is none."""
    path = plan_through(configuration_space(grid, footprint_cells))
    if path is None:
        robot = f"a robot of {footprint_cells} x {footprint_cells} cells"
        raise WorldError(
            f"{where}: no path from the first to the last column for {robot}"
        )
    return path


def _path_beside(path: Path) -> Path | None:
    places = [
        path.parent,
        *([path.parent.parent / "path_files"] if path.parent.name in _FOLDERS else []),
    ]
    candidates = (place / f"path_{number_in(path)}.npy" for place in places)
    return next((file for file in candidates if file != path and file.is_file()), None)
