"""Costmaps of the planners that follow a global plan, by the rules of costmap_2d."""

import math
from dataclasses import replace

import numpy as np

from barn_planners.costmap import inflation, kernels, obstacle_layer
from barn_planners.costmap.config import (
    LARGEST_SIDE_M,
    MAX_CELLS,
    CostmapConfig,
    GlobalCostmapConfig,
)
from barn_planners.costmap.kernels import (
    INSCRIBED,
    LETHAL,
    Grid,
    Pose,
    Window,
    corners_at,
    edge_cost,
)
from barn_worlds.base.arrays import Points
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import OccupancyMap, Pose2D, Scan

_BEYOND_GOAL_M = 1.0
_OCCUPIED_PERCENT = 65  # as map_server's occupied_thresh


class BeamDirections:
    """Unit vectors of a scan's beams; the costmaps of one robot share them."""

    def __init__(self) -> None:
        """Hold no directions yet; the first `at` computes them."""
        self._key: tuple[float, float, float, int] | None = None
        self._directions = np.empty((0, 2))

    def at(self, yaw: float, scan: Scan) -> Points:
        """Return unit vectors (n, 2) of a scan's beams, which the next call overwrites.

        Args:
            yaw: Heading of the lidar in the frame of the directions, in rad.
            scan: Scan whose angles count.

        Returns:
            Unit vectors (n, 2); the next call may overwrite them.
        """
        # A robot's costmaps mostly see one scan at one heading, one after the other.
        beams = len(scan.ranges)
        key = (yaw, scan.angle_min, scan.angle_increment, beams)
        if key != self._key:
            if len(self._directions) != beams:
                self._directions = np.empty((beams, 2))
            kernels.point_beams(
                self._directions, yaw, scan.angle_min, scan.angle_increment
            )
            self._key = key

        return self._directions


# Occupancy by cost. The product does not fit into 8 bits.
_OCCUPANCY = np.minimum(np.arange(256) * 98 // 252, 98).astype(np.int8)
_OCCUPANCY[INSCRIBED] = 99
_OCCUPANCY[LETHAL] = 100


class Costmap:
    """A fixed grid of costs; `update` changes them in place."""

    def __init__(
        self,
        config: CostmapConfig,
        rows: int,
        cols: int,
        resolution: float,
        origin: tuple[float, float],
    ):
        """Make a free grid from outer corner `origin` in m; ConfigError if too large.

        Rows lie along y, columns along x; `resolution` is the side of a cell in m.

        Raises:
            ConfigError: If the grid has more than `MAX_CELLS` cells.
        """
        if rows * cols > MAX_CELLS:
            raise ConfigError(
                f"a costmap must have at most {MAX_CELLS} cells, got {rows} x {cols}"
            )

        self.config = config
        self.resolution = resolution
        self.origin_x, self.origin_y = origin
        self.beams = BeamDirections()
        by_square = inflation.costs_by_square(config, resolution)
        self._layers = inflation.new_layers(rows, cols, by_square)
        self.costs = self._layers.costs  # (rows, columns), row along y

        outline = config.padded_outline_m
        self.outline = outline
        if config.clockwise_outline:
            self.outline = np.ascontiguousarray(outline[::-1])

        self._clearing_outline = self.outline
        if not config.clear_footprint:
            self._clearing_outline = np.empty((0, 2))
        elif config.as_costmap_2d and not config.footprint:
            # Cells of a line depend on its direction: costmap_2d starts rear right.
            self._clearing_outline = outline[[2, 1, 0, 3]]

    @property
    def grid(self) -> Grid:
        """Outer corner of cell (0, 0) and side of a cell, in m."""
        return Grid(self.origin_x, self.origin_y, self.resolution)

    def update(self, pose: Pose2D, scan: Scan, lidar: Pose2D) -> None:
        """Clear beams, mark hits, clear footprint, update costs; nothing if not finite.

        Args:
            pose: Pose of base_link in the frame of the grid when the scan was taken.
            scan: Scan of the lidar.
            lidar: Pose of the lidar in base_link.
        """
        config = self.config
        c = math.cos(pose.yaw)
        s = math.sin(pose.yaw)
        sensor = Pose(
            pose.x + lidar.x * c - lidar.y * s,
            pose.y + lidar.x * s + lidar.y * c,
            pose.yaw + lidar.yaw,
        )
        # Kernels turn coordinates into indices, which NaN has none of.
        if not all(map(math.isfinite, (*sensor, scan.angle_min, scan.angle_increment))):
            return

        # costmap_2d turns points instead of beams.
        yaw = 0.0 if config.as_costmap_2d else sensor.yaw
        readings = kernels.Readings(
            self.beams.at(yaw, scan),
            scan.ranges,
            scan.shortest_return_m,
            scan.range_max,
            config.raytrace_range_m,
            config.obstacle_range_m,
        )
        observe = obstacle_layer.observe if config.as_costmap_2d else kernels.observe
        observe(
            self._layers.marks,
            self.grid,
            Pose(*pose.numbers),
            sensor,
            readings,
            self._clearing_outline,
        )
        by_front = config.as_costmap_2d and config.inflates_by_front
        inflation.refresh(self._layers, by_front)

    def reset(self) -> None:
        """Clear all marks of the lidar and update costs; obstacles of a map stay."""
        self._clear_outside(Window(0, 0, 0, 0))

    def clear_outside(self, pose: Pose2D, side_m: float) -> None:
        """Clear lidar marks outside a square, all if it is not finite; update costs.

        Args:
            pose: Center of the square; all marks are cleared if it is not finite.
            side_m: Side of the square.
        """
        if not (math.isfinite(pose.x) and math.isfinite(pose.y)):
            self.reset()
            return

        half_m = side_m / 2.0
        # Marks inside the square stay: the robot has seen them from near.
        row, col = self.cell(pose.x - half_m, pose.y - half_m)
        last_row, last_col = self.cell(pose.x + half_m, pose.y + half_m)
        self._clear_outside(Window(row, last_row + 1, col, last_col + 1))

    def _clear_outside(self, window: Window) -> None:
        """Clear the lidar's marks outside a window of cells, and update costs."""
        kernels.clear_outside(self._layers.marks, window)
        inflation.refresh(self._layers, self.config.inflates_by_front)

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return the cell (row along y, column along x) of a point, also off the grid.

        Args:
            x: Coordinate in m in the frame of the grid; it must be finite, as `y`.
            y: Coordinate in m.
        """
        row = math.floor((y - self.origin_y) / self.resolution)
        col = math.floor((x - self.origin_x) / self.resolution)
        return row, col

    def world_to_cell(self, x: float, y: float) -> tuple[int, int] | None:
        """Return the cell (row along y, column along x) of a point, None off the grid.

        Args:
            x: Coordinate in m in the frame of the grid, as `y`.
            y: Coordinate in m.

        Returns:
            None off the grid or if a coordinate is not finite.
        """
        if not (math.isfinite(x) and math.isfinite(y)):
            return None

        row, col = self.cell(x, y)
        rows, cols = self.costs.shape
        if 0 <= row < rows and 0 <= col < cols:
            return row, col
        return None

    def cost_at(self, x: float, y: float) -> int | None:
        """Return the cost (0 to 254) at a point, None off the grid or if not finite.

        Args:
            x: Coordinate in m in the frame of the grid, as `y`.
            y: Coordinate in m.
        """
        cell = self.world_to_cell(x, y)
        return None if cell is None else int(self.costs[cell])

    def has_room(self, x: float, y: float, yaw: float) -> bool:
        """Return whether a footprint at a pose has edges on the grid, off lethal cells.

        Edges off the grid do not; what lies inside the edges does not count.

        Args:
            x: Position of base_link in m in the frame of the grid, as `y`.
            y: Position of base_link in m.
            yaw: Heading in rad.
        """
        corners = corners_at(self.outline, Pose(x, y, yaw))
        return edge_cost(self.costs, corners, self.grid) >= 0

    def as_map(self) -> OccupancyMap:
        """Return a copy of the costs as occupancy 0 to 100, as nav2_costmap_2d sends.

        Free cells are 0, inscribed ones 99 and lethal ones 100. Others are scaled to
        1..98.
        """
        data = _OCCUPANCY[self.costs]
        return OccupancyMap(data, self.resolution, self.origin_x, self.origin_y)


class RollingCostmap(Costmap):
    """A square grid that follows the robot in steps of whole cells.

    Marks that leave the grid are lost. The grid has no place before the first update.
    """

    def __init__(self, config: CostmapConfig):
        """Make a square grid of `size_m`, which the first `update` places."""
        cells = round(config.size_m / config.resolution_m)
        super().__init__(config, cells, cells, config.resolution_m, (0.0, 0.0))
        self._is_placed = False

    def update(self, pose: Pose2D, scan: Scan, lidar: Pose2D) -> None:
        """Let the grid follow the robot, then do what `Costmap.update` does.

        Args:
            pose: Pose of base_link in the frame of the grid when the scan was taken.
            scan: Scan of the lidar.
            lidar: Pose of the lidar in base_link.
        """
        if math.isfinite(pose.x) and math.isfinite(pose.y):
            if self.config.as_costmap_2d:
                self._follow_as_costmap_2d(pose)
            else:
                self._follow(pose)
        super().update(pose, scan, lidar)

    def reset(self) -> None:
        """Clear all marks; the next `update` places the grid anew."""
        super().reset()
        self._is_placed = False

    def _follow(self, pose: Pose2D) -> None:
        """Center the grid on the robot if unplaced or at least `recentre_cells` off."""
        rows, cols = self.costs.shape
        # Corners on multiples of the resolution keep cells in place on the ground.
        corner_row = math.floor(pose.y / self.resolution) - rows // 2
        corner_col = math.floor(pose.x / self.resolution) - cols // 2
        d_row = corner_row - round(self.origin_y / self.resolution)
        d_col = corner_col - round(self.origin_x / self.resolution)
        distance = max(abs(d_row), abs(d_col))
        if self._is_placed and distance < self.config.recentre_cells:
            return

        self.origin_x = corner_col * self.resolution
        self.origin_y = corner_row * self.resolution
        self._shift(d_row, d_col)

    def _follow_as_costmap_2d(self, pose: Pose2D) -> None:
        """Follow the robot by whole cells, truncated as in `Costmap2D::updateOrigin`.

        The cast to int lets the grid wait until it is a whole cell off on either side.
        Its size in meters leaves out half a cell, and the origin adds up its steps.
        """
        rows, cols = self.costs.shape
        # `getSizeInMetersX` of the original is (cells - 1 + 0.5) * resolution.
        corner_y = pose.y - 0.5 * ((rows - 0.5) * self.resolution)
        corner_x = pose.x - 0.5 * ((cols - 0.5) * self.resolution)
        d_row = int((corner_y - self.origin_y) / self.resolution)
        d_col = int((corner_x - self.origin_x) / self.resolution)
        self.origin_x += d_col * self.resolution
        self.origin_y += d_row * self.resolution
        self._shift(d_row, d_col)

    def _shift(self, d_row: int, d_col: int) -> None:
        """Move marks and costs by rows and columns; a new grid is only placed."""
        # Before the first update there is nothing on the grid to move.
        if self._is_placed and (d_row or d_col):
            inflation.shift(self._layers, d_row, d_col)
        self._is_placed = True


class MapCostmap(Costmap):
    """The grid of a map with its obstacles and, if configured, the lidar's marks."""

    def __init__(self, config: GlobalCostmapConfig, occupancy: OccupancyMap):
        """Make the grid of a map; with `static_layer`, mark cells of 65% and more.

        A map cell is split into as many cells as come nearest to `resolution_m`.
        """
        # Single precision, as in the message: a map gives the same cells before and
        # after sending.
        resolution = float(np.float32(occupancy.resolution))
        factor = 1
        if not config.map_resolution:
            factor = max(1, round(resolution / config.resolution_m))

        rows = occupancy.data.shape[0] * factor
        cols = occupancy.data.shape[1] * factor
        super().__init__(config, rows, cols, resolution / factor, occupancy.origin)
        self._lidar_marks = config.lidar_marks
        if config.static_layer:
            # Unknown cells (-1) are free, as in costmap_2d without track_unknown_space.
            occupied = occupancy.data >= _OCCUPIED_PERCENT
            occupied = occupied.repeat(factor, axis=0).repeat(factor, axis=1)
            self._layers.marks.cells[occupied] = kernels.STATIC
            self._layers.marks.bounds[:] = (0, rows, 0, cols)
            inflation.refresh(self._layers, config.inflates_by_front)

    def update(self, pose: Pose2D, scan: Scan, lidar: Pose2D) -> None:
        """Do what `Costmap.update` does, but nothing unless `lidar_marks` is set.

        Args:
            pose: Pose of base_link in the map frame when the scan was taken.
            scan: Scan of the lidar.
            lidar: Pose of the lidar in base_link.
        """
        if self._lidar_marks:
            super().update(pose, scan, lidar)


def global_costmap(
    config: GlobalCostmapConfig, occupancy: OccupancyMap | None, goal: Pose2D
) -> Costmap:
    """Return a new costmap of a map, or else a rolling one that reaches the goal.

    Args:
        config: Its configuration.
        occupancy: Map to plan on. Without one, the costmap rolls with the robot.
        goal: Goal of the trial in the planning frame. A rolling costmap is made large
            enough to contain it when the robot is at the origin, within limits.
    """
    if occupancy is not None:
        return MapCostmap(config, occupancy)

    reach_m = (
        max(abs(goal.x), abs(goal.y))
        + (config.recentre_cells + 1) * config.resolution_m
        + _BEYOND_GOAL_M
    )
    side_m = 2.0 * reach_m
    if side_m <= LARGEST_SIDE_M and (side_m / config.resolution_m) ** 2 <= MAX_CELLS:
        # Only larger, never smaller than configured, and not beyond what memory allows.
        config = replace(config, size_m=max(config.size_m, side_m))
    return RollingCostmap(config)
