"""The folder layout of the original data set: grid_files, path_files and so on."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Floats
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import create_folder, write_bytes
from barn_worlds.formats import map_server
from barn_worlds.formats.gazebo import GazeboFile
from barn_worlds.formats.npz import encode_npy, read_npy
from barn_worlds.formats.single import build_grid_world
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.cells import STANDARD_CELL_M
from barn_worlds.worlds.cspace import configuration_space
from barn_worlds.worlds.world import World, validate_grid

LARGEST_FOOTPRINT_TRIED = 41
_WORLD_FILES = {
    "grid_files": r"grid_(\d{1,9})\.npy",
    "world_files": r"world_(\d{1,9})\.world(?:\.gz)?",
}


def is_original_folder(folder: Path) -> bool:
    """Tell whether a folder has the original layout: grid_files or world_files."""
    return any((folder / name).is_dir() for name in _WORLD_FILES)


def find_world_numbers(folder: Path) -> list[int]:
    """Return the numbers of the worlds in grid_files and world_files, ascending."""
    numbers = set()
    for name, pattern in _WORLD_FILES.items():
        for file in (folder / name).glob("*"):
            match = re.fullmatch(pattern, file.name)
            if match:
                numbers.add(int(match[1]))
    return sorted(numbers)


def read_world(folder: Path, index: int, robot: Robot) -> World:
    """Read one world of a folder in the original layout; plan its path if missing.

    The grid comes from grid_files, else from world_files, the path from path_files, the
    cell size from map_files. The footprint is the one that reproduces cspace_files.

    Args:
        folder: Folder with these folders.
        index: Number of the world.
        robot: Robot whose footprint is used if the folder has no cspace_files.

    Raises:
        WorldError: If a file is malformed.
    """
    path = folder / "grid_files" / f"grid_{index}.npy"
    if path.is_file():
        grid = validate_grid(read_npy(path), str(path))
        map_file = folder / "map_files" / f"yaml_{index}.yaml"
        resolution_m = STANDARD_CELL_M
        if map_file.is_file():
            resolution_m = map_server.read_map_file(map_file).resolution
    else:
        path = folder / "world_files" / f"world_{index}.world.gz"
        if not path.is_file():
            # Without .gz.
            path = path.with_suffix("")
        grid, resolution_m = GazeboFile.read(path).grid()

    cspace_file = folder / "cspace_files" / f"cspace_{index}.npy"
    footprint_cells = robot.footprint_cells(resolution_m)
    if cspace_file.is_file():
        footprint_cells = _find_footprint(cspace_file, grid, footprint_cells)
    path_file = folder / "path_files" / f"path_{index}.npy"
    return build_grid_world(
        f"world_{index}",
        grid,
        resolution_m,
        footprint_cells,
        "original",
        path,
        path_file if path_file.is_file() else None,
    )


def write_original(
    folder: Path, worlds: Mapping[int, World], metrics: Mapping[int, Floats]
) -> None:
    """Create a folder in the original layout, atomically; WorldError if it has files.

    Args:
        folder: Folder to create.
        worlds: Worlds by number.
        metrics: The five difficulty metrics (5,) of each world, for metrics_files.

    Raises:
        WorldError: If the folder exists and is not empty, or cannot be written.
    """
    # Imported here because its template library loads web clients.
    from barn_worlds.formats.sdf import write_sdf  # noqa: PLC0415

    with create_folder(folder) as target:
        for index, world in worlds.items():
            for kind in ("grid", "cspace", "path"):
                # The type of numbers in the original files.
                content = encode_npy(getattr(world, kind).astype(np.int64))
                write_bytes(target / f"{kind}_files" / f"{kind}_{index}.npy", content)
            write_sdf(world, target / "world_files" / f"world_{index}.world.gz")
            map_server.write_map(
                world.occupancy_map(),
                target / "map_files" / f"yaml_{index}",
                # As the original data set names it.
                image=f"map_pgm_{index}.pgm",
            )
        for index, values in metrics.items():
            content = encode_npy(np.asarray(values, np.float64))
            write_bytes(target / "metrics_files" / f"metrics_{index}.npy", content)


def _find_footprint(path: Path, grid: BoolGrid, expected_cells: int) -> int:
    """Return the footprint in cells that reproduces a C-space file; else WorldError.

    Args:
        path: File with the C-space.
        grid: Grid (rows, cols) of the world.
        expected_cells: Footprint to try first.
    """
    cspace = validate_grid(read_npy(path), str(path))
    # Footprints are odd, so that base_link is in the middle of a cell.
    side: int
    for side in (expected_cells, *range(1, LARGEST_FOOTPRINT_TRIED + 1, 2)):
        if np.array_equal(configuration_space(grid, side), cspace):
            return side
    raise WorldError(
        f"{path}: is not the C-space of the grid for any footprint "
        f"up to {LARGEST_FOOTPRINT_TRIED} cells"
    )
