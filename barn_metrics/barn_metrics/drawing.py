"""Shared parts of the figures: colours, panels of cells, paths, and writing the file."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from barn_worlds.arrays import BoolGrid, Cells
from barn_worlds.render import write_png

# Okabe and Ito's palette, for every kind of colour vision; also distinguishable in grey.
BLUE, ORANGE, VERMILION = "#0072B2", "#E69F00", "#D55E00"
FREE, INFLATED, FILLED = "#ffffff", "#c9ced3", "#3b4046"
_CELLS = ListedColormap([FREE, INFLATED, FILLED])

WIDTH_PX = 1280
_DOTS_PER_INCH = 128


def new_figure(height_px: int) -> Figure:
    """Return an empty figure, `WIDTH_PX` wide, with automatic layout."""
    return Figure(figsize=(WIDTH_PX / _DOTS_PER_INCH, height_px / _DOTS_PER_INCH), layout="constrained")


def save(figure: Figure, file: Path) -> None:
    """Write a figure of that width as PNG; WorldError if that fails."""
    write_png(figure, file, _DOTS_PER_INCH, tight=False)


def show_cells(axes: Axes, filled: BoolGrid, cspace: BoolGrid | None = None) -> None:
    """Draw filled cells and, lighter, those that the C-space adds; the robot drives to the right."""
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


def bare(axes: Axes) -> None:
    """Remove ticks and labels."""
    axes.set(xticks=[], yticks=[], xlabel="", ylabel="")


def show_path(axes: Axes, path: Cells, colour: str = VERMILION) -> None:
    """Draw a path (n, 2) of cells, with a disc at its start and a star at its goal."""
    rows, columns = path[:, 0], path[:, 1]
    axes.plot(columns, rows, color="white", linewidth=3.4, solid_capstyle="round")
    axes.plot(columns, rows, color=colour, linewidth=1.8, solid_capstyle="round")
    for end, marker, size in ((0, "o", 7), (-1, "*", 12)):
        axes.plot(
            columns[end],
            rows[end],
            marker=marker,
            markersize=size,
            color=colour,
            markeredgecolor="white",
            clip_on=False,
        )


def plain(text: str) -> str:
    """Escape dollar signs, so that a name is not rendered as a formula."""
    return text.replace("$", r"\$")
