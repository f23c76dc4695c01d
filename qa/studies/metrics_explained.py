"""Figures that explain the metrics on cells of a world (Figs. 2 to 4 of the paper)."""

import math

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Wedge
from world_metrics import label_cells, new_figure, show_cells

from barn_metrics import kernels
from barn_metrics.metrics import PAPER_TEXT, PUBLISHED, cell_metrics
from barn_worlds.base.arrays import BoolGrid, Cells, Integers
from barn_worlds.drawing.palette import BLUE, OBSTACLE, ORANGE, VERMILION
from barn_worlds.worlds.world import World

Cell = tuple[int, int]

_ZOOM_CELLS = 7
# of the circle of a dispersion, in cells
_RING_OUTER = 5.7
_RING_WIDTH = 0.8


def visibility_figure(world: World) -> Figure:
    """Show the rays of the path's cells with highest and lowest visibility (Fig. 2).

    There are eight rays, and the visibility is the average one.
    """
    figure = new_figure(640)
    cells = _inner_path(world)
    values = cell_metrics(world.cspace, cells)[:, 1]
    for axes, at, word in zip(
        figure.subplots(1, 2),
        (values.argmax(), values.argmin()),
        ("High", "Low"),
        strict=True,
    ):
        cell = _cell(cells[at])
        show_cells(axes, world.grid, world.cspace)
        for direction in kernels.EIGHT_RAYS:
            length, blocked = _ray(world.cspace, cell, direction)
            _line(
                axes,
                cell,
                direction,
                length + 0.5,
                VERMILION if blocked else BLUE,
                dashed=not blocked,
            )
        _mark(axes, cell)
        axes.set_title(
            f"{word}: average visibility {values[at]:.2f} cells", fontsize=10
        )
    _legend(figure, "ends at an obstacle of the C-space", "leaves the grid")
    return figure


def dispersion_figure(world: World) -> Figure:
    """Show the rays of two cells with few and many alternations (Fig. 3).

    These are the path's cell with fewest and the free cell with most; each has 16 rays.

    The rays shown are evenly sampled and ordered by angle; the titles also give the
    count of the published variant.
    """
    figure = new_figure(770)
    path = _inner_path(world)
    free = _free_cells_beside(world, path)
    low = _cell(path[cell_metrics(world.cspace, path, PAPER_TEXT)[:, 2].argmin()])
    high = _cell(free[cell_metrics(world.cspace, free, PAPER_TEXT)[:, 2].argmax()])
    for axes, cell, word in zip(
        figure.subplots(1, 2), (low, high), ("Low", "High"), strict=True
    ):
        ordered, published = (
            cell_metrics(world.cspace, np.array([cell]), f)[0, 2]
            for f in (PAPER_TEXT, PUBLISHED)
        )
        show_cells(axes, world.grid, world.cspace)
        _draw_circle(axes, world.cspace, cell)
        _mark(axes, cell)
        _zoom(axes, cell)
        axes.set_title(
            f"{word}: {ordered:.0f} alternations\npublished sampling and order: {published:.0f}",
            fontsize=10,
        )
    _legend(figure, "blocked", "open")
    return figure


def characteristic_dimension_figure(world: World) -> Figure:
    """Show the axes through two cells at one distance from an obstacle (Fig. 4).

    One of them is in a tight space.

    The tight one is the cell of the path whose average visibility exceeds its
    characteristic dimension most. The open one has the largest characteristic dimension
    among the cells just as close to an obstacle.
    """
    figure = new_figure(660)
    tight, spacious = _tight_and_open(world)
    for axes, cell, word in zip(
        figure.subplots(1, 2), (tight, spacious), ("Tight", "Open"), strict=True
    ):
        closest, visibility, _, narrowest = cell_metrics(
            world.cspace, np.array([cell])
        )[0]
        show_cells(axes, world.grid, world.cspace)
        _draw_axes(axes, world.cspace, cell)
        _mark(axes, cell)
        axes.set_title(
            f"{word}: characteristic dimension {narrowest:.2f}\n"
            f"closest obstacle {closest:.2f}, average visibility {visibility:.2f} cells",
            fontsize=10,
        )
    _legend(figure, "shortest axis", "other axes")
    return figure


def _inner_path(world: World) -> Cells:
    """Return the path's cells (n, 2) that are not near the open ends of the grid.

    All of them in a short world.
    """
    columns = world.path[:, 1]
    inner: Cells = world.path[
        (columns >= _ZOOM_CELLS) & (columns < world.cols - _ZOOM_CELLS)
    ]
    return inner if len(inner) else world.path


def _free_cells_beside(world: World, cells: Cells) -> Cells:
    """Return the free cells (m, 2) in the columns of some cells (n, 2)."""
    free = np.argwhere(~world.cspace)
    return free[np.isin(free[:, 1], cells[:, 1])]


def _tight_and_open(world: World) -> tuple[Cell, Cell]:
    cells = _inner_path(world)
    values = cell_metrics(world.cspace, cells)
    tight = (values[:, 1] - values[:, 3]).argmax()
    everywhere = _free_cells_beside(world, cells)
    metrics = cell_metrics(world.cspace, everywhere)
    spacious = np.where(metrics[:, 0] == values[tight, 0], metrics[:, 3], -1.0).argmax()
    return _cell(cells[tight]), _cell(everywhere[spacious])


def _draw_circle(axes: Axes, cspace: BoolGrid, cell: Cell) -> None:
    """Draw the sixteen rays with their sampled points and a numbered ring around them.

    The numbers count the alternations.
    """
    rays = kernels.ORDERED_RAYS
    points = kernels.EVEN_POINTS
    blocked = [
        kernels.ray_blocked(cspace, *cell, ray, count)
        for ray, count in zip(rays, points, strict=True)
    ]
    angles = np.unwrap(np.arctan2(rays[:, 0], rays[:, 1]))
    between = (angles + np.roll(angles, 1)) / 2.0
    between[0] -= math.pi
    edges = np.append(between, between[0] + 2.0 * math.pi)
    alternations = 0
    for k, ray in enumerate(rays):
        color = VERMILION if blocked[k] else BLUE
        _draw_sampled_ray(axes, cell, ray, points[k], color, dashed=not blocked[k])
        span = (math.degrees(edges[k]), math.degrees(edges[k + 1]))
        axes.add_patch(
            Wedge(
                cell[::-1], _RING_OUTER, *span, width=_RING_WIDTH, color=color, zorder=3
            )
        )
        if blocked[k] != blocked[k - 1]:
            alternations += 1
            _number(axes, cell, edges[k], alternations)


def _draw_sampled_ray(
    axes: Axes, cell: Cell, ray: Integers, points: int, color: str, *, dashed: bool
) -> None:
    at = np.array(cell) + np.arange(points + 1)[:, None] * ray
    axes.plot(
        at[:, 1],
        at[:, 0],
        color=color,
        linewidth=1.3,
        marker=".",
        linestyle="--" if dashed else "-",
    )


def _number(axes: Axes, cell: Cell, angle: float, number: int) -> None:
    """Put a number on the ring."""
    radius = _RING_OUTER - _RING_WIDTH / 2.0
    at = (cell[1] + radius * math.cos(angle), cell[0] + radius * math.sin(angle))
    axes.plot(
        *at,
        marker="o",
        markersize=14,
        color="white",
        markeredgecolor=OBSTACLE,
        zorder=4,
    )
    axes.annotate(
        str(number), at, ha="center", va="center_baseline", fontsize=8, zorder=5
    )


def _draw_axes(axes: Axes, cspace: BoolGrid, cell: Cell) -> None:
    """Draw the four axes through a cell, the shortest in front, with lengths."""
    lengths = []
    for down, right, step in kernels.EIGHT_AXES[:4]:
        ends = [
            _ray(cspace, cell, sign * np.array([down, right]))[0] for sign in (1, -1)
        ]
        lengths.append((sum(ends) * step, np.array([down, right]), ends))
    shortest = min(range(len(lengths)), key=lambda k: lengths[k][0])
    for k, (_, direction, ends) in enumerate(lengths):
        color = VERMILION if k == shortest else BLUE
        for sign, reach in zip((1, -1), ends, strict=True):
            _line(
                axes, cell, sign * direction, reach + 0.5, color, dashed=k != shortest
            )


def _ray(
    cspace: BoolGrid, cell: Cell, direction: npt.NDArray[np.generic]
) -> tuple[int, bool]:
    down, right = direction.tolist()
    count, blocked = kernels.free_cells(cspace, *cell, down, right)
    return int(count), bool(blocked)


def _line(
    axes: Axes,
    cell: Cell,
    direction: npt.NDArray[np.generic],
    reach: float,
    color: str,
    *,
    dashed: bool,
) -> None:
    down, right = direction.tolist()
    axes.plot(
        [cell[1], cell[1] + reach * right],
        [cell[0], cell[0] + reach * down],
        color=color,
        linewidth=2.0,
        linestyle="--" if dashed else "-",
        zorder=2 if dashed else 3,
    )


def _mark(axes: Axes, cell: Cell) -> None:
    axes.plot(
        cell[1],
        cell[0],
        marker="o",
        markersize=8,
        color=ORANGE,
        markeredgecolor="black",
        zorder=6,
    )


def _zoom(axes: Axes, cell: Cell) -> None:
    reach = _ZOOM_CELLS + 0.5
    axes.set(
        xlim=(cell[1] - reach, cell[1] + reach), ylim=(cell[0] + reach, cell[0] - reach)
    )
    axes.set_facecolor("#f4f4f4")
    label_cells(axes)


def _legend(figure: Figure, solid: str, dashed: str) -> None:
    lines = [
        Line2D([], [], color=VERMILION, linewidth=2.0, label=solid),
        Line2D([], [], color=BLUE, linewidth=2.0, linestyle="--", label=dashed),
    ]
    figure.legend(
        handles=lines, loc="outside lower center", ncols=2, fontsize=9, frameon=False
    )


def _cell(pair: npt.ArrayLike) -> Cell:
    row, column = (int(value) for value in np.asarray(pair))
    return row, column
