"""Costmaps of the paper's planners: obstacles marked by the lidar, inflated by the robot's size.

The rules are those of costmap_2d's obstacle, static and inflation layers. Hits are marked up to one range and rays
clear up to another. Cells without a mark are free, and so is the robot's own footprint. The cost falls with the
distance between cell centres.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from barn_planners.costmap import inflation, kernels, layers
from barn_planners.navigation.outline import RULE, corners_of
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import OccupancyMap, Pose2D, Scan
from barn_worlds.geometry.polygon import grown, nearest_side_m

CostArray = npt.NDArray[np.uint8]

FREE = 0
INSCRIBED = 253
LETHAL = 254

_MAX_CELLS = 16_000_000
_LARGEST_M = 200.0
_BEYOND_M = 1.0  # of the goal that lies on a global costmap without a map
_EMPTY = (np.iinfo(np.int64).max, 0, np.iinfo(np.int64).max, 0)


@dataclass(frozen=True)
class CostmapConfig(Checked):
    """A costmap fed by a lidar; the defaults are the Jackal's local costmap."""

    resolution_m: float = quantity(0.05, "side of a cell", "m", minimum=0.005, maximum=1.0)
    size_m: float = quantity(10.0, "side of the square around the robot", "m", minimum=1.0, maximum=200.0)
    footprint_half_length_m: float = quantity(0.21, "half the robot's length", "m", minimum=0.01, maximum=5.0)
    footprint_half_width_m: float = quantity(0.165, "half the robot's width", "m", minimum=0.01, maximum=5.0)
    footprint_padding_m: float = quantity(0.1, "padding of the footprint on every side", "m", minimum=-0.1, maximum=2.0)
    inscribed_radius_m: float = quantity(
        0.0, "distance from an obstacle up to which a cell costs 253; 0: from the padded footprint", "m", minimum=0.0
    )
    inflation_radius_m: float = quantity(0.30, "cells further from any obstacle cost nothing", "m", minimum=0.0)
    cost_scaling_per_m: float = quantity(10.0, "rate at which the cost falls beyond the inscribed radius", "1/m")
    soft_costs: bool = quantity(True, "give cells between the inscribed and the inflation radius a cost below 253")
    obstacle_range_m: float = quantity(2.5, "hits nearer than this are marked", "m", minimum=0.0, maximum=100.0)
    raytrace_range_m: float = quantity(3.0, "rays clear up to this distance", "m", minimum=0.0, maximum=100.0)
    clear_footprint: bool = quantity(True, "clear the cells of the padded footprint")
    recentre_cells: int = quantity(1, "cells that the robot moves before the grid follows", minimum=1, maximum=1000)
    as_costmap_2d: bool = quantity(
        False,
        "true: rays, footprint and window are costmap_2d's, in its single precision: rays clear as many cells as the "
        "range has of the line to where they end, and a footprint partly off the grid is not cleared (a quirk)",
        optional=True,
    )
    footprint: str = quantity(
        "",
        "corners [[x, y], ...] of a convex outline, counter-clockwise, in place of the half sizes",
        "m",
        optional=True,
    )
    clockwise_outline: bool = quantity(
        False,
        "true: the footprint's edges are drawn clockwise, as configured for the original, which moves cells here and "
        "there",
        optional=True,
    )

    @property
    def inscribed_m(self) -> float:
        """The radius up to which a cell costs 253."""
        return self.inscribed_radius_m or self._padded_inscribed_m

    @property
    def _padded_inscribed_m(self) -> float:
        corners = self.padded_outline_m
        return nearest_side_m(corners.tolist()) if self.footprint else float(corners[0].min())

    @cached_property
    def padded_outline_m(self) -> npt.NDArray[np.float64]:
        """Corners (n, 2) of the padded footprint, counter-clockwise; those of a rectangle begin with the front left."""
        padding_m = self.footprint_padding_m
        corners = corners_of(self.footprint)
        if corners:
            return np.array(grown(corners, padding_m))
        return rectangle(self.footprint_half_length_m + padding_m, self.footprint_half_width_m + padding_m)

    @property
    def circumscribed_m(self) -> float:
        """The distance from the robot's centre to the furthest corner of the padded footprint."""
        return max(math.hypot(x, y) for x, y in self.padded_outline_m.tolist())

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(not self.footprint or corners_of(self.footprint) is not None, "footprint", RULE)
        self.require(self._padded_inscribed_m > 0.0, "footprint_padding_m", "must leave a footprint")
        cells = (self.size_m / self.resolution_m) ** 2
        few = f"must make at most {_MAX_CELLS} cells of {self.resolution_m:g} m"
        self.require(cells <= _MAX_CELLS, "size_m", few)


@dataclass(frozen=True)
class GlobalCostmapConfig(CostmapConfig):
    """The costmap of the global plan; without a map it rolls along with the robot."""

    size_m: float = quantity(
        40.0,
        "side of the square around the robot if there is no map; larger where the goal would be off it",
        "m",
        minimum=1.0,
        maximum=_LARGEST_M,
    )
    recentre_cells: int = quantity(50, "cells that the robot moves before the grid follows", minimum=1, maximum=1000)
    static_layer: bool = quantity(True, "use the obstacles of the map, if there is one")
    lidar_marks: bool = quantity(True, "mark what the lidar sees, even with a map")
    map_resolution: bool = quantity(False, "use the map's resolution instead of resolution_m")


class Beams:
    """The directions of a lidar's beams; costmaps of one robot may share them."""

    def __init__(self) -> None:
        self._key: tuple[float, float, float, int] | None = None
        self._directions = np.empty((0, 2))
        self.ends = np.empty((0, 2), np.int64)

    def directions(self, yaw: float, scan: Scan) -> npt.NDArray[np.float64]:
        """Return cosine and sine (n, 2) of the beams of a scan, taken by a lidar at this yaw."""
        key = (yaw, scan.angle_min, scan.angle_increment, len(scan.ranges))
        if key != self._key:
            if len(self.ends) != len(scan.ranges):
                self._directions = np.empty((len(scan.ranges), 2))
                self.ends = np.empty((len(scan.ranges), 2), np.int64)
            kernels.point_beams(self._directions, *key[:3])
            self._key = key
        return self._directions


class Costmap:
    """A fixed grid of costs. `costs` is uint8 (rows, columns), row along y; `origin` is the outer corner of cell 0, 0.

    `update` changes the array `costs` in place. Nothing is known off the grid. beams: shared by costmaps of one robot.
    """

    def __init__(self, config: CostmapConfig, rows: int, cols: int, resolution: float, origin: tuple[float, float]):
        if rows * cols > _MAX_CELLS:
            raise ConfigError(f"a costmap must have at most {_MAX_CELLS} cells, got {rows} x {cols}")
        self.config = config
        self.resolution = resolution
        self.origin_x, self.origin_y = origin
        self.costs: CostArray = np.zeros((rows, cols), np.uint8)
        self._lethal: CostArray = np.zeros((rows, cols), np.uint8)
        self._dirty = np.array(_EMPTY, np.int64)
        by_square = costs_by_square(config, resolution)
        self._inflated = (self.costs, by_square, squares_for(by_square))
        outline = config.padded_outline_m
        self.outline = np.ascontiguousarray(outline[::-1]) if config.clockwise_outline else outline
        self._cleared = self.outline if config.clear_footprint else np.empty((0, 2))
        if config.clear_footprint and config.as_costmap_2d and not config.footprint:
            self._cleared = outline[[2, 1, 0, 3]]  # lines of cells differ by the end that they begin at
        self._points = np.empty((0, 2), np.float32)
        self._ranges_m = (config.raytrace_range_m, config.obstacle_range_m)
        self.beams = Beams()

    @property
    def grid(self) -> tuple[float, float, float]:
        """Outer corner of the first cell, x and y, and side of a cell, in metres."""
        return self.origin_x, self.origin_y, self.resolution

    def update(self, pose: Pose2D, scan: Scan, lidar: Pose2D) -> None:
        """Add a scan, taken at `pose` of the robot (frame of the grid) by a lidar at its pose in base_link."""
        x, y, yaw = _place(pose, lidar)
        if not all(map(math.isfinite, (x, y, yaw, scan.angle_min, scan.angle_increment))):
            return
        limits = (scan.range_min, scan.range_max, *self._ranges_m)
        if self.config.as_costmap_2d:
            if len(self._points) != len(scan.ranges):
                self._points = np.empty((len(scan.ranges), 2), np.float32)
            seen = (self.beams.directions(0.0, scan), scan.ranges, limits, self._points)
            place = (self.grid, (pose.x, pose.y, pose.yaw), (x, y, yaw))
            layers.observe(self._lethal, self._dirty, *self._inflated, *place, *seen, self._cleared)
            return
        directions = self.beams.directions(yaw, scan)
        at = (self.grid, (pose.x, pose.y, pose.yaw), (x, y))
        scanned = (directions, scan.ranges, limits, self.beams.ends)
        kernels.observe(self._lethal, self._dirty, *self._inflated, *at, *scanned, self._cleared)

    def reset(self) -> None:
        """Clear all marks."""
        self.clear_outside(Pose2D(math.inf, math.inf, 0.0), 0.0)

    def clear_outside(self, pose: Pose2D, side_m: float) -> None:
        """Clear the marks outside a square of this side around the pose."""
        window = (0, 0, 0, 0)
        if math.isfinite(pose.x) and math.isfinite(pose.y):
            row, col = self.cell(pose.x - side_m / 2.0, pose.y - side_m / 2.0)
            end_row, end_col = self.cell(pose.x + side_m / 2.0, pose.y + side_m / 2.0)
            window = (row, end_row + 1, col, end_col + 1)
        kernels.clear_outside(self._lethal, self._dirty, *window)
        self._refresh()

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return (row, column) of the cell of a point, which may lie off the grid."""
        return math.floor((y - self.origin_y) / self.resolution), math.floor((x - self.origin_x) / self.resolution)

    def world_to_cell(self, x: float, y: float) -> tuple[int, int] | None:
        """Return (row, column) of the cell of a point in metres, None if it is off the grid or not finite."""
        if not (math.isfinite(x) and math.isfinite(y)):
            return None
        row, col = self.cell(x, y)
        rows, cols = self.costs.shape
        return (row, col) if 0 <= row < rows and 0 <= col < cols else None

    def cost_at(self, x: float, y: float) -> int | None:
        """Return the cost at a point in metres, None off the grid."""
        cell = self.world_to_cell(x, y)
        return None if cell is None else int(self.costs[cell])

    def footprint_spans(self, pose: Pose2D) -> tuple[int, npt.NDArray[np.int64]]:
        """Return the cells of the padded footprint: its first column, and first and last row (n, 2) of each column."""
        first, spans = kernels.footprint_spans(self._corners(pose.x, pose.y, pose.yaw), *self.grid)
        return first, spans

    def has_room(self, x: float, y: float, yaw: float) -> bool:
        """Tell whether the edges of the padded footprint at a pose (m, rad) are free and on the grid."""
        return bool(kernels.edge_cost(self.costs, self._corners(x, y, yaw), *self.grid) >= 0)

    def _corners(self, x: float, y: float, yaw: float) -> npt.NDArray[np.float64]:
        """Return the corners (n, 2) of the padded footprint at a pose."""
        corners: npt.NDArray[np.float64] = kernels.placed(self.outline, x, y, yaw)
        return corners

    def as_map(self) -> OccupancyMap:
        """Return the costs as an occupancy grid for display: 0 free, 99 inscribed, 100 lethal, scaled between."""
        shown = np.minimum(self.costs.astype(np.int16) * 98 // 252, 98)
        shown[self.costs == INSCRIBED] = 99
        shown[self.costs == LETHAL] = 100
        return OccupancyMap(shown.astype(np.int8), self.resolution, self.origin_x, self.origin_y)

    def _refresh(self) -> None:
        inflation.refresh(self._lethal, *self._inflated, self._dirty)


class RollingCostmap(Costmap):
    """A square grid that follows the robot in steps of whole cells; marks that leave it are lost."""

    def __init__(self, config: CostmapConfig):
        cells = round(config.size_m / config.resolution_m)
        super().__init__(config, cells, cells, config.resolution_m, (0.0, 0.0))
        self._placed = False

    def update(self, pose: Pose2D, scan: Scan, lidar: Pose2D) -> None:
        """Centre the grid on the robot, then add the scan."""
        if math.isfinite(pose.x) and math.isfinite(pose.y):
            self._follow(pose)
        super().update(pose, scan, lidar)

    def reset(self) -> None:
        """Clear all marks and the position of the grid."""
        super().reset()
        self._placed = False

    def _follow(self, pose: Pose2D) -> None:
        rows, cols = self.costs.shape
        if self.config.as_costmap_2d:
            self._follow_by_truncation(pose)
            return
        corner_row = math.floor(pose.y / self.resolution) - rows // 2
        corner_col = math.floor(pose.x / self.resolution) - cols // 2
        d_row = corner_row - round(self.origin_y / self.resolution)
        d_col = corner_col - round(self.origin_x / self.resolution)
        if self._placed and max(abs(d_row), abs(d_col)) < self.config.recentre_cells:
            return
        self.origin_x, self.origin_y = corner_col * self.resolution, corner_row * self.resolution
        self._shift(d_row, d_col)

    def _follow_by_truncation(self, pose: Pose2D) -> None:
        """Follow once the window is a whole cell off, on either side, from a corner that adds up its steps."""
        rows, cols = self.costs.shape
        d_row = int((pose.y - 0.5 * ((rows - 0.5) * self.resolution) - self.origin_y) / self.resolution)
        d_col = int((pose.x - 0.5 * ((cols - 0.5) * self.resolution) - self.origin_x) / self.resolution)
        self.origin_x += d_col * self.resolution
        self.origin_y += d_row * self.resolution
        self._shift(d_row, d_col)

    def _shift(self, d_row: int, d_col: int) -> None:
        if not self._placed:
            self._placed = True
        elif d_row or d_col:
            inflation.shift(self._lethal, *self._inflated, d_row, d_col)


class MapCostmap(Costmap):
    """The grid of a known map with its obstacles and, if configured, the marks of the lidar."""

    def __init__(self, config: GlobalCostmapConfig, known: OccupancyMap):
        # single precision, as in the message, so that a map gives the same cells before and after sending
        resolution = float(np.float32(known.resolution))
        factor = 1 if config.map_resolution else max(1, round(resolution / config.resolution_m))
        rows, cols = known.data.shape[0] * factor, known.data.shape[1] * factor
        super().__init__(config, rows, cols, resolution / factor, (known.origin_x, known.origin_y))
        self._lidar_marks = config.lidar_marks
        if config.static_layer:
            occupied = np.repeat(np.repeat(known.data >= 65, factor, axis=0), factor, axis=1)
            self._lethal[occupied] = kernels.STATIC
            self._dirty[:] = (0, rows, 0, cols)
            self._refresh()

    def update(self, pose: Pose2D, scan: Scan, lidar: Pose2D) -> None:
        """Add the scan, if lidar marks are configured."""
        if self._lidar_marks:
            super().update(pose, scan, lidar)


def rectangle(half_length_m: float, half_width_m: float) -> npt.NDArray[np.float64]:
    """Return the corners (4, 2) of a rectangle around base_link, front left first, counter-clockwise."""
    x, y = half_length_m, half_width_m
    return np.array([[x, y], [-x, y], [-x, -y], [x, -y]])


def global_costmap(config: GlobalCostmapConfig, known: OccupancyMap | None, goal: Pose2D) -> Costmap:
    """Return the costmap of the global plan: on the map if there is one, else around the robot at the origin."""
    if known is not None:
        return MapCostmap(config, known)
    reach_m = max(abs(goal.x), abs(goal.y)) + (config.recentre_cells + 1) * config.resolution_m + _BEYOND_M
    within_limits = 2.0 * reach_m <= _LARGEST_M and (2.0 * reach_m / config.resolution_m) ** 2 <= _MAX_CELLS
    return RollingCostmap(replace(config, size_m=max(config.size_m, 2.0 * reach_m)) if within_limits else config)


def cost_stamp(config: CostmapConfig, resolution: float) -> CostArray:
    """Return the costs around one lethal cell, uint8 (2 n + 1, 2 n + 1).

    The cost depends on the distance d between cell centres: 254 at 0, 253 up to the inscribed radius r, then
    int(252 exp(-scaling (d - r))) up to the inflation radius, rounded up to whole cells.
    """
    soft = math.ceil(config.inflation_radius_m / resolution - 1e-9) if config.soft_costs else 0
    reach = max(soft, math.floor(config.inscribed_m / resolution + 1e-9))
    stamp = np.zeros((2 * reach + 1, 2 * reach + 1), np.uint8)
    for row in range(-reach, reach + 1):
        for col in range(-reach, reach + 1):
            cells = math.hypot(row, col)
            beyond = cells * resolution - config.inscribed_m
            if beyond <= 1e-9:
                stamp[row + reach, col + reach] = INSCRIBED
            elif cells <= soft:
                stamp[row + reach, col + reach] = int(252.0 * math.exp(-config.cost_scaling_per_m * beyond))
    stamp[reach, reach] = LETHAL
    return stamp


def costs_by_square(config: CostmapConfig, resolution: float) -> CostArray:
    """Return the costs of `cost_stamp` by the square of the distance in cells, uint8 ((n + 1)^2 + n^2 + 1,)."""
    stamp = cost_stamp(config, resolution)
    reach = stamp.shape[0] // 2
    costs = np.zeros((reach + 1) ** 2 + reach**2 + 1, np.uint8)
    rows, cols = np.indices(stamp.shape) - reach
    costs[rows**2 + cols**2] = stamp
    return costs


def squares_for(by_square: CostArray) -> npt.NDArray[np.unsignedinteger]:
    """Return the squares that inflation by the costs of `costs_by_square` needs, in a type that holds their sums."""
    squares = np.arange(math.isqrt((len(by_square) - 1) // 2) + 2, dtype=np.uint32) ** 2
    return squares.astype(np.uint16) if 2 * squares[-1] <= np.iinfo(np.uint16).max else squares


def _place(pose: Pose2D, lidar: Pose2D) -> tuple[float, float, float]:
    """Return x, y and yaw of a lidar, at a pose in base_link, on a robot at a pose."""
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return pose.x + lidar.x * c - lidar.y * s, pose.y + lidar.x * s + lidar.y * c, pose.yaw + lidar.yaw
