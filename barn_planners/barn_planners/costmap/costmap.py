"""Costmaps of the paper's planners by the rules of costmap_2d: obstacles marked by the lidar, inflated by the robot."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from barn_planners.costmap import inflation, kernels, layers
from barn_planners.costmap.config import (
    LARGEST_SIDE_M,
    MAX_CELLS,
    CostmapConfig,
    GlobalCostmapConfig,
)
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import OccupancyMap, Pose2D, Scan

CostArray = npt.NDArray[np.uint8]

FREE = 0
INSCRIBED = 253
LETHAL = 254

_BEYOND_M = 1.0  # of the goal that lies on a global costmap without a map
_EMPTY = (np.iinfo(np.int64).max, 0, np.iinfo(np.int64).max, 0)


class Beams:
    """Where the beams of a scan lead, in memory that is used again; the costmaps of one robot share it."""

    def __init__(self) -> None:
        self._key: tuple[float, float, float, int] | None = None
        self._directions, self._ends = np.empty((0, 2)), np.empty((0, 2), np.int64)

    def of(
        self, yaw: float, scan: Scan
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
        """Return the directions of a scan's beams for a lidar at this yaw, and work space for their ends, (n, 2)."""
        key = (yaw, scan.angle_min, scan.angle_increment, len(scan.ranges))
        if key != self._key:
            if len(self._ends) != len(scan.ranges):
                self._directions, self._ends = (
                    np.empty((key[3], 2)),
                    np.empty((key[3], 2), np.int64),
                )
            kernels.point_beams(
                self._directions, yaw, scan.angle_min, scan.angle_increment
            )
            self._key = key
        return self._directions, self._ends


class Costmap:
    """A fixed grid of costs, uint8 (rows, columns), row along y; `update` changes them in place. Nothing is off it."""

    def __init__(
        self,
        config: CostmapConfig,
        rows: int,
        cols: int,
        resolution: float,
        origin: tuple[float, float],
    ):
        if rows * cols > MAX_CELLS:
            raise ConfigError(
                f"a costmap must have at most {MAX_CELLS} cells, got {rows} x {cols}"
            )
        self.config = config
        self.resolution = resolution
        self.origin_x, self.origin_y = origin
        self.costs: CostArray = np.zeros((rows, cols), np.uint8)
        self._lethal: CostArray = np.zeros((rows, cols), np.uint8)
        self._dirty = np.array(_EMPTY, np.int64)
        self.beams = Beams()
        by_square = costs_by_square(config, resolution)
        self._inflated = (self.costs, by_square, squares_for(by_square))
        outline = config.padded_outline_m
        self.outline = (
            np.ascontiguousarray(outline[::-1]) if config.clockwise_outline else outline
        )
        self._cleared = self.outline if config.clear_footprint else np.empty((0, 2))
        if config.clear_footprint and config.as_costmap_2d and not config.footprint:
            self._cleared = outline[
                [2, 1, 0, 3]
            ]  # lines of cells differ by the end that they begin at

    @property
    def grid(self) -> tuple[float, float, float]:
        """Outer corner of the first cell, x and y, and side of a cell, in metres."""
        return self.origin_x, self.origin_y, self.resolution

    def update(self, pose: Pose2D, scan: Scan, lidar: Pose2D) -> None:
        """Add a scan, taken at `pose` of the robot (frame of the grid) by a lidar at its pose in base_link."""
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        x, y, yaw = (
            pose.x + lidar.x * c - lidar.y * s,
            pose.y + lidar.x * s + lidar.y * c,
            pose.yaw + lidar.yaw,
        )
        if not all(
            map(math.isfinite, (x, y, yaw, scan.angle_min, scan.angle_increment))
        ):
            return
        limits = (
            scan.range_min,
            scan.range_max,
            self.config.raytrace_range_m,
            self.config.obstacle_range_m,
        )
        changed = (
            self._lethal,
            self._dirty,
            *self._inflated,
            self.grid,
            (pose.x, pose.y, pose.yaw),
        )
        own = self.config.as_costmap_2d  # then beams are in the lidar's own frame
        directions, ends = self.beams.of(0.0 if own else yaw, scan)
        if own:
            seen = (
                (x, y, yaw),
                directions,
                scan.ranges,
                limits,
                self._cleared,
                self.config.inflates_by_front,
            )
            layers.observe(*changed, *seen)
        else:
            kernels.observe(
                *changed, (x, y), directions, ends, scan.ranges, limits, self._cleared
            )

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
        inflation.refresh(
            self._lethal, *self._inflated, self._dirty, self.config.inflates_by_front
        )

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return (row, column) of the cell of a point, which may lie off the grid."""
        return math.floor((y - self.origin_y) / self.resolution), math.floor(
            (x - self.origin_x) / self.resolution
        )

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

    def has_room(self, x: float, y: float, yaw: float) -> bool:
        """Tell whether the edges of the padded footprint at a pose (m, rad) are free and on the grid."""
        return bool(
            kernels.edge_cost(
                self.costs, kernels.placed(self.outline, x, y, yaw), *self.grid
            )
            >= 0
        )

    def as_map(self) -> OccupancyMap:
        """Return the costs as an occupancy grid for display: 0 free, 99 inscribed, 100 lethal, scaled between."""
        shown = np.minimum(self.costs.astype(np.int16) * 98 // 252, 98)
        shown[self.costs == INSCRIBED] = 99
        shown[self.costs == LETHAL] = 100
        return OccupancyMap(
            shown.astype(np.int8), self.resolution, self.origin_x, self.origin_y
        )


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
            # once the window is a whole cell off, on either side, from a corner that adds up its steps
            d_row = int(
                (pose.y - 0.5 * ((rows - 0.5) * self.resolution) - self.origin_y)
                / self.resolution
            )
            d_col = int(
                (pose.x - 0.5 * ((cols - 0.5) * self.resolution) - self.origin_x)
                / self.resolution
            )
            self.origin_x += d_col * self.resolution
            self.origin_y += d_row * self.resolution
            self._shift(d_row, d_col)
            return
        corner_row = math.floor(pose.y / self.resolution) - rows // 2
        corner_col = math.floor(pose.x / self.resolution) - cols // 2
        d_row = corner_row - round(self.origin_y / self.resolution)
        d_col = corner_col - round(self.origin_x / self.resolution)
        if self._placed and max(abs(d_row), abs(d_col)) < self.config.recentre_cells:
            return
        self.origin_x, self.origin_y = (
            corner_col * self.resolution,
            corner_row * self.resolution,
        )
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
        factor = (
            1
            if config.map_resolution
            else max(1, round(resolution / config.resolution_m))
        )
        rows, cols = known.data.shape[0] * factor, known.data.shape[1] * factor
        super().__init__(
            config, rows, cols, resolution / factor, (known.origin_x, known.origin_y)
        )
        self._marks = config.lidar_marks
        if config.static_layer:
            occupied = np.repeat(
                np.repeat(known.data >= 65, factor, axis=0), factor, axis=1
            )
            self._lethal[occupied] = kernels.STATIC
            self._dirty[:] = (0, rows, 0, cols)
            inflation.refresh(
                self._lethal,
                *self._inflated,
                self._dirty,
                self.config.inflates_by_front,
            )

    def update(self, pose: Pose2D, scan: Scan, lidar: Pose2D) -> None:
        """Add the scan, if lidar marks are configured."""
        if self._marks:
            super().update(pose, scan, lidar)


def global_costmap(
    config: GlobalCostmapConfig, known: OccupancyMap | None, goal: Pose2D
) -> Costmap:
    """Return the costmap of the global plan: on the map if there is one, else around the robot at the origin."""
    if known is not None:
        return MapCostmap(config, known)
    reach_m = (
        max(abs(goal.x), abs(goal.y))
        + (config.recentre_cells + 1) * config.resolution_m
        + _BEYOND_M
    )
    within_limits = (
        2.0 * reach_m <= LARGEST_SIDE_M
        and (2.0 * reach_m / config.resolution_m) ** 2 <= MAX_CELLS
    )
    return RollingCostmap(
        replace(config, size_m=max(config.size_m, 2.0 * reach_m))
        if within_limits
        else config
    )


def costs_by_square(config: CostmapConfig, resolution: float) -> CostArray:
    """Return the costs by the square of the distance d in cells to a lethal cell, uint8 ((n + 1)^2 + n^2 + 1,).

    254 at 0, 253 up to the inscribed radius r, then int(252 exp(-scaling (d - r))) up to the inflation radius.
    """
    soft = (
        math.ceil(config.inflation_radius_m / resolution - 1e-9)
        if config.soft_costs
        else 0
    )
    reach = max(soft, math.floor(config.inscribed_m / resolution + 1e-9))
    costs = np.zeros((reach + 1) ** 2 + reach**2 + 1, np.uint8)
    for row, col in np.ndindex(reach + 1, reach + 1):
        cells = math.hypot(row, col)
        beyond = cells * resolution - config.inscribed_m
        if beyond <= 1e-9:
            costs[row**2 + col**2] = INSCRIBED
        elif cells <= soft:
            costs[row**2 + col**2] = int(
                252.0 * math.exp(-config.cost_scaling_per_m * beyond)
            )
    costs[0] = LETHAL
    return costs


def squares_for(by_square: CostArray) -> npt.NDArray[np.unsignedinteger]:
    """Return the squares that inflation by the costs of `costs_by_square` needs, in a type that holds their sums."""
    squares = np.arange(math.isqrt((len(by_square) - 1) // 2) + 2, dtype=np.uint32) ** 2
    return (
        squares.astype(np.uint16)
        if 2 * squares[-1] <= np.iinfo(np.uint16).max
        else squares
    )
