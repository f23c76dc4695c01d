"""A world of the benchmark: a grid of obstacle cells and the path through it."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from barn_worlds.base.arrays import AnyArray, BoolGrid, Cells, Points, side_lengths
from barn_worlds.base.errors import WorldError, format_value
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.moving.motion import MovingObstacle, Wall, check_scene, scene_content
from barn_worlds.moving.tracks import Tracks
from barn_worlds.worlds import cells as geometry
from barn_worlds.worlds.cspace import configuration_space

_Array = TypeVar("_Array", bound=AnyArray)

LARGEST_SIDE = 2000
LONGEST_PATH = 1_000_000
LARGEST_NAME = 200
FARTHEST_CORNER_M = 10_000.0


@dataclass(frozen=True)
class Provenance:
    """The origin of a world."""

    # "generated", "original", "world_file", "npy", "map", "yaml" or "memory".
    source: str = "memory"
    # File that the world was read from.
    path: str = ""
    # What it was generated with.
    parameters: Mapping[str, Any] = field(default_factory=dict)
    # Entropy and spawn key of the generator's SeedSequence.
    seed: tuple[int, ...] = ()
    # "given"; "planned" where the file had no path; "chosen" where start and goal were
    # chosen as well.
    path_source: str = "given"


@dataclass(frozen=True, eq=False)
class World:
    """A grid of obstacle cells with a path through it, in the frame of `worlds.cells`.

    Arrays are copied and read-only.

    Raises:
        WorldError: If a field is not what its comment says.
    """

    # 1 to 200 characters.
    name: str
    # (rows, cols), True where filled.
    grid: BoolGrid
    # (n, 2) row and column of free, adjoining cells; a cell may be repeated.
    path: Cells
    # Size of a cell.
    resolution_m: float = geometry.STANDARD_CELL_M
    # Odd side of the robot's square footprint, for the C-space.
    footprint_cells: int = 5
    provenance: Provenance = Provenance()
    # What stands and moves beside the grid's cylinders; the C-space does not contain
    # it.
    walls: tuple[Wall, ...] = ()
    moving: tuple[MovingObstacle, ...] = ()
    # Outer corner of cell (0, 0) of an arena, which has no containment.
    corner_m: tuple[float, float] | None = None
    # In the map frame, both or none. Without them the protocol says where trials start
    # and end (`worlds.course`).
    start: Pose2D | None = None
    goal: Pose2D | None = None
    # (n + m, 2) where a survey saw the cylinders of a world that was built for real, in
    # the order of `planned_m`. The grid is still the plan.
    built_m: Points | None = None

    def __post_init__(self) -> None:
        """Replace arrays by read-only copies; WorldError for a bad field."""
        if not isinstance(self.name, str) or not 0 < len(self.name) <= LARGEST_NAME:
            raise WorldError(
                f"name of a world must have 1 to {LARGEST_NAME} characters, "
                f"got {self.name!r:.60}"
            )
        if not (math.isfinite(self.resolution_m) and 0.01 <= self.resolution_m <= 10.0):
            raise WorldError(
                f"{self.name}: resolution must be from 0.01 to 10 m, "
                f"got {self.resolution_m}"
            )

        # The class is frozen: this is how it replaces the arrays by read-only copies.
        object.__setattr__(self, "grid", validate_grid(self.grid, self.name))
        object.__setattr__(self, "path", validate_path(self.path, self.grid, self.name))

        side = self.footprint_cells
        limit = 2 * LARGEST_SIDE
        if not (isinstance(side, int) and 0 < side < limit and side % 2):
            raise WorldError(
                f"{self.name}: footprint must be an odd number of cells "
                f"from 1 to {limit}, got {side}"
            )
        check_scene(self.walls, self.moving, self.name)
        for coordinate in self.corner_m or ():
            # Written so that NaN is refused as well.
            if not abs(coordinate) <= FARTHEST_CORNER_M:
                raise WorldError(
                    f"{self.name}: corner must be within {FARTHEST_CORNER_M:g} m, "
                    f"got {self.corner_m}"
                )
        if (self.start is None) != (self.goal is None):
            raise WorldError(f"{self.name}: give both start and goal, or neither")
        if self.built_m is not None:
            object.__setattr__(self, "built_m", self._check_built(self.built_m))

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
        """C-space (rows, cols), True where the footprint's center may not be."""
        return _read_only(configuration_space(self.grid, self.footprint_cells))

    @property
    def cylinder_radius_m(self) -> float:
        """Radius in m of every cylinder: half a cell."""
        return self.resolution_m / 2.0

    @property
    def cylinder_height_m(self) -> float:
        """Height in m of every cylinder, the same in all worlds."""
        return geometry.CYLINDER_HEIGHT_M

    @cached_property
    def obstacles_m(self) -> Points:
        """Centers (n, 2) in m of the grid's cylinders, hollow cells left out."""
        return self.cylinders_m[: len(self._visible_cells)]

    @cached_property
    def containment_m(self) -> Points:
        """Centers (m, 2) in m of the containment's cylinders; (0, 2) in an arena."""
        return self.cylinders_m[len(self._visible_cells) :]

    @cached_property
    def cylinders_m(self) -> Points:
        """Centers (n + m, 2) in m of grid, then containment cylinders, or surveyed."""
        return self.planned_m if self.built_m is None else self.built_m

    @cached_property
    def planned_m(self) -> Points:
        """Centers (n + m, 2) in m of grid, then containment cylinders, as planned."""
        obstacles_m = self.cell_centers_m(self._visible_cells)
        if self.corner_m is not None:
            return _read_only(obstacles_m)
        cells = geometry.containment_cells(self.rows, self.resolution_m)
        containment_m = geometry.cell_centers(cells, self.rows, self.resolution_m)
        return _read_only(np.concatenate([obstacles_m, containment_m]))

    @cached_property
    def _visible_cells(self) -> Cells:
        """Filled cells (n, 2), hollow ones left out."""
        return np.argwhere(self.grid & ~geometry.hollow_cells(self.grid))

    def _check_built(self, built_m: object) -> Points:
        """Return surveyed centers as a read-only copy; WorldError if they misfit."""
        centers_m: Points = np.array(built_m, np.float64)
        if centers_m.shape != self.planned_m.shape:
            raise WorldError(
                f"{self.name}: built_m must have x and y of {len(self.planned_m)}"
                f" cylinders, got an array {centers_m.shape}"
            )
        farthest_m = np.abs(centers_m - self.planned_m).max(initial=0.0)
        # Written so that NaN is refused as well.
        if not farthest_m <= self.resolution_m:
            raise WorldError(
                f"{self.name}: built_m must be within a cell of the plan,"
                f" got {farthest_m:g} m"
            )
        return _read_only(centers_m)

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max in m of all cells, the containment included."""
        width_m = self.rows * self.resolution_m
        if self.corner_m is not None:
            x_m, y_m = self.corner_m
            return x_m, y_m, x_m + width_m, y_m + self.cols * self.resolution_m

        columns = geometry.lead_in_cells(self.resolution_m) + self.cols
        return -width_m, 0.0, 0.0, columns * self.resolution_m

    def path_m(self, historical: bool = False) -> Points:
        """Return path cells' centers x, y (n, 2) in m; historical ones are shifted.

        Args:
            historical: Convert cells as the original tools do, which also placed the
                goals of the paper's trials: one cell too low in x and two thirds of a
                cell too low in y (0.15 and 0.10 m in a standard world). Arenas are not
                affected.
        """
        offset = (0.0, 0.0)
        if historical and self.corner_m is None:
            offset = (self.resolution_m, self.resolution_m * 2.0 / 3.0)
        return np.subtract(self.cell_centers_m(self.path), offset)

    def cell_centers_m(self, cells: Cells) -> Points:
        """Return x, y (n, 2) in m, map frame, of the centers of cells (row, column)."""
        if self.corner_m is None:
            return geometry.cell_centers(cells, self.rows, self.resolution_m)
        centers: Points = (cells + 0.5) * self.resolution_m + np.array(self.corner_m)
        return centers

    def containing_cells(self, points: Points) -> Cells:
        """Return row, column (n, 2) of the cells that contain points x, y in m.

        They may be outside the grid.
        """
        if self.corner_m is None:
            return geometry.containing_cells(points, self.rows, self.resolution_m)
        offsets = points - np.array(self.corner_m)
        cells: Cells = np.floor(offsets / self.resolution_m).astype(np.int64)
        return cells

    @cached_property
    def occupied(self) -> BoolGrid:
        """Mask (rows, cols), True where filled or where an arena's wall reaches in."""
        if self.corner_m is None:
            return self.grid
        return _read_only(self.occupancy_map().data.T > 0)

    @cached_property
    def tracks(self) -> Tracks:
        """Motions of the moving obstacles, which give positions at any time."""
        return Tracks(self.moving)

    @cached_property
    def path_length_m(self) -> float:
        """Length of the path in m over cell centers; a repeated cell adds nothing."""
        return float(side_lengths(self.path).sum() * self.resolution_m)

    def occupancy_map(
        self, resolution_m: float | None = None, *, historical: bool = False
    ) -> OccupancyMap:
        """Return a new map of grid, containment and walls, without what moves.

        Args:
            resolution_m: Size of the map's cells; by default that of the grid's.
            historical: Shift the grid as the maps of the original data set do
                (`worlds.cells.world_map`).
        """
        occupancy_map = geometry.world_map(
            self.grid,
            self.resolution_m,
            resolution_m,
            historical=historical,
            corner_m=self.corner_m,
        )
        for wall in self.walls:
            geometry.occupy_wall(occupancy_map, wall)
        return occupancy_map

    def resize(self, scale: float) -> "World":
        """Return an arena with cells, corner and ends scaled; not walls or movers."""
        start, goal = (
            pose and Pose2D(scale * pose.x, scale * pose.y, pose.yaw)
            for pose in (self.start, self.goal)
        )
        x_m, y_m = self.corner_m or (0.0, 0.0)
        return replace(
            self,
            resolution_m=scale * self.resolution_m,
            corner_m=(scale * x_m, scale * y_m),
            start=start,
            goal=goal,
        )

    @property
    def course_numbers(self) -> tuple[float, ...]:
        """x, y (m), yaw (rad) of start, then goal: 6 numbers, () without them."""
        if self.start is None or self.goal is None:
            return ()
        poses = (self.start, self.goal)
        return tuple(float(number) for pose in poses for number in pose.numbers)

    @cached_property
    def checksum(self) -> str:
        """SHA-256 (hex) of grid, path, course, walls, motions, built; no names."""
        digest = hashlib.sha256(
            np.array([self.rows, self.cols, self.footprint_cells], "<i8").tobytes()
        )
        digest.update(np.array([self.resolution_m], "<f8").tobytes())
        digest.update(np.packbits(self.grid).tobytes())
        digest.update(self.path.astype("<i8").tobytes())
        # Nothing is added for what a world does not have: checksums of older data sets
        # stay valid.
        places = [*(self.corner_m or ()), *self.course_numbers]
        digest.update(np.array(places, "<f8").tobytes())
        if self.walls or self.moving:
            digest.update(scene_content(self.walls, self.moving))
        if self.built_m is not None:
            digest.update(self.built_m.astype("<f8").tobytes())
        return digest.hexdigest()


def validate_grid(grid: object, where: str) -> BoolGrid:
    """Return a read-only copy as bools of a 2D grid; WorldError unless of 0 and 1.

    Args:
        grid: What should be a grid.
        where: Beginning of error messages, such as the name of a file.

    Raises:
        WorldError: If it is no such grid, or too large.
    """
    if not isinstance(grid, np.ndarray) or grid.ndim != 2:
        shape = getattr(grid, "shape", format_value(grid))
        raise WorldError(f"{where}: grid must be a two-dimensional array, got {shape}")
    if not all(1 <= side <= LARGEST_SIDE for side in grid.shape):
        raise WorldError(
            f"{where}: grid must be 1 to {LARGEST_SIDE} cells wide and long, "
            f"got {grid.shape}"
        )
    if grid.dtype.kind not in "biuf":
        raise WorldError(
            f"{where}: grid must hold zeros and ones, got values of type {grid.dtype}"
        )
    for row, column in np.argwhere((grid != 0) & (grid != 1)):
        raise WorldError(
            f"{where}: grid must hold zeros and ones, got {grid[row, column]} "
            f"in row {row}, column {column}"
        )
    return _read_only(grid.astype(np.bool_, copy=True))


def validate_path(path: object, grid: BoolGrid, where: str) -> Cells:
    """Return a read-only copy of a path (n, 2); WorldError unless free, adjoining.

    Args:
        path: What should be an array (n, 2) of rows and columns.
        grid: The grid that it leads through.
        where: Beginning of error messages, such as the name of a file.

    Raises:
        WorldError: If it is no such path.
    """
    if not isinstance(path, np.ndarray) or path.ndim != 2 or path.shape[1] != 2:
        shape = getattr(path, "shape", format_value(path))
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

    is_outside = ((path < 0) | (path >= np.array(grid.shape))).any(axis=1)
    for cell in path[is_outside]:
        raise WorldError(
            f"{where}: path leaves the grid of {grid.shape} at {cell.tolist()}"
        )

    cells = path.astype(np.int64)
    is_jump = (np.abs(np.diff(cells, axis=0)) > 1).any(axis=1)
    for step in np.flatnonzero(is_jump):
        first, second = cells[step : step + 2].tolist()
        raise WorldError(
            f"{where}: path must go from cell to neighboring cell, "
            f"got {first} then {second}"
        )
    rows, columns = cells.T
    for cell in cells[grid[rows, columns]]:
        raise WorldError(f"{where}: path goes through the filled cell {cell.tolist()}")
    return _read_only(cells)


def _read_only(array: _Array) -> _Array:
    """Forbid writing to an array, in place, and return the same array."""
    array.setflags(write=False)
    return array
