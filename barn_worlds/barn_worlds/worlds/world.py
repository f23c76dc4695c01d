"""A world of the benchmark: a grid of obstacle cells, the path through it, and both in metres."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from barn_worlds.base.arrays import BoolGrid, Cells, Points
from barn_worlds.base.errors import WorldError
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.moving.motion import MovingObstacle, Wall, check_scene, scene_content
from barn_worlds.moving.tracks import Tracks
from barn_worlds.worlds import cells as geometry
from barn_worlds.worlds.cells import occupy_box, world_map
from barn_worlds.worlds.cspace import configuration_space

A = TypeVar("A", bound=npt.NDArray[Any])

LARGEST_SIDE = 2000
LONGEST_PATH = 1_000_000
LARGEST_NAME = 200
FARTHEST_CORNER_M = 10_000.0


@dataclass(frozen=True)
class Provenance:
    """Where a world comes from.

    source: "generated", "original", "world_file", "npy", "map" or "memory". path: the file it was read from.
    parameters, seed: what it was generated with (entropy and spawn key of its SeedSequence). path_source: "given",
    "planned" where the file had no path, or "chosen" where start and goal were chosen as well.
    """

    source: str = "memory"
    path: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    seed: tuple[int, ...] = ()
    path_source: str = "given"


@dataclass(frozen=True, eq=False)
class World:
    """A rows x cols grid of obstacle cells with a path of cells through it.

    grid: (rows, cols) bool, True where filled; path: (n, 2) int64 (row, column) from the first to the last column, a
    cell possibly repeated; footprint_cells: odd side of the robot's square footprint, for the C-space. Arrays are
    copied and read-only. Raises WorldError for anything else. Metres are in the Gazebo world frame (see
    `barn_worlds.worlds.cells`).

    walls, moving: what stands and moves there beside the grid's cylinders, in the same frame; the C-space knows nothing
    of them. corner_m: in an arena, where cell (0, 0) has its outer corner. An arena has no containment.

    start, goal: in the map frame, both or none; without, the protocol says where they are (`worlds.course`).
    """

    name: str
    grid: BoolGrid
    path: Cells
    resolution_m: float = geometry.STANDARD_CELL_M
    footprint_cells: int = 5
    provenance: Provenance = field(default_factory=Provenance)
    walls: tuple[Wall, ...] = ()
    moving: tuple[MovingObstacle, ...] = ()
    corner_m: tuple[float, float] | None = None
    start: Pose2D | None = None
    goal: Pose2D | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not 0 < len(self.name) <= LARGEST_NAME:
            raise WorldError(
                f"name of a world must have 1 to {LARGEST_NAME} characters, got {self.name!r:.60}"
            )
        if not (math.isfinite(self.resolution_m) and 0.01 <= self.resolution_m <= 10.0):
            raise WorldError(
                f"{self.name}: resolution must be from 0.01 to 10 m, got {self.resolution_m}"
            )
        grid = validate_grid(self.grid, self.name)
        object.__setattr__(self, "grid", grid)
        object.__setattr__(self, "path", validate_path(self.path, grid, self.name))
        side, most = self.footprint_cells, 2 * LARGEST_SIDE
        if not (isinstance(side, int) and 0 < side < most and side % 2):
            raise WorldError(
                f"{self.name}: footprint must be an odd number of cells from 1 to {most}, got {side}"
            )
        check_scene(self.walls, self.moving, self.name)
        if self.corner_m is not None and not all(
            abs(side) <= FARTHEST_CORNER_M for side in self.corner_m
        ):
            raise WorldError(
                f"{self.name}: corner must be within {FARTHEST_CORNER_M:g} m, got {self.corner_m}"
            )
        if (self.start is None) != (self.goal is None):
            raise WorldError(f"{self.name}: start and goal must both be given, or none")

    @property
    def rows(self) -> int:
        """Number of rows, along x."""
        return int(self.grid.shape[0])

    @property
    def cols(self) -> int:
        """Number of columns, along y."""
        return int(self.grid.shape[1])

    @cached_property
    def cspace(self) -> BoolGrid:
        """Occupied cells (rows, cols) of the configuration space."""
        return _read_only(configuration_space(self.grid, self.footprint_cells))

    @property
    def start_cell(self) -> tuple[int, int]:
        """(row, column) of the path's first cell."""
        return int(self.path[0, 0]), int(self.path[0, 1])

    @property
    def goal_cell(self) -> tuple[int, int]:
        """(row, column) of the path's last cell."""
        return int(self.path[-1, 0]), int(self.path[-1, 1])

    @property
    def cylinder_radius_m(self) -> float:
        """Radius of every cylinder: half a cell."""
        return self.resolution_m / 2.0

    @property
    def cylinder_height_m(self) -> float:
        """Height of every cylinder."""
        return geometry.CYLINDER_HEIGHT_M

    @cached_property
    def obstacles_m(self) -> Points:
        """Centres (n, 2) of the grid's cylinders, without cells whose neighbours are all filled."""
        return _read_only(
            self.cell_centers_m(
                np.argwhere(self.grid & ~geometry.hollow_cells(self.grid))
            )
        )

    @cached_property
    def containment_m(self) -> Points:
        """Centres (m, 2) of the cylinders of back wall and side walls in front of the grid; none in an arena."""
        if self.corner_m is not None:
            return _read_only(np.empty((0, 2)))
        cells = geometry.containment_cells(self.rows, self.resolution_m)
        return _read_only(geometry.cell_centers(cells, self.rows, self.resolution_m))

    @cached_property
    def cylinders_m(self) -> Points:
        """Centres (n + m, 2) of all cylinders, the grid's first."""
        return _read_only(np.concatenate([self.obstacles_m, self.containment_m]))

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max of all cells, the containment included."""
        if self.corner_m is not None:
            x_m, y_m = self.corner_m
            return (
                x_m,
                y_m,
                x_m + self.rows * self.resolution_m,
                y_m + self.cols * self.resolution_m,
            )
        length = (
            geometry.lead_in_cells(self.resolution_m) + self.cols
        ) * self.resolution_m
        return -self.rows * self.resolution_m, 0.0, 0.0, length

    def path_m(self, historical: bool = False) -> Points:
        """Return the path (n, 2) in metres; `historical`: as the original tools convert it.

        That is one cell too low in x and two thirds of a cell too low in y (0.15 and 0.10 m in a standard world), as
        the goals of the paper's trials are. They had no arenas: there, both are true.
        """
        off = (
            (self.resolution_m, self.resolution_m * 2.0 / 3.0)
            if historical and self.corner_m is None
            else (0.0, 0.0)
        )
        return np.subtract(self.cell_centers_m(self.path), off)

    def cell_centers_m(self, cells: Cells) -> Points:
        """Return the true centres (n, 2) in metres of cells (n, 2)."""
        if self.corner_m is None:
            return geometry.cell_centers(cells, self.rows, self.resolution_m)
        centres: Points = (cells + 0.5) * self.resolution_m + np.array(self.corner_m)
        return centres

    def containing_cells(self, points: Points) -> Cells:
        """Return the cells (n, 2) in which points (n, 2) in metres lie; they may be outside the grid."""
        if self.corner_m is None:
            return geometry.containing_cells(points, self.rows, self.resolution_m)
        cells: Cells = np.floor(
            (points - np.array(self.corner_m)) / self.resolution_m
        ).astype(np.int64)
        return cells

    @cached_property
    def occupied(self) -> BoolGrid:
        """Filled cells (rows, cols), with those that the walls of an arena reach into."""
        return (
            self.grid
            if self.corner_m is None
            else _read_only(self.occupancy_map().data.T > 0)
        )

    @cached_property
    def tracks(self) -> Tracks:
        """Where the moving obstacles are at any time."""
        return Tracks(self.moving)

    @cached_property
    def path_length_m(self) -> float:
        """Arc length of the path over cell centres; a repeated cell adds nothing."""
        return float(np.hypot(*np.diff(self.path, axis=0).T).sum() * self.resolution_m)

    def occupancy_map(
        self, resolution_m: float | None = None, *, historical: bool = False
    ) -> OccupancyMap:
        """Return the map a planner is given; see `barn_worlds.worlds.cells.world_map`. What moves is not in it."""
        found = world_map(
            self.grid,
            self.resolution_m,
            resolution_m,
            historical=historical,
            corner_m=self.corner_m,
        )
        for wall in self.walls:
            occupy_box(
                found,
                (wall.x_m, wall.y_m),
                (wall.size_x_m, wall.size_y_m),
                wall.yaw_rad,
            )
        return found

    @property
    def course_numbers(self) -> tuple[float, ...]:
        """x, y and yaw of start and goal, (6,); empty without."""
        return tuple(
            float(number)
            for end in (self.start, self.goal)
            if end
            for number in (end.x, end.y, end.yaw)
        )

    @cached_property
    def checksum(self) -> str:
        """SHA-256 of grid, path, resolution, footprint and what stands and moves beside it, without names."""
        digest = hashlib.sha256(
            np.array([self.rows, self.cols, self.footprint_cells], "<i8").tobytes()
        )
        digest.update(np.array([self.resolution_m], "<f8").tobytes())
        digest.update(np.packbits(self.grid).tobytes())
        digest.update(self.path.astype("<i8").tobytes())
        digest.update(
            np.array([*(self.corner_m or ()), *self.course_numbers], "<f8").tobytes()
        )
        if self.walls or self.moving:
            digest.update(scene_content(self.walls, self.moving))
        return digest.hexdigest()


def validate_grid(grid: object, where: str) -> BoolGrid:
    """Return a read-only copy of a grid of bools or of zeros and ones; WorldError, beginning with `where`, if not."""
    if not isinstance(grid, np.ndarray) or grid.ndim != 2:
        shape = getattr(grid, "shape", type(grid).__name__)
        raise WorldError(f"{where}: grid must be a two-dimensional array, got {shape}")
    if not all(1 <= side <= LARGEST_SIDE for side in grid.shape):
        raise WorldError(
            f"{where}: grid must be 1 to {LARGEST_SIDE} cells wide and long, got {grid.shape}"
        )
    if grid.dtype.kind not in "biuf":
        raise WorldError(
            f"{where}: grid must hold zeros and ones, got values of type {grid.dtype}"
        )
    wrong = (grid != 0) & (grid != 1)
    for row, column in np.argwhere(wrong):
        value = grid[row, column]
        raise WorldError(
            f"{where}: grid must hold zeros and ones, got {value} in row {row}, column {column}"
        )
    return _read_only(grid.astype(np.bool_, copy=True))


def validate_path(path: object, grid: BoolGrid, where: str) -> Cells:
    """Return a read-only copy of a path (n, 2) of free, adjoining cells; WorldError, beginning with `where`, if not."""
    if not isinstance(path, np.ndarray) or path.ndim != 2 or path.shape[1] != 2:
        shape = getattr(path, "shape", type(path).__name__)
        raise WorldError(
            f"{where}: path must be an array of rows and columns (n, 2), got {shape}"
        )
    if not 1 <= len(path) <= LONGEST_PATH:
        raise WorldError(
            f"{where}: path must have 1 to {LONGEST_PATH} cells, got {len(path)}"
        )
    if path.dtype.kind not in "iuf" or not (path == np.floor(path)).all():
        raise WorldError(
            f"{where}: path must hold whole numbers, got values of type {path.dtype}"
        )
    outside = ((path < 0) | (path >= np.array(grid.shape))).any(axis=1)
    if outside.any():
        raise WorldError(
            f"{where}: path leaves the grid of {grid.shape} at {path[outside][0].tolist()}"
        )
    cells = path.astype(np.int64)
    apart = (np.abs(np.diff(cells, axis=0)) > 1).any(axis=1)
    if apart.any():
        first, second = cells[:-1][apart][0].tolist(), cells[1:][apart][0].tolist()
        raise WorldError(
            f"{where}: path must go from cell to neighbouring cell, got {first} then {second}"
        )
    through = grid[cells[:, 0], cells[:, 1]]
    if through.any():
        raise WorldError(
            f"{where}: path goes through the filled cell {cells[through][0].tolist()}"
        )
    return _read_only(cells)


def _read_only(array: A) -> A:
    array.setflags(write=False)
    return array
