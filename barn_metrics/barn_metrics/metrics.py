"""The five difficulty metrics of the BARN paper (section III-B) on the C-space, in cells; see docs/metrics.md."""

import math
from dataclasses import astuple, dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from barn_metrics import kernels
from barn_worlds.base.arrays import BoolGrid, Cells, Floats
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError, WorldError, suggest
from barn_worlds.worlds.world import World


@dataclass(frozen=True)
class Formula(Checked):
    """The variants on which the paper's text and its published numbers differ; the defaults are the corrected ones."""

    # corrected: every ray counts, a diagonal is sqrt 2; published: every cell is worth 1, rays that leave the
    # grid do not count, the mean over the rays is rounded down
    visibility: str = quantity(
        "corrected",
        "how lengths of rays are averaged",
        choices=("corrected", "published"),
    )
    # published: four of the eight in-between rays reach 6 cells far, the others 4; even: all of them 4; ordered: as
    # even, with the rays ordered by angle; the published order swaps two of them
    dispersion: str = quantity(
        "published", "rays and their order", choices=("published", "even", "ordered")
    )
    axes: int = quantity(
        4,
        "axes of the characteristic dimension: 4 (published) or 8 (the paper's text)",
        minimum=4,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
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
    """Return the formula of that name (a key of `FORMULAS`), or the formula itself; ConfigError names the near one."""
    if isinstance(formula, Formula):
        return formula
    if formula not in FORMULAS:
        raise ConfigError(f"unknown formula {formula!r}{suggest(formula, FORMULAS)}")
    return FORMULAS[formula]


@dataclass(frozen=True)
class Metric:
    """Name of a metric in code and files, its title for people, and its unit."""

    name: str
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
CELL_METRICS = METRICS[:4]  # defined for a single cell


@dataclass(frozen=True)
class WorldMetrics:
    """The metrics of one world, in the order of Table II: means over the cells of its path, and its tortuosity."""

    closest_obstacle: float
    average_visibility: float
    dispersion: float
    characteristic_dimension: float
    tortuosity: float

    def as_array(self) -> Floats:
        """Return the five values in the published order, (5,)."""
        return np.array(astuple(self), np.float64)


def cell_metrics(
    cspace: BoolGrid, cells: Cells, formula: Formula | str = CORRECTED
) -> Floats:
    """Return closest obstacle, average visibility, dispersion and characteristic dimension of cells, (n, 4).

    cspace: (rows, cols) bool, True where occupied; cells: (n, 2) row, column. Raises WorldError for cells that are
    outside or occupied, where the metrics are undefined. Without obstacles the closest one is infinitely far; the
    published visibility is NaN if no ray ends at an obstacle.
    """
    chosen = as_formula(formula)
    occupied, at = _checked(cspace, cells)
    rays = (
        kernels.ORDERED_RAYS if chosen.dispersion == "ordered" else kernels.SIXTEEN_RAYS
    )
    points = (
        kernels.PUBLISHED_POINTS
        if chosen.dispersion == "published"
        else kernels.EVEN_POINTS
    )
    axes = kernels.EIGHT_AXES if chosen.axes == 8 else kernels.FOUR_AXES
    see = (
        kernels.average_visibility
        if chosen.visibility == "corrected"
        else kernels.average_visibility_published
    )
    values = np.empty((len(at), len(CELL_METRICS)))
    values[:, 0] = closest_obstacle(occupied)[at[:, 0], at[:, 1]]
    values[:, 1] = see(occupied, at)
    values[:, 2] = kernels.dispersion(occupied, at, rays, points)
    values[:, 3] = kernels.characteristic_dimension(occupied, at, axes)
    return values


def closest_obstacle(cspace: BoolGrid) -> Floats:
    """Return the Euclidean distance in cells of every cell to the nearest occupied one, inf without any."""
    if not cspace.any():
        return np.full(cspace.shape, np.inf)
    distance: Floats = distance_transform_edt(~cspace)
    return distance


def tortuosity(path: Cells) -> float:
    """Return arc length over chord of a path (n, 2): 1 if it stays in one cell, inf if it returns to its start."""
    steps = np.diff(path, axis=0)
    arc = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
    chord = math.hypot(*(path[-1] - path[0]).tolist())
    if chord == 0.0:
        return 1.0 if arc == 0.0 else math.inf
    return arc / chord


def mean_metrics(values: Floats, path: Cells) -> WorldMetrics:
    """Return the metrics of a path (n, 2) from its `cell_metrics` (n, 4)."""
    closest, visibility, alternations, narrowest = (
        float(mean) for mean in values.mean(axis=0)
    )
    return WorldMetrics(closest, visibility, alternations, narrowest, tortuosity(path))


def world_metrics(world: World, formula: Formula | str = CORRECTED) -> WorldMetrics:
    """Return the metrics of a world on its own C-space and path."""
    return mean_metrics(world_cell_metrics(world, formula), world.path)


def world_cell_metrics(world: World, formula: Formula | str = CORRECTED) -> Floats:
    """Return `cell_metrics` (n, 4) of the path of a world; errors name the world. An arena is refused: it has walls."""
    if world.corner_m is not None:
        raise WorldError(
            f"{world.name}: is an arena; these metrics are of worlds whose obstacles stand on a grid"
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
    """Return each of the four cell metrics, by name, as a map (rows, cols); NaN in occupied cells."""
    free = np.argwhere(~cspace)
    values = cell_metrics(cspace, free, formula)
    maps = {}
    for column, metric in enumerate(CELL_METRICS):
        drawn = np.full(cspace.shape, np.nan)
        drawn[free[:, 0], free[:, 1]] = values[:, column]
        maps[metric.name] = drawn
    return maps


def _checked(cspace: object, cells: object) -> tuple[BoolGrid, Cells]:
    """Return both as contiguous arrays of the kernels' types; WorldError if they are malformed."""
    if (
        not isinstance(cspace, np.ndarray)
        or cspace.ndim != 2
        or cspace.dtype != np.bool_
    ):
        raise WorldError("C-space must be a two-dimensional array of bools")
    if (
        not isinstance(cells, np.ndarray)
        or cells.ndim != 2
        or cells.shape[1] != 2
        or cells.dtype.kind not in "iu"
    ):
        raise WorldError("path must be an array of whole rows and columns, (n, 2)")
    outside = ((cells < 0) | (cells >= np.array(cspace.shape))).any(axis=1)
    if outside.any():
        raise WorldError(
            f"path leaves the grid of {cspace.shape} at {cells[outside][0].tolist()}"
        )
    taken = cspace[cells[:, 0], cells[:, 1]]
    if taken.any():
        raise WorldError(
            f"path goes through the occupied C-space cell {cells[taken][0].tolist()}"
        )
    return np.ascontiguousarray(cspace), np.ascontiguousarray(cells, np.int64)
