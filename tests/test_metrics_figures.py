"""Figures are written whole, are the same every time and fit their width.

No text in them overlaps another.
"""

import itertools

import metrics_figures as tool
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image
from refusals import refused
from world_metrics import WIDTH_PX, draw_world_figure, world_figure

from barn_metrics.report import metrics_table
from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import Dataset
from barn_worlds.datasets.generate import WorldParameters, generate_world
from barn_worlds.worlds.world import World


def _world(seed=3, rows=30, cols=30):
    parameters = WorldParameters(initial_fill=0.2, rows=rows, cols=cols)
    return generate_world(
        parameters, np.random.default_rng(seed), f"world of seed {seed}"
    )


def _free_world():
    return World(
        "nothing in the way",
        np.zeros((12, 20), bool),
        np.array([[6, column] for column in range(20)]),
    )


def _texts(figure):
    """Return the texts that are seen.

    Matplotlib also keeps labels of ticks beyond the ends of an axis.
    """
    texts = [
        *figure.texts,
        *(text for legend in figure.legends for text in legend.get_texts()),
    ]
    for axes in figure.findobj(Axes):
        texts += [axes.title, axes.xaxis.label, axes.yaxis.label, *axes.texts]
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in axis.get_major_ticks():
                if low <= tick.get_loc() <= high:
                    texts += [
                        label
                        for label in (tick.label1, tick.label2)
                        if label.get_visible()
                    ]
    return [text for text in texts if text.get_text().strip()]


def _overlapping_texts(figure):
    """Return pairs of texts that overlap, and texts that the figure's edge cuts."""
    FigureCanvasAgg(figure).draw()
    renderer = figure.canvas.get_renderer()
    boxes = [
        (text.get_text(), text.get_window_extent(renderer)) for text in _texts(figure)
    ]
    width, height = figure.canvas.get_width_height()
    inside = [
        box.x0 >= -1 and box.x1 <= width + 1 and box.y0 >= -1 and box.y1 <= height + 1
        for _, box in boxes
    ]
    cut = [
        (text, "edge")
        for (text, _), whole in zip(boxes, inside, strict=True)
        if not whole
    ]
    return cut + [
        (a, b)
        for (a, first), (b, second) in itertools.combinations(boxes, 2)
        if first.overlaps(second)
    ]


FIGURES = {
    "world": lambda: world_figure(_world()),
    "world, published": lambda: world_figure(_world(), "published"),
    "wide world": lambda: world_figure(_world(rows=20, cols=60)),
    "long world": lambda: world_figure(_world(rows=70, cols=25)),
    "free world": lambda: world_figure(_free_world(), "published"),
    "visibility": lambda: tool.visibility_figure(_world()),
    "dispersion": lambda: tool.dispersion_figure(_world()),
    "characteristic dimension": lambda: tool.characteristic_dimension_figure(_world()),
    "automaton": tool.automaton_figure,
    "examples": lambda: tool.example_worlds_figure([_world(seed) for seed in range(4)]),
    "distribution": lambda: tool.distribution_figure(
        metrics_table([_world(seed) for seed in range(9)]), "nine"
    ),
}


@pytest.mark.parametrize("name", FIGURES)
def test_texts_neither_overlap_nor_leave_the_figure(name):
    assert _overlapping_texts(FIGURES[name]()) == []


def test_world_figure_is_a_repeatable_png_of_the_stated_width(tmp_path):
    for name in ("first.png", "second.png"):
        draw_world_figure(_world(), tmp_path / "new folder" / name)
    first, second = (
        (tmp_path / "new folder" / name).read_bytes()
        for name in ("first.png", "second.png")
    )
    assert first == second
    with Image.open(tmp_path / "new folder" / "first.png") as image:
        assert (image.format, image.width) == ("PNG", WIDTH_PX)


def test_documentation_figures_are_all_written(tmp_path):
    dataset = Dataset("few", {k: (lambda seed=k: _world(seed)) for k in range(5)})
    files = tool.draw_documentation_figures(tmp_path / "figures", dataset)
    assert sorted(tmp_path.joinpath("figures").iterdir()) == sorted(files)
    assert {file.stem for file in files} >= {
        "automaton",
        "dispersion",
        "example_worlds",
        "world_metrics",
    }
    for file in files:
        with Image.open(file) as image:
            assert image.width == WIDTH_PX


def test_a_figure_that_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "file").write_text("kept")
    with refused("cannot be written", WorldError):
        draw_world_figure(_world(), tmp_path / "file" / "world.png")
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_automaton_figure_shows_random_grid_and_three_iterations():
    figure = tool.automaton_figure()
    titles = [axes.get_title().split("\n")[0] for axes in figure.axes]
    assert titles == ["Random fill", "Iteration 1", "Iteration 2", "Iteration 3"]
