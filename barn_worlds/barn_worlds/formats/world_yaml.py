"""One world as YAML that people can write: cells, path, walls, moving obstacles."""

import json
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from barn_worlds.base.arrays import BoolGrid, Cells
from barn_worlds.base.config import (
    OPTIONAL,
    Checked,
    as_dict,
    from_dict,
    optional,
    quantity,
)
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import dump_yaml, read_yaml, write_bytes
from barn_worlds.moving.motion import MovingObstacle, Wall
from barn_worlds.worlds.course import parse_course
from barn_worlds.worlds.world import LARGEST_NAME, LARGEST_SIDE, Provenance, World

ENDING = ".world.yaml"
SCHEMA_VERSION = 1
LARGEST_BYTES = 1_000_000  # a grid and keys of motions take more than a configuration
_FREE = "."
_FILLED = "#"


@dataclass(frozen=True)
class WorldFile(Checked):
    """The content of a file without its schema_version.

    A field that has its default may be left out.
    """

    name: str = quantity("world", "name of the world")
    cell_m: float = quantity(0.15, "side of a cell", "m", 0.01, 10.0)
    footprint_cells: int = quantity(
        1, "side of the footprint, odd", "", 1, 2 * LARGEST_SIDE
    )
    cells: tuple[int, int] = quantity((30, 30), "rows and columns", "", 1, LARGEST_SIDE)

    # Cells (row, column). Between two of them the path is straight: along a row, a
    # column or a diagonal.
    path: tuple[tuple[int, int], ...] = ()

    # A text per row with a letter per column, # if filled; empty if all cells are free.
    grid: tuple[str, ...] = ()

    # Outer corner of cell (0, 0) in the map frame, of an arena.
    corner_m: tuple[float, float] | None = None
    start: tuple[float, ...] = optional((), "x, y in m and yaw in rad of the start")
    goal: tuple[float, ...] = optional((), "x, y in m (and yaw in rad) of the goal")
    walls: tuple[Wall, ...] = ()
    moving: tuple[MovingObstacle, ...] = ()

    # Surveyed centers of the cylinders (`World.built_m`).
    built_m: tuple[tuple[float, float], ...] = field(default=(), metadata=OPTIONAL)

    def world(self, where: str) -> World:
        """Return the world that the fields describe; WorldError if they are invalid.

        Args:
            where: Path of the file, to begin an error message with.

        Raises:
            WorldError: If the fields do not describe a world.
        """
        if not 0 < len(self.name) <= LARGEST_NAME or not self.name.isprintable():
            raise WorldError(
                f"{where}: name must have 1 to {LARGEST_NAME} printable characters, "
                f"got {self.name!r:.60}"
            )
        try:
            grid = self._parse_grid()
            path = _connect(self.path, grid)
            start = goal = None
            if self.start or self.goal:
                start, goal = parse_course((*self.start, *self.goal), "start and goal")
            return World(
                self.name,
                grid,
                path,
                self.cell_m,
                self.footprint_cells,
                Provenance("yaml", where),
                self.walls,
                self.moving,
                self.corner_m,
                start,
                goal,
                np.array(self.built_m) if self.built_m else None,
            )
        except WorldError as error:
            raise WorldError(f"{where}: {error}") from None

    def _parse_grid(self) -> BoolGrid:
        """Return the letters as a grid (rows, cols); WorldError if they do not fit."""
        rows, cols = self.cells
        if not self.grid:
            return np.zeros((rows, cols), np.bool_)
        if len(self.grid) != rows:
            raise WorldError(f"grid must have {rows} rows, got {len(self.grid)}")
        for number, row in enumerate(self.grid):
            if len(row) != cols or set(row) - {_FREE, _FILLED}:
                raise WorldError(
                    f"grid[{number}] must be {cols} of the letters {_FREE} and "
                    f"{_FILLED}, got {row!r:.60}"
                )
        grid: BoolGrid = np.array(list(map(list, self.grid))) == _FILLED
        return grid


def read_world_yaml(path: Path) -> World:
    """Read the world in a .world.yaml file; ConfigError or WorldError if invalid.

    Raises:
        BarnError: If the file cannot be read or does not hold a world.
    """
    content = read_yaml(path, SCHEMA_VERSION, LARGEST_BYTES)
    return from_dict(WorldFile, content, str(path)).world(str(path))


def write_world_yaml(world: World, path: Path) -> None:
    """Write a world as the suite's YAML, without its provenance, atomically.

    Args:
        world: World to write.
        path: File to write. Data sets read only files that end in .world.yaml.
    """
    write_bytes(path, world_yaml(world).encode())


def world_yaml(world: World) -> str:
    """Return a world as text in the suite's YAML, without its provenance."""
    letters = np.where(world.grid, _FILLED, _FREE).tolist()
    world_file = WorldFile(
        name=world.name,
        cell_m=world.resolution_m,
        footprint_cells=world.footprint_cells,
        cells=(world.rows, world.cols),
        path=tuple((row, column) for row, column in _corners(world.path).tolist()),
        grid=tuple(map("".join, letters)) if world.grid.any() else (),
        corner_m=world.corner_m,
        start=world.course_numbers[:3],
        goal=world.course_numbers[3:],
        walls=world.walls,
        moving=world.moving,
    )
    if world.built_m is not None:
        built_m = tuple((x, y) for x, y in world.built_m.tolist())
        world_file = replace(world_file, built_m=built_m)
    # JSON turns tuples into lists and copies repeated values: the reader refuses YAML
    # aliases.
    plain = json.loads(json.dumps(as_dict(world_file)))
    content = {"schema_version": SCHEMA_VERSION, **plain}
    # Style None writes a list of numbers on one line and a mapping one key per line.
    return dump_yaml(content, default_flow_style=None, width=120)


def _connect(corners: tuple[tuple[int, int], ...], grid: BoolGrid) -> Cells:
    """Return all cells (n, 2) of a path through corners; WorldError if impossible.

    Corners must be on the grid and connected by a row, a column or a diagonal.
    """
    rows, cols = grid.shape
    for k, (row, column) in enumerate(corners):
        if not (0 <= row < rows and 0 <= column < cols):
            raise WorldError(
                f"path[{k}] must be one of {rows} x {cols} cells, got {[row, column]}"
            )
    pieces: list[Cells] = [np.array(corners[:1], np.int64).reshape(-1, 2)]
    for k, (first, last) in enumerate(pairwise(corners)):
        step = np.subtract(last, first)
        if step.all() and abs(step[0]) != abs(step[1]):
            raise WorldError(
                f"path[{k + 1}] must be in line with the cell before (row, column or "
                f"diagonal), got {list(last)}"
            )
        length = max(1, int(np.abs(step).max()))
        # Exact: along a straight line a coordinate changes by 0 or 1 per cell.
        pieces.append(first + step * np.arange(1, length + 1)[:, None] // length)
    return np.concatenate(pieces)


def _corners(path: Cells) -> Cells:
    """Return the cells (k, 2) of a path at its ends and where it turns or repeats."""
    steps = np.diff(path, axis=0)
    turns = (np.diff(steps, axis=0) != 0).any(axis=1)
    stays = (steps[1:] == 0).all(axis=1)
    is_corner = np.concatenate([[True], turns | stays, [True]])
    # A path of one cell is both of its ends.
    corners: Cells = path[is_corner[: len(path)]]
    return corners
