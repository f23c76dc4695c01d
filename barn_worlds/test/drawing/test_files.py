"""Figures as bytes of a file."""

import pytest
from matplotlib.figure import Figure

from barn_worlds.drawing.files import figure_bytes


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_equal_figures_are_equal_bytes(kind):
    contents = set()
    for _ in range(2):
        figure = Figure()
        # Clipped lines have an identifier in SVG, which matplotlib draws at random.
        figure.subplots().plot([0, 2], [0, 1])
        contents.add(figure_bytes(figure, kind))
    assert len(contents) == 1
