"""One world as YAML that people read and write: cells, path, walls and moving obstacles."""

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml

from barn_worlds.base.arrays import BoolGrid, Cells
from barn_worlds.base.config import Checked, as_dict, from_dict, optional, quantity
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import write_bytes
from barn_worlds.base.text_files import read_yaml
from barn_worlds.moving.motion import MovingObstacle, Wall
from barn_worlds.worlds.course import parse_course
from barn_worlds.worlds.world import LARGEST_NAME, LARGEST_SIDE, Provenance, World

ENDING = ".world.yaml"
SCHEMA_VERSION = 1
LARGEST_BYTES = 1_000_000  # a grid and keys of motions take more than a configuration
_FREE, _FILLED = ".", "#"


@dataclass(frozen=True)
class WorldFile(Checked):
    """What a file holds beside its schema_version.

    cells: rows and columns. grid: a text per row, a letter per column, # where it is filled; left out if all is free.
    path: cells (row, column); between two of them it goes straight, along a row, a column or a diagonal. corner_m: of
    an arena. Moving obstacles and walls are as in `barn_worlds.moving.motion`; what has its default may be left out.
    """

    name: str = quantity("world", "name of the world")
    cell_m: float = quantity(0.15, "side of a cell", "m", 0.01, 10.0)
    footprint_cells: int = quantity(
        1, "side of the footprint, odd", "", 1, 2 * LARGEST_SIDE
    )
    cells: tuple[int, int] = quantity((30, 30), "rows and columns", "", 1, LARGEST_SIDE)
    path: tuple[tuple[int, int], ...] = ()
    grid: tuple[str, ...] = ()
    corner_m: tuple[float, float] | None = None
    start: tuple[float, ...] = optional((), "x, y in m and yaw in rad of the start")
    goal: tuple[float, ...] = optional((), "x, y in m (and yaw in rad) of the goal")
    walls: tuple[Wall, ...] = ()
    moving: tuple[MovingObstacle, ...] = ()

    def world(self, where: str) -> World:
        """Return the world; WorldError, beginning with `where`, if it cannot be."""
        if not 0 < len(self.name) <= LARGEST_NAME or not self.name.isprintable():
            raise WorldError(
                f"{where}: name must have 1 to {LARGEST_NAME} printable characters, got {self.name!r:.60}"
            )
        try:
            grid = self._filled()
            path, size = (
                _path(self.path, grid.shape),
                (self.cell_m, self.footprint_cells),
            )
            ends = (
                parse_course((*self.start, *self.goal), "start and goal")
                if self.start or self.goal
                else ()
            )
            about = Provenance("yaml", where)
            return World(
                self.name,
                grid,
                path,
                *size,
                about,
                self.walls,
                self.moving,
                self.corner_m,
                *ends,
            )
        except WorldError as error:
            raise WorldError(f"{where}: {error}") from None

    def _filled(self) -> BoolGrid:
        rows, cols = self.cells
        if self.grid and len(self.grid) != rows:
            raise WorldError(f"grid must have {rows} rows, got {len(self.grid)}")
        for number, row in enumerate(self.grid):
            if len(row) != cols or set(row) - {_FREE, _FILLED}:
                raise WorldError(
                    f"grid[{number}] must be {cols} of the letters {_FREE} and {_FILLED}, got {row!r:.60}"
                )
        if not self.grid:
            return np.zeros((rows, cols), np.bool_)
        return np.array([[letter == _FILLED for letter in row] for row in self.grid])


def read_world_yaml(path: Path) -> World:
    """Return the world of a YAML file; WorldError or ConfigError in one line if it holds none."""
    return from_dict(
        WorldFile, read_yaml(path, SCHEMA_VERSION, LARGEST_BYTES), str(path)
    ).world(str(path))


def write_world_yaml(world: World, path: Path) -> None:
    """Write a world as YAML; its name must end in .world.yaml to be read as a data set."""
    write_bytes(path, world_yaml(world).encode())


def world_yaml(world: World) -> str:
    """Return a world as YAML. Provenance is not in it."""
    grid = (
        tuple("".join(row) for row in np.where(world.grid, _FILLED, _FREE).tolist())
        if world.grid.any()
        else ()
    )
    path = tuple((row, column) for row, column in _turns(world.path))
    size = world.resolution_m, world.footprint_cells, (world.rows, world.cols)
    ends = world.course_numbers[:3], world.course_numbers[3:]
    told = WorldFile(
        world.name, *size, path, grid, world.corner_m, *ends, world.walls, world.moving
    )
    plain = json.loads(
        json.dumps(as_dict(told))
    )  # lists for tuples, nothing twice: the reader refuses aliases
    content = {"schema_version": SCHEMA_VERSION, **plain}
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)


def _path(corners: tuple[tuple[int, int], ...], shape: tuple[int, ...]) -> Cells:
    """Return the path (n, 2) that goes straight through these cells."""
    pieces: list[Cells] = [np.array(corners[:1], np.int64).reshape(-1, 2)]
    for k, corner in enumerate(corners):
        if not (0 <= corner[0] < shape[0] and 0 <= corner[1] < shape[1]):
            raise WorldError(
                f"path[{k}] must be a cell of the {shape[0]} x {shape[1]}, got {list(corner)}"
            )
    for k, (first, last) in enumerate(pairwise(corners)):
        way = np.subtract(last, first)
        if way.all() and abs(way[0]) != abs(way[1]):
            raise WorldError(
                f"path[{k + 1}] must lie straight from the cell before, got {list(last)}"
            )
        length = max(1, int(np.abs(way).max()))
        pieces.append(first + way * np.arange(1, length + 1)[:, None] // length)
    return np.concatenate(pieces)


def _turns(path: Cells) -> list[list[int]]:
    """Return the cells of a path at which it turns or stays, with its first and last."""
    steps = np.diff(path, axis=0)
    bend = (np.diff(steps, axis=0) != 0).any(axis=1) | (steps[1:] == 0).all(axis=1)
    kept: list[list[int]] = path[
        np.concatenate([[True], bend, [True]])[: len(path)]
    ].tolist()
    return kept
