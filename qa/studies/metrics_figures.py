"""Draw the figures of docs/metrics.md and print its tables.

Usage: python qa/studies/metrics_figures.py docs/figures.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from metrics_explained import (
    characteristic_dimension_figure,
    dispersion_figure,
    visibility_figure,
)
from world_metrics import new_figure, save, show_cells, show_path, world_figure

from barn_metrics.metrics import CORRECTED, METRIC_NAMES, METRICS, PUBLISHED, Formula
from barn_metrics.report import TABLE_II, MetricsTable, metrics_table
from barn_worlds.base.errors import BarnError
from barn_worlds.base.files import markdown_table
from barn_worlds.datasets.dataset import Dataset, open_dataset
from barn_worlds.datasets.generate import WorldParameters, automaton_grids
from barn_worlds.drawing.palette import BLUE, ORANGE, VERMILION
from barn_worlds.worlds.world import World

FIG_1 = WorldParameters(
    initial_fill=0.35, smoothing_iterations=3, fill_threshold=5, clear_threshold=1
)
_FIG_1_SEED = 1
_EXAMPLE_RANKS = (
    0.05,
    0.35,
    0.65,
    0.95,
)  # positions of the example worlds in the data set's order
_METRICS_RANK = 0.35
# Published values by the name of the field of
# `barn_worlds.datasets.generate.WorldParameters`; each combination was repeated.
TABLE_I: dict[str, tuple[float, ...]] = {
    "initial_fill": (0.15, 0.20, 0.25, 0.30),
    "smoothing_iterations": (2, 3, 4),
    "fill_threshold": (5,),
    "clear_threshold": (1,),
}
REPETITIONS = 25

_VARIANTS = (
    ("average_visibility", "published", PUBLISHED),
    ("average_visibility", "corrected", CORRECTED),
    ("dispersion", "published", CORRECTED),
    ("dispersion", "even", Formula(dispersion="even")),
    ("dispersion", "ordered", Formula(dispersion="ordered")),
    ("characteristic_dimension", "4 axes", CORRECTED),
    ("characteristic_dimension", "8 axes", Formula(axes=8)),
)


def draw_documentation_figures(folder: Path, dataset: Dataset) -> tuple[Path, ...]:
    """Write every figure of docs/metrics.md into a folder and return the files.

    dataset: source of the example worlds, numbered by rising difficulty.

    Raises:
        WorldError: If one cannot be written.
    """
    middle = _at_rank(dataset, _METRICS_RANK)
    figures: dict[str, Callable[[], Figure]] = {
        "automaton": automaton_figure,
        "average_visibility": lambda: visibility_figure(middle),
        "dispersion": lambda: dispersion_figure(middle),
        "characteristic_dimension": lambda: characteristic_dimension_figure(middle),
        "world_metrics": lambda: world_figure(middle),
        "example_worlds": lambda: example_worlds_figure(
            [_at_rank(dataset, rank) for rank in _EXAMPLE_RANKS]
        ),
        "metrics_distribution": lambda: distribution_figure(
            metrics_table(dataset, PUBLISHED), dataset.name
        ),
    }
    files = []
    for name, draw in figures.items():
        files.append(folder / f"{name}.png")
        save(draw(), files[-1])
    return tuple(files)


def automaton_figure(
    parameters: WorldParameters = FIG_1, seed: int = _FIG_1_SEED
) -> Figure:
    """Show the random grid and the grid after each smoothing iteration (Fig. 1)."""
    grids = list(automaton_grids(parameters, np.random.default_rng(seed)))
    figure = new_figure(405)
    for k, (axes, grid) in enumerate(
        zip(figure.subplots(1, len(grids)), grids, strict=True)
    ):
        show_cells(axes, grid)
        axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
        step = "Random fill" if k == 0 else f"Iteration {k}"
        axes.set_title(f"{step}\n{grid.mean():.0%} filled", fontsize=10)
    return figure


def example_worlds_figure(worlds: Iterable[World]) -> Figure:
    """Show worlds side by side, with their C-space, path and path length."""
    world_list = list(worlds)
    figure = new_figure(400)
    for axes, world in zip(
        np.atleast_1d(figure.subplots(1, len(world_list))), world_list, strict=True
    ):
        show_cells(axes, world.grid, world.cspace)
        show_path(axes, world.path)
        axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
        axes.set_title(
            f"{world.name}\npath {world.path_length_m:.2f} m",
            fontsize=10,
            parse_math=False,
        )
    return figure


def distribution_figure(table: MetricsTable, name: str) -> Figure:
    """Show the distribution of each metric with its mean and Table II's."""
    figure = new_figure(400)
    values = table.values
    panels = figure.subplots(1, len(METRICS))
    for k, (axes, metric) in enumerate(zip(panels, METRICS, strict=True)):
        published = TABLE_II[metric.name]
        low = published["mean"] - published["std"]
        high = published["mean"] + published["std"]
        axes.hist(values[:, k], bins=20, color=BLUE, zorder=2)
        axes.axvspan(low, high, color=ORANGE, alpha=0.3, zorder=1)
        axes.axvline(
            published["mean"],
            color=ORANGE,
            linewidth=2.2,
            zorder=3,
            label="Table II, mean and std.",
        )
        axes.axvline(
            values[:, k].mean(),
            color=VERMILION,
            linewidth=2.2,
            linestyle="--",
            zorder=4,
            label=f"{name}, mean",
        )
        axes.set_title(
            metric.title.replace("closest", "closest\n").replace(" dim", "\ndim"),
            fontsize=9,
        )
        axes.set_xlabel(metric.unit, fontsize=8)
        axes.tick_params(labelsize=8, length=2)
    panels[0].set_ylabel("worlds", fontsize=8)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=2, fontsize=9, frameon=False
    )
    return figure


def table_i(dataset: Dataset) -> str:
    """Return Table I as Markdown.

    The published parameters and those of a data set's worlds.
    """
    parameter_sets = [
        dataset.load(index).provenance.parameters for index in dataset.world_numbers
    ]
    keys = [tuple(sorted(parameters.items())) for parameters in parameter_sets]
    repetitions = Counter(keys)
    rows = []
    for name, published in TABLE_I.items():
        ours = {parameters.get(name, "not recorded") for parameters in parameter_sets}
        rows.append(
            [name.replace("_", " "), _join_values(published), _join_values(ours)]
        )
    counts = _join_values(set(repetitions.values()))
    rows.append(["repetitions", str(REPETITIONS), counts])
    return markdown_table(["Parameter", "Published", dataset.name], rows)


def _join_values(values: Iterable[object]) -> str:
    return ", ".join(
        f"{value:.2f}" if isinstance(value, float) else str(value)
        for value in sorted(values, key=str)
    )


def table_ii(table: MetricsTable) -> str:
    """Return Table II as Markdown: published / ours in each column."""
    rows = []
    for metric in METRICS:
        published = TABLE_II[metric.name]
        ours = table.summary_of(metric)
        # The extremes are of cells, for tortuosity of paths.
        ours |= {
            name: ours.get(f"cell_{name}", ours[name])
            for name in ("minimum", "maximum")
        }
        pairs = [f"{published[name]:.2f} / {ours[name]:.2f}" for name in published]
        rows.append([metric.title, *pairs])
    return markdown_table(["Metric", "Min.", "Max.", "Mean", "Std."], rows)


def variants_table(dataset: Dataset) -> str:
    """Return a Markdown table of mean and standard deviation per metric and variant."""
    rows = []
    for name, variant, formula in _VARIANTS:
        metric = METRICS[METRIC_NAMES.index(name)]
        ours = metrics_table(dataset, formula).summary_of(metric)
        rows.append(
            [metric.title, variant, f"{ours['mean']:.2f}", f"{ours['std']:.2f}"]
        )
    return markdown_table(["Metric", "Variant", "Mean", "Std."], rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the figures of docs/metrics.md and print its tables."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument(
        "folder", type=Path, help="where the figures go, such as docs/figures"
    )
    parser.add_argument(
        "--dataset",
        default="barn300",
        help="a shipped data set, file or folder (default: barn300)",
    )
    options = parser.parse_args(arguments)
    try:
        dataset = open_dataset(options.dataset)
        files = draw_documentation_figures(options.folder, dataset)
        tables = (
            table_i(dataset),
            table_ii(metrics_table(dataset, PUBLISHED)),
            variants_table(dataset),
        )
    except BarnError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(*files, *tables, sep="\n\n")
    return 0


def _at_rank(dataset: Dataset, share: float) -> World:
    """Return the world at a position in a data set's order.

    0 is the first, 1 the last.
    """
    indices = dataset.world_numbers
    rank = round(share * (len(indices) - 1))
    return dataset.load(indices[rank])


if __name__ == "__main__":
    sys.exit(main())
