"""Further features of a world, for models of difficulty, in meters.

They describe clearance, gaps and turning along its path.
"""

import math
from typing import Any

import numpy as np
from scipy import ndimage

from barn_metrics.metrics import tortuosity
from barn_worlds.base.arrays import (
    BoolGrid,
    Bools,
    Cells,
    Floats,
    side_lengths,
    strict_kernel,
)
from barn_worlds.base.types import wrap_angle
from barn_worlds.worlds.cells import hollow_cells
from barn_worlds.worlds.cspace import closest_obstacle
from barn_worlds.worlds.world import World

# A place with less clearance is narrow; fits a Jackal.
NARROW_CLEARANCE_M = 0.55
# Length of path over which a change of heading is one turn.
TURNING_WINDOW_M = 0.75


def world_features(world: World) -> dict[str, float]:
    """Return a world's features by name: clearance, gaps and turning along its path.

    Cells that the path repeats count once.
    """
    path = without_repeats(world.path)
    first_row, last_row = path[[0, -1], 0]
    lengths_m = side_lengths(path) * world.resolution_m
    clearance_m = path_clearance(world.grid, path, world.resolution_m)
    is_narrow = clearance_m < NARROW_CLEARANCE_M
    turning_rad = heading_changes(path)
    features = {
        "path_length_m": lengths_m.sum(),
        "tortuosity": tortuosity(path),
        # From start to goal across the driving direction.
        "lateral_shift_m": abs(last_row - first_row) * world.resolution_m,
        **_clearance_features(clearance_m),
        **_narrow_features(is_narrow, lengths_m),
        # Like the sum of a cost near obstacles.
        "inverse_clearance_mean_per_m": (1.0 / clearance_m).mean(),
        "widest_gap_m": widest_gap_m(world.grid, world.resolution_m),
        **_turning_features(turning_rad, lengths_m),
        "narrow_turning_rad": np.abs(turning_rad[is_narrow[1:-1]]).sum(),
        "filled_share": world.grid.mean(),
        "free_cspace_share": 1.0 - world.cspace.mean(),
    }
    return {name: float(value) for name, value in features.items()}


def _clearance_features(clearance_m: Floats) -> dict[str, Any]:
    """Return minimum, percentiles and mean of a path's clearance (n,) in m, by name."""
    percentiles = {
        f"clearance_p{percent:02}_m": np.percentile(clearance_m, percent)
        for percent in (5, 10, 25, 50)
    }
    return {
        "clearance_min_m": clearance_m.min(),
        **percentiles,
        "clearance_mean_m": clearance_m.mean(),
    }


def _narrow_features(is_narrow: Bools, lengths_m: Floats) -> dict[str, Any]:
    """Return share of narrow cells, number and longest of narrow stretches, by name.

    Args:
        is_narrow: Mask (n,) of the path's cells.
        lengths_m: Lengths (n - 1,) of its steps.
    """
    places_m = np.append(0.0, np.cumsum(lengths_m))
    labels, count = ndimage.label(is_narrow)
    longest_m = 0.0
    for (stretch,) in ndimage.find_objects(labels):
        longest_m = max(longest_m, np.ptp(places_m[stretch]))
    return {
        "narrow_share": is_narrow.mean(),
        "narrow_passages": count,
        "longest_narrow_m": longest_m,
    }


def _turning_features(turning_rad: Floats, lengths_m: Floats) -> dict[str, Any]:
    """Return total, mean per m and sharpest turning, turns and reversals, by name.

    Args:
        turning_rad: Changes of heading (n - 2,) at the inner cells of the path.
        lengths_m: Lengths (n - 1,) of its steps.
    """
    length_m = lengths_m.sum()
    total_rad = np.abs(turning_rad).sum()
    turns = turning_rad[turning_rad != 0.0]
    return {
        "turning_total_rad": total_rad,
        "turning_rad_per_m": total_rad / length_m if length_m > 0.0 else 0.0,
        "turning_sharpest_rad": sharpest_turn(turning_rad, lengths_m, TURNING_WINDOW_M),
        "turns": len(turns),
        # Turns to the other side than the turn before.
        "reversals": np.count_nonzero(np.diff(np.sign(turns))),
    }


def without_repeats(path: Cells) -> Cells:
    """Return a path (m, 2) without cells that equal the cell just before them."""
    is_step = (np.diff(path, axis=0) != 0).any(axis=1)
    distinct: Cells = path[np.append(True, is_step)]
    return distinct


def path_clearance(grid: BoolGrid, path: Cells, resolution_m: float) -> Floats:
    """Return the gap (n,) in m from path cells' centers to a cylinder or side edge.

    Args:
        grid: (rows, cols), True where a cylinder stands.
        path: Cells (n, 2).
        resolution_m: Size of a cell, and diameter of a cylinder.
    """
    rows, columns = path.T
    last_row = len(grid) - 1
    # From cell centers: an edge lies half a cell outside of the last row, and the
    # surface of a cylinder half a cell before its center.
    edge = np.minimum(rows, last_row - rows) + 0.5
    obstacle = closest_obstacle(grid)[rows, columns] - 0.5
    clearance: Floats = np.minimum(edge, obstacle) * resolution_m
    return clearance


def heading_changes(path: Cells) -> Floats:
    """Return turns (n - 2,) in rad at a path's inner cells, + toward higher rows."""
    steps = np.diff(path, axis=0)
    headings: Floats = np.arctan2(*steps.T)
    return wrap_angle(np.diff(headings))


def sharpest_turn(turning: Floats, lengths: Floats, window_m: float) -> float:
    """Return the largest net turn (rad, unsigned) within window_m; 0 for no turns.

    Args:
        turning: Changes of heading (n - 2,) at the inner cells of the path.
        lengths: Lengths (n - 1,) in m of its steps.
        window_m: Length of the window.
    """
    places_m = np.cumsum(lengths[:-1])
    headings = np.append(0.0, np.cumsum(turning))
    # The tolerance keeps a cell at the very end of a window in it.
    ends = np.searchsorted(places_m, places_m + window_m + 1e-9, side="right")
    turns_rad = (
        float(np.abs(headings[first + 1 : end + 1] - headings[first]).max())
        for first, end in enumerate(ends)
    )
    return max(turns_rad, default=0.0)


def widest_gap_m(grid: BoolGrid, resolution_m: float) -> float:
    """Return the bottleneck width (m) of the widest way through a grid; 0 if blocked.

    A disc is blocked if a chain of obstacles between the side edges has only gaps
    smaller than the disc. So this is the largest gap of a chain, minimized over all
    chains. It is 0 if touching obstacles block every path.

    Args:
        grid: (rows, cols), True where a cylinder stands.
        resolution_m: Size of a cell, and diameter of a cylinder.
    """
    # Hollow cells cannot be at the edge of a gap.
    centers = np.argwhere(grid & ~hollow_cells(grid)).astype(np.float64)
    return _widest_disc(centers, float(len(grid))) * resolution_m


@strict_kernel
def _widest_disc(centers: Floats, rows: float) -> float:
    """Return the diameter (cells) of the widest disc that gets through, at most `rows`.

    Args:
        centers: Of unit discs (n, 2), in cells.
        rows: Number of rows, whose outer edges lie half a cell beyond the first and
            last.
    """
    count = len(centers)
    best = rows
    # The largest gap on the way to each disc; at first from the upper edge.
    cost = centers[:, 0].copy()
    done = np.zeros(count, np.bool_)
    for _ in range(count):
        current = -1
        lowest = best
        for i in range(count):
            if not done[i] and cost[i] < lowest:
                current = i
                lowest = cost[i]
        if current < 0:
            break

        done[current] = True
        lower_edge = rows - 1.0 - centers[current, 0]
        best = min(best, max(lowest, lower_edge))
        for i in range(count):
            if not done[i]:
                row_offset = centers[i, 0] - centers[current, 0]
                column_offset = centers[i, 1] - centers[current, 1]
                gap = math.hypot(row_offset, column_offset) - 1.0
                cost[i] = min(cost[i], max(lowest, gap))
    return best
