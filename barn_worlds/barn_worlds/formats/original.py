"""The folder layout of the original data set: grid_files, cspace_files, path_files, world_files and so on."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_worlds.arrays import BoolGrid
from barn_worlds.cspace import configuration_space
from barn_worlds.errors import WorldError
from barn_worlds.formats.npy import read_npy
from barn_worlds.world import Provenance, World, checked_grid

STANDARD_FOOTPRINT_CELLS = 5
LARGEST_FOOTPRINT_TRIED = 41
LARGEST_INDEX_DIGITS = 9


def is_original_folder(folder: Path) -> bool:
    """Tell whether a folder has the original layout."""
    return (folder / "grid_files").is_dir()


def indices(folder: Path) -> list[int]:
    """Return the numbers of the worlds in a folder of the original layout, ascending."""
    pattern = re.compile(rf"grid_(\d{{1,{LARGEST_INDEX_DIGITS}}})\.npy")
    found = (pattern.fullmatch(file.name) for file in (folder / "grid_files").iterdir())
    return sorted(int(match[1]) for match in found if match)


def read_world(folder: Path, index: int) -> World:
    """Return one world of a folder of the original layout; WorldError names the file that is not as it should be."""
    path = folder / "grid_files" / f"grid_{index}.npy"
    grid = checked_grid(read_npy(path), str(path))
    cells = read_npy(folder / "path_files" / f"path_{index}.npy")
    footprint = _footprint(folder / "cspace_files" / f"cspace_{index}.npy", grid)
    provenance = Provenance("original", str(path))
    return World(f"world_{index}", grid, cells, footprint_cells=footprint, provenance=provenance)


def read_metrics(folder: Path, index: int) -> npt.NDArray[np.float64] | None:
    """Return the five published metrics of a world, in the order of the paper, or None where there are none."""
    path = folder / "metrics_files" / f"metrics_{index}.npy"
    if not path.is_file():
        return None
    metrics: npt.NDArray[Any] = read_npy(path)
    if metrics.shape != (5,) or not np.isfinite(metrics).all():
        raise WorldError(f"{path}: must hold five numbers, got {metrics.tolist()!r:.80}")
    return metrics.astype(np.float64)


def _footprint(path: Path, grid: BoolGrid) -> int:
    """Return the footprint that explains a stored C-space; the standard one where none is stored."""
    if not path.is_file():
        return STANDARD_FOOTPRINT_CELLS
    cspace = checked_grid(read_npy(path), str(path))
    tried: list[int] = [STANDARD_FOOTPRINT_CELLS, *range(1, LARGEST_FOOTPRINT_TRIED + 1, 2)]
    for side in tried:
        if np.array_equal(configuration_space(grid, side), cspace):
            return side
    raise WorldError(f"{path}: is not the C-space of the grid for any footprint up to {LARGEST_FOOTPRINT_TRIED} cells")
