"""The picture of one world and the parts of all such figures.

It shows obstacles, C-space with path, and a map of each metric.

python qa/studies/world_metrics.py 105 world.png
python qa/studies/world_metrics.py 3 world.png --dataset mine.npz --formula published
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from barn_metrics.metrics import (
    CELL_METRICS,
    CORRECTED,
    METRICS,
    Formula,
    Metric,
    as_formula,
    metric_maps,
    world_metrics,
)
from barn_worlds.base.arrays import BoolGrid, Cells, Floats
from barn_worlds.base.files import write_bytes
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.drawing.files import figure_bytes
from barn_worlds.drawing.palette import OBSTACLE, ROUTE, UNKNOWN, WHITE
from barn_worlds.worlds.world import World

_CELLS = ListedColormap([WHITE, UNKNOWN, OBSTACLE])
WIDTH_PX = 1280
_DOTS_PER_INCH = 128
_PANEL_WIDTH_PX = 315
_PANEL_FRAME_PX = 110
_TITLE_PX = 30


def new_figure(height_px: int) -> Figure:
    """Return an empty figure, `WIDTH_PX` wide, with automatic layout."""
    return Figure(
        figsize=(WIDTH_PX / _DOTS_PER_INCH, height_px / _DOTS_PER_INCH),
        layout="constrained",
    )


def save(figure: Figure, file: Path) -> None:
    """Write a figure of that width as PNG; WorldError if that fails."""
    write_bytes(file, figure_bytes(figure, dots_per_inch=_DOTS_PER_INCH))


def show_cells(axes: Axes, filled: BoolGrid, cspace: BoolGrid | None = None) -> None:
    """Draw filled cells and, lighter, those that the C-space adds.

    The robot drives to the right.
    """
    levels = np.where(filled, 2, 0 if cspace is None else cspace.astype(np.int64))
    axes.imshow(levels, cmap=_CELLS, vmin=0, vmax=2, interpolation="nearest")
    label_cells(axes)


def label_cells(axes: Axes) -> None:
    """Label rows and columns with whole numbers."""
    axes.xaxis.set_major_locator(MaxNLocator(7, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(7, integer=True))
    axes.tick_params(labelsize=8, length=2)
    axes.set_xlabel("column", fontsize=8)
    axes.set_ylabel("row", fontsize=8)


def show_path(axes: Axes, path: Cells) -> None:
    """Draw a path (n, 2) of cells, with a disc at its start and a star at its goal."""
    rows, columns = path.T
    for color, width in ((WHITE, 3.4), (ROUTE, 1.8)):
        axes.plot(columns, rows, color=color, linewidth=width, solid_capstyle="round")
    look: Any = {"color": ROUTE, "markeredgecolor": WHITE, "clip_on": False}
    for end, marker, size in ((0, "o", 7), (-1, "*", 12)):
        axes.plot(columns[end], rows[end], marker=marker, markersize=size, **look)


def draw_world_figure(
    world: World, file: Path, formula: Formula | str = CORRECTED
) -> None:
    """Write the maps of a world as PNG, 1280 pixels wide.

    Raises:
        WorldError: If that fails or the world has no metrics.
    """
    save(world_figure(world, formula), file)


def world_figure(world: World, formula: Formula | str = CORRECTED) -> Figure:
    """Return the figure of a world.

    Obstacles, C-space with path, and the four metrics that cells have.
    """
    metric_formula = as_formula(formula)
    averages = asdict(world_metrics(world, metric_formula))
    figure = new_figure(_height_px(world))
    panels = figure.subplots(2, 3)
    show_cells(panels[0, 0], world.grid)
    filled = float(world.grid.mean())
    title = f"Obstacles\n{filled:.0%} of the cells filled"
    panels[0, 0].set_title(title, fontsize=9)
    _draw_cspace(panels[0, 1], world, averages["tortuosity"])
    maps = metric_maps(world.cspace, metric_formula)
    places = (panels[0, 2], *panels[1])
    for axes, metric in zip(places, CELL_METRICS, strict=True):
        draw_map(axes, metric, maps[metric.name])
        show_path(axes, world.path)
        axes.set_title(
            f"{metric.title}\npath mean {averages[metric.name]:.2f} {metric.unit}",
            fontsize=9,
        )
    figure.suptitle(
        f"{world.name}: {world.rows} x {world.cols} cells of {world.resolution_m:g} m, "
        f"robot {world.footprint_cells} x {world.footprint_cells} cells, visibility {metric_formula.visibility}, "
        f"dispersion {metric_formula.dispersion}, {metric_formula.axes} axes",
        fontsize=9,
        parse_math=False,
    )
    return figure


def _height_px(world: World) -> int:
    """Return the height at which two rows of panels fill the width, within limits."""
    panel = _PANEL_WIDTH_PX * world.rows / world.cols
    return round(
        _TITLE_PX
        + 2
        * (_PANEL_FRAME_PX + min(max(panel, _PANEL_WIDTH_PX / 3), 2 * _PANEL_WIDTH_PX))
    )


def draw_map(axes: Axes, metric: Metric, values: Floats) -> None:
    """Draw a metric's map (rows, cols) with its color bar.

    Occupied cells and undefined values are gray.
    """
    colors = matplotlib.colormaps["cividis"].with_extremes(bad=UNKNOWN)
    finite = values[np.isfinite(values)]
    top = float(finite.max()) if len(finite) and finite.max() > 0.0 else 1.0
    masked = np.ma.masked_invalid(values)
    norm = Normalize(0.0, top)
    ticks = None
    if metric.name == "dispersion":  # always even: every opening has two sides
        norm = BoundaryNorm(np.arange(-1.0, top + 2.0, 2.0), colors.N)
        ticks = np.arange(0.0, top + 1.0, 2.0)
    picture = axes.imshow(masked, cmap=colors, norm=norm, interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    bar = figure.colorbar(
        picture, cax=axes.inset_axes((1.03, 0.0, 0.05, 1.0)), ticks=ticks
    )
    bar.minorticks_off()
    bar.set_label(metric.unit, fontsize=8)
    bar.ax.tick_params(labelsize=8, length=2)


def _draw_cspace(axes: Axes, world: World, tortuosity: float) -> None:
    show_cells(axes, world.grid, world.cspace)
    ends = world.path[[0, -1]]
    axes.plot(ends[:, 1], ends[:, 0], color=ROUTE, linewidth=1.0, linestyle=":")
    show_path(axes, world.path)
    title = METRICS[4].title.lower()
    axes.set_title(
        f"C-space (gray) and path\n{title} {tortuosity:.2f}, {world.path_length_m:.2f} m",
        fontsize=9,
    )


@click.command()
@click.argument("number", type=int)
@click.argument("target", type=click.Path(path_type=Path))
@click.option("--dataset", default="barn300", show_default=True)
@click.option("--formula", default="corrected", show_default=True)
def main(number: int, target: Path, dataset: str, formula: str) -> None:
    """Draw a world of a data set."""
    draw_world_figure(open_dataset(dataset).load(number), target, formula)


if __name__ == "__main__":
    main()
