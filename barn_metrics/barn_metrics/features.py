"""Further features of a world, for models of difficulty: clearance, gaps and turning along its path, in metres."""

import math

import numpy as np
from numba import njit

from barn_metrics.metrics import closest_obstacle, tortuosity
from barn_worlds.base.arrays import BoolGrid, Bools, Cells, Floats
from barn_worlds.base.errors import ConfigError
from barn_worlds.worlds.cells import hollow_cells
from barn_worlds.worlds.world import World

NARROW_CLEARANCE_M = 0.55  # below which a place is narrow; fits a Jackal
TURNING_WINDOW_M = 0.75  # of path, over which a change of heading is one turn


def world_features(
    world: World, narrow_clearance_m: float = NARROW_CLEARANCE_M
) -> dict[str, float]:
    """Return the features of a world by name; cells that the path repeats count once. ConfigError below 0 m."""
    if not narrow_clearance_m >= 0.0:
        raise ConfigError(
            f"narrow_clearance_m must be at least 0 m, got {narrow_clearance_m}"
        )
    path = without_repeats(world.path)
    lengths = step_lengths(path, world.resolution_m)
    clearance = path_clearance(world.grid, path, world.resolution_m)
    narrow = clearance < narrow_clearance_m
    turning = heading_changes(path)
    total = float(np.abs(turning).sum())
    arc = float(lengths.sum())
    passages, longest = _stretches(narrow, lengths)
    return {
        "path_length_m": arc,
        "tortuosity": tortuosity(path),
        # Start to goal across the driving direction.
        "lateral_shift_m": abs(int(path[-1, 0]) - int(path[0, 0])) * world.resolution_m,
        # Distance from the path's cells to the surface of the nearest obstacle: lowest, percentiles and mean.
        "clearance_min_m": float(clearance.min()),
        **{
            f"clearance_p{k:02}_m": float(np.percentile(clearance, k))
            for k in (5, 10, 25, 50)
        },
        "clearance_mean_m": float(clearance.mean()),
        # Share of the path's cells with narrow clearance, and stretches of them.
        "narrow_share": float(narrow.mean()),
        "narrow_passages": float(passages),
        "longest_narrow_m": longest,
        "inverse_clearance_mean_per_m": float(
            (1.0 / clearance).mean()
        ),  # like the sum of a cost near obstacles
        "widest_gap_m": widest_gap_m(world.grid, world.resolution_m),
        # Changes of heading, without sign.
        "turning_total_rad": total,
        "turning_rad_per_m": total / arc if arc > 0.0 else 0.0,
        "turning_sharpest_rad": sharpest_turn(turning, lengths, TURNING_WINDOW_M),
        "turns": float(np.count_nonzero(turning)),
        "reversals": float(
            np.count_nonzero(np.diff(np.sign(turning[turning != 0.0])))
        ),  # to the other side
        "narrow_turning_rad": float(
            np.abs(turning[narrow[1:-1]]).sum()
        ),  # at cells with narrow clearance
        "filled_share": float(world.grid.mean()),
        "free_cspace_share": 1.0 - float(world.cspace.mean()),
    }


def without_repeats(path: Cells) -> Cells:
    """Return a path (n, 2) without the cells that repeat the one before, (m, 2)."""
    moved = np.append(True, (np.diff(path, axis=0) != 0).any(axis=1))
    kept: Cells = path[moved]
    return kept


def step_lengths(path: Cells, resolution_m: float) -> Floats:
    """Return the lengths in metres of the steps of a path (n, 2), (n - 1,)."""
    steps = np.diff(path, axis=0)
    lengths: Floats = np.hypot(steps[:, 0], steps[:, 1]) * resolution_m
    return lengths


def path_clearance(grid: BoolGrid, path: Cells, resolution_m: float) -> Floats:
    """Return the metres (n,) from a path's cells (n, 2) to the nearest cylinder of the grid or side edge."""
    rows = path[:, 0]
    edge = np.minimum(rows, len(grid) - 1 - rows) + 0.5
    obstacle = closest_obstacle(grid)[rows, path[:, 1]] - 0.5
    clearance: Floats = np.minimum(edge, obstacle) * resolution_m
    return clearance


def heading_changes(path: Cells) -> Floats:
    """Return the signed change of heading in radians at each inner cell of a path (n, 2), (n - 2,) or empty."""
    steps = np.diff(path, axis=0)
    headings = np.arctan2(steps[:, 0], steps[:, 1])
    changes: Floats = (np.diff(headings) + math.pi) % (2.0 * math.pi) - math.pi
    return changes


def sharpest_turn(turning: Floats, lengths: Floats, window_m: float) -> float:
    """Return the largest net change of heading (rad) within a window of a path; lengths: (n - 1,) m of its steps."""
    if len(turning) == 0:
        return 0.0
    at = np.cumsum(lengths[:-1])
    turned = np.append(0.0, np.cumsum(turning))
    last = np.searchsorted(at, at + window_m + 1e-9, side="right")
    return max(
        float(np.abs(turned[first + 1 : end + 1] - turned[first]).max())
        for first, end in enumerate(last)
    )


def widest_gap_m(grid: BoolGrid, resolution_m: float) -> float:
    """Return the narrowest gap, surface to surface in metres, of the widest way from the left to the right edge.

    A disc is blocked if a chain of obstacles between the side edges has only gaps smaller than it; so this is the
    largest gap of a chain, minimised over all chains. Zero if touching obstacles block every way.
    """
    centres = np.argwhere(grid & ~hollow_cells(grid)).astype(np.float64)
    return float(
        max(0.0, _smallest_largest_gap(centres, float(len(grid)))) * resolution_m
    )


@njit(cache=True)
def _smallest_largest_gap(centres: Floats, rows: float) -> float:
    """Return the least largest gap (cells) of a chain of unit discs (n, 2) from edge to edge, by Dijkstra's search."""
    count = len(centres)
    best = rows
    cost = centres[
        :, 0
    ].copy()  # of reaching each from the upper edge, which lies half a cell above row 0
    done = np.zeros(count, np.bool_)
    for _ in range(count):
        at, lowest = -1, best
        for i in range(count):
            if not done[i] and cost[i] < lowest:
                at, lowest = i, cost[i]
        if at < 0:
            break
        done[at] = True
        best = min(best, max(lowest, rows - 1.0 - centres[at, 0]))
        for i in range(count):
            if not done[i]:
                gap = (
                    math.hypot(
                        centres[i, 0] - centres[at, 0], centres[i, 1] - centres[at, 1]
                    )
                    - 1.0
                )
                cost[i] = min(cost[i], max(lowest, gap))
    return best


def _stretches(narrow: Bools, lengths: Floats) -> tuple[int, float]:
    """Return how many runs of narrow cells there are along the path, and the length in metres of the longest."""
    changes = np.diff(np.concatenate([[0], narrow.astype(np.int64), [0]]))
    first, end = np.flatnonzero(changes == 1), np.flatnonzero(changes == -1)
    along = np.append(0.0, np.cumsum(lengths))
    longest = float((along[end - 1] - along[first]).max()) if len(first) else 0.0
    return len(first), longest
