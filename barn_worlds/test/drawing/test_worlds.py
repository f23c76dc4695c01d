"""Pictures show what they should, where they should."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image, ImageColor
from refusals import refused

from barn_worlds.base.errors import WorldError
from barn_worlds.drawing import palette
from barn_worlds.drawing import worlds as render
from barn_worlds.drawing.files import write_png
from barn_worlds.worlds.world import World


def test_a_world_is_drawn_with_all_its_parts(small_world, tmp_path):
    figure = render.world_figure(small_world)
    write_png(figure, tmp_path / "world.png")
    image = Image.open(tmp_path / "world.png").convert("RGB")
    colors = {color for _, color in image.getcolors(2**24)}
    parts = (
        palette.OBSTACLE,
        palette.WALL,
        palette.HOLLOW,
        palette.INFLATED,
        palette.INK,
        palette.GOAL,
    )
    assert {ImageColor.getrgb(part) for part in parts} <= colors
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")
    assert (*axes.get_xlim(), *axes.get_ylim()) == pytest.approx((-1.35, 0.0, 0.0, 6.9))
    assert any(
        np.array_equal(line.get_xydata(), small_world.path_m()) for line in axes.lines
    )
    discs = np.concatenate(
        [collection.get_offsets() for collection in axes.collections]
    ).tolist()
    assert all(center in discs for center in small_world.obstacles_m.tolist())
    labels = {text.get_text() for text in axes.get_legend().get_texts()}
    assert {"obstacle", "C-space obstacle", "start", "goal"} == labels


def test_a_sheet_holds_every_world_in_its_place(small_world):
    other = World("other", np.zeros((9, 12), bool), small_world.path)
    figure = render.sheet_figure({3: small_world, 4: other, 5: other, 6: small_world})
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == ["3", "4", "5", "6"]
    sheet = axes.images[0].get_array()
    tile = np.full((12, 9, 3), to_rgb(palette.WHITE), np.float32)
    tile[small_world.cspace.T] = to_rgb(palette.INFLATED)
    tile[small_world.grid.T] = to_rgb(palette.OBSTACLE)
    tile[np.arange(12), 6] = to_rgb(palette.ROUTE)
    tile[0, 6] = start = to_rgb(palette.START)
    tile[11, 6] = to_rgb(palette.GOAL)
    gap = 2
    assert np.array_equal(sheet[gap : gap + 12, :9], tile[::-1])
    assert np.array_equal(sheet[gap + 14 : gap + 26, :9], tile[::-1])
    assert np.array_equal(sheet[gap + 11, 11 : 11 + 9][6], np.float32(start))


def test_sheets_are_bounded():
    with refused("1 to 1000 worlds, got 0", WorldError):
        render.sheet_figure({})
    large = World("large", np.zeros((2000, 2000), bool), np.array([[0, 0]]))
    with refused("too large for one sheet", WorldError):
        render.sheet_figure({0: large})
