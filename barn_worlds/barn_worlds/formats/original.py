"""The folder layout of the original data set: grid_files, cspace_files, path_files, world_files and so on."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Floats
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import create_folder, write_bytes
from barn_worlds.formats import gazebo, map_server
from barn_worlds.formats.npz import encode_npy, read_npy
from barn_worlds.formats.single import STANDARD_RESOLUTION_M, build_grid_world
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.cspace import configuration_space
from barn_worlds.worlds.world import World, validate_grid

LARGEST_FOOTPRINT_TRIED = 41

_WORLDS = {
    "grid_files": r"grid_(\d{1,9})\.npy",
    "world_files": r"world_(\d{1,9})\.world(?:\.gz)?",
}


def is_original_folder(folder: Path) -> bool:
    """Tell whether a folder has the original layout: grid_files, world_files or both."""
    return any((folder / inside).is_dir() for inside in _WORLDS)


def find_world_numbers(folder: Path) -> list[int]:
    """Return the numbers of the worlds in a folder of the original layout, ascending."""
    files = (
        (pattern, file)
        for inside, pattern in _WORLDS.items()
        for file in (folder / inside).glob("*")
    )
    return sorted(
        {
            int(match[1])
            for pattern, file in files
            if (match := re.fullmatch(pattern, file.name))
        }
    )


def read_world(folder: Path, index: int, robot: Robot = STANDARD_ROBOT) -> World:
    """Return one world of a folder of the original layout; WorldError names the file that is malformed.

    The grid comes from grid_files, else from world_files. The path comes from path_files, else it is planned. The
    footprint is the one that reproduces cspace_files, else that of `robot`. The cell size comes from map_files.
    """
    path = folder / "grid_files" / f"grid_{index}.npy"
    if path.is_file():
        about = folder / "map_files" / f"yaml_{index}.yaml"
        resolution_m = (
            map_server.read_map_file(about).resolution
            if about.is_file()
            else STANDARD_RESOLUTION_M
        )
        grid = validate_grid(read_npy(path), str(path))
    else:
        packed, plain = (
            folder / "world_files" / f"world_{index}.world{end}" for end in (".gz", "")
        )
        path = packed if packed.is_file() else plain
        grid, resolution_m = gazebo.read_grid(path)
    footprint = _footprint(
        folder / "cspace_files" / f"cspace_{index}.npy",
        grid,
        robot.footprint_cells(resolution_m),
    )
    given = folder / "path_files" / f"path_{index}.npy"
    given_path = given if given.is_file() else None
    return build_grid_world(
        f"world_{index}", grid, resolution_m, footprint, "original", path, given_path
    )


def write_original(
    folder: Path,
    worlds: Mapping[int, World],
    metrics: Mapping[int, Floats] | None = None,
    *,
    historical: bool = False,
) -> None:
    """Write worlds by number into a new folder of the original layout, atomically.

    metrics: the five metrics of each world, for metrics_files. historical: place the obstacles in map_files one
    cell too near, as the original data set does. Raises WorldError if the folder exists and is not empty.
    """
    from barn_worlds.formats.sdf import write_sdf  # noqa: PLC0415 (loads the standard library's clients of the web)

    with create_folder(folder) as target:
        for index, world in worlds.items():
            for kind in ("grid", "cspace", "path"):
                content = encode_npy(getattr(world, kind).astype(np.int64))
                write_bytes(target / f"{kind}_files" / f"{kind}_{index}.npy", content)
            write_sdf(world, target / "world_files" / f"world_{index}.world.gz")
            occupancy = world.occupancy_map(historical=historical)
            map_server.write_map(
                occupancy,
                target / "map_files" / f"yaml_{index}",
                image=f"map_pgm_{index}.pgm",
            )
        for index, values in (metrics or {}).items():
            write_bytes(
                target / "metrics_files" / f"metrics_{index}.npy",
                encode_npy(np.asarray(values, np.float64)),
            )


def _footprint(path: Path, grid: BoolGrid, standard: int) -> int:
    """Return the footprint in cells that reproduces a stored C-space; the standard one if none is stored."""
    if not path.is_file():
        return standard
    cspace = validate_grid(read_npy(path), str(path))
    side: int
    for side in (standard, *range(1, LARGEST_FOOTPRINT_TRIED + 1, 2)):
        if np.array_equal(configuration_space(grid, side), cspace):
            return side
    raise WorldError(
        f"{path}: is not the C-space of the grid for any footprint up to {LARGEST_FOOTPRINT_TRIED} cells"
    )
