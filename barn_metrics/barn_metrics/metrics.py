"""The five difficulty metrics of the BARN paper (Sec. III-B), on the C-space, in cells.

docs/metrics.md explains them.
"""

import math
from dataclasses import astuple, dataclass

import numpy as np

from barn_metrics import kernels
from barn_worlds.base.arrays import BoolGrid, Cells, Floats, side_lengths
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError, WorldError, suggest
from barn_worlds.worlds.cspace import closest_obstacle
from barn_worlds.worlds.world import World


@dataclass(frozen=True)
class Formula(Checked):
    """The variants on which the paper's text and its published numbers differ.

    The defaults are the corrected ones.
    """

    # corrected: Every ray counts, and a diagonal step is sqrt 2 long.
    # published: Every cell is worth 1, rays that leave the grid do not count, and the
    # mean over the rays is rounded down.
    visibility: str = quantity(
        "corrected",
        "method of averaging the lengths of rays",
        choices=("corrected", "published"),
    )
    # published: Four of the eight in-between rays reach 6 cells far, the others 4.
    # even: All of them reach 4. ordered: As even, with the rays ordered by angle; the
    # published order swaps two of them.
    dispersion: str = quantity(
        "published", "rays and their order", choices=("published", "even", "ordered")
    )
    axes: int = quantity(
        4,
        "axes of the characteristic dimension: 4 (published) or 8 (the paper's text)",
        minimum=4,
    )

    def check_rules(self) -> None:
        """Raise ConfigError unless axes is 4 or 8."""
        self.require(self.axes in (4, 8), "axes", "must be 4 or 8")


PUBLISHED = Formula(visibility="published")
CORRECTED = Formula()
PAPER_TEXT = Formula(dispersion="ordered", axes=8)

FORMULAS: dict[str, Formula] = {
    "published": PUBLISHED,
    "corrected": CORRECTED,
    "paper_text": PAPER_TEXT,
}


def as_formula(formula: Formula | str) -> Formula:
    """Return the formula of a name, or a `Formula` unchanged; ConfigError if unknown.

    Raises:
        ConfigError: If the name is unknown.
    """
    if isinstance(formula, Formula):
        return formula
    if formula not in FORMULAS:
        raise ConfigError(f"unknown formula {formula!r}{suggest(formula, FORMULAS)}")
    return FORMULAS[formula]


@dataclass(frozen=True)
class Metric:
    """A difficulty metric of worlds."""

    # In code and files.
    name: str
    # For people.
    title: str
    unit: str


METRICS = (
    Metric("closest_obstacle", "Distance to closest obstacle", "cells"),
    Metric("average_visibility", "Average visibility", "cells"),
    Metric("dispersion", "Dispersion", "alternations"),
    Metric("characteristic_dimension", "Characteristic dimension", "cells"),
    Metric("tortuosity", "Tortuosity", "arc / chord"),
)
METRIC_NAMES = tuple(metric.name for metric in METRICS)
# Defined for a single cell.
CELL_METRICS = METRICS[:4]


@dataclass(frozen=True)
class WorldMetrics:
    """The metrics of one world in the order of Table II, means over its path."""

    closest_obstacle: float
    average_visibility: float
    dispersion: float
    characteristic_dimension: float
    # Of the whole path.
    tortuosity: float

    def as_array(self) -> Floats:
        """Return the five metrics in the order of Table II, (5,)."""
        return np.array(astuple(self), np.float64)


def cell_metrics(
    cspace: BoolGrid, cells: Cells, formula: Formula | str = CORRECTED
) -> Floats:
    """Return the four metrics (n, 4) of C-space cells; WorldError if one is not free.

    Without obstacles the closest one is infinitely far. The published visibility is NaN
    if no ray ends at an obstacle.

    Args:
        cspace: (rows, cols), True where occupied.
        cells: (n, 2) row and column.
        formula: A key of `FORMULAS`, or variants of your own.

    Returns:
        (n, 4) in the order of `CELL_METRICS`.

    Raises:
        WorldError: If a cell is outside or occupied, where metrics are undefined.
    """
    formula = as_formula(formula)
    occupied, cells = _validate_cells(cspace, cells)

    visibility = kernels.average_visibility
    if formula.visibility == "published":
        visibility = kernels.average_visibility_published
    rays = kernels.SIXTEEN_RAYS
    if formula.dispersion == "ordered":
        rays = kernels.ORDERED_RAYS
    points = kernels.EVEN_POINTS
    if formula.dispersion == "published":
        points = kernels.PUBLISHED_POINTS
    axes = kernels.EIGHT_AXES[: formula.axes]

    rows, columns = cells.T
    return np.column_stack(
        [
            closest_obstacle(occupied)[rows, columns],
            visibility(occupied, cells),
            kernels.dispersion(occupied, cells, rays, points),
            kernels.characteristic_dimension(occupied, cells, axes),
        ]
    )


def tortuosity(path: Cells) -> float:
    """Return a path's arc over chord (>= 1), 1 within one cell, inf for a loop."""
    arc = float(side_lengths(path).sum())
    row_chord, column_chord = (path[-1] - path[0]).tolist()
    chord = math.hypot(row_chord, column_chord)
    if chord == 0.0:
        return 1.0 if arc == 0.0 else math.inf
    return arc / chord


def mean_metrics(values: Floats, path: Cells) -> WorldMetrics:
    """Return a world's five metrics: means of cell metrics (n, 4), path's tortuosity.

    Args:
        values: `cell_metrics` (n, 4) of its cells.
        path: The cells (n, 2).
    """
    closest, visibility, alternations, dimension = values.mean(axis=0).tolist()
    return WorldMetrics(closest, visibility, alternations, dimension, tortuosity(path))


def world_metrics(world: World, formula: Formula | str = CORRECTED) -> WorldMetrics:
    """Return a world's five metrics, means over its path; WorldError for an arena.

    Args:
        world: A world whose obstacles stand on a grid, no arena.
        formula: A key of `FORMULAS`, or variants of your own.

    Raises:
        WorldError: If the world is an arena, or its path meets the C-space.
    """
    return mean_metrics(world_cell_metrics(world, formula), world.path)


def world_cell_metrics(world: World, formula: Formula | str) -> Floats:
    """Return a path's cell metrics (n, 4); WorldError for an arena or a blocked path.

    Args:
        world: A world whose obstacles stand on a grid, no arena.
        formula: A key of `FORMULAS`, or variants of your own.

    Raises:
        WorldError: If the world is an arena, or its path meets the C-space.
    """
    if world.corner_m is not None:
        raise WorldError(
            f"{world.name}: is an arena or a map with a course of its own; metrics and "
            "difficulty need a world in BARN's layout"
        )
    try:
        return cell_metrics(world.cspace, world.path, formula)
    except WorldError as error:
        raise WorldError(
            f"{world.name}: {error} (footprint {world.footprint_cells} cells)"
        ) from None


def metric_maps(
    cspace: BoolGrid, formula: Formula | str = CORRECTED
) -> dict[str, Floats]:
    """Return the four cell metrics by name as arrays (rows, cols), NaN where occupied.

    Args:
        cspace: (rows, cols), True where occupied.
        formula: A key of `FORMULAS`, or variants of your own.

    Returns:
        Maps (rows, cols), NaN in occupied cells.
    """
    maps = np.full((len(CELL_METRICS), *cspace.shape), np.nan)
    # Metrics of occupied cells are undefined.
    maps[:, ~cspace] = cell_metrics(cspace, np.argwhere(~cspace), formula).T
    names = [metric.name for metric in CELL_METRICS]
    return dict(zip(names, maps, strict=True))


def _validate_cells(cspace: BoolGrid, cells: Cells) -> tuple[BoolGrid, Cells]:
    """Return both as contiguous arrays; WorldError if malformed, occupied, outside."""
    is_grid = isinstance(cspace, np.ndarray) and cspace.ndim == 2
    if not is_grid or cspace.dtype != np.bool_:
        raise WorldError("C-space must be a two-dimensional array of bools")
    is_table = isinstance(cells, np.ndarray) and cells.shape[1:] == (2,)
    if not is_table or cells.dtype.kind not in "iu":
        raise WorldError("path must be an array of whole rows and columns, (n, 2)")

    is_outside = ((cells < 0) | (cells >= np.array(cspace.shape))).any(axis=1)
    for cell in cells[is_outside]:
        raise WorldError(f"path leaves the grid of {cspace.shape} at {cell.tolist()}")
    rows, columns = cells.T
    for cell in cells[cspace[rows, columns]]:
        raise WorldError(f"path goes through the occupied C-space cell {cell.tolist()}")
    return np.ascontiguousarray(cspace), np.ascontiguousarray(cells, np.int64)
