"""A plan has everything that a course is built by, at the scale that it states."""

import numpy as np
import pytest
from matplotlib.backends.backend_pdf import PdfPages
from refusals import refused

from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import Pose2D
from barn_worlds.drawing.plan import PAPERS, CoursePlan, PlanConfig
from barn_worlds.worlds.world import World

PATH = np.stack([np.full(200, 6), np.arange(200)], axis=1)
OUTLINE_M = np.array([(0.2, 0.2), (-0.2, 0.2), (-0.2, -0.2), (0.2, -0.2)])


def plan(world, **config):
    start = Pose2D(-0.5, 0.5, 1.57)
    goal = Pose2D(-0.5, 6.0, 1.57)
    return CoursePlan(world, start, goal, 0.5, OUTLINE_M, PlanConfig(**config))


def texts(figure):
    every = [*figure.texts, *(text for axes in figure.axes for text in axes.texts)]
    return "\n".join(text.get_text() for text in every)


def test_tables_have_every_center(small_world):
    pages = "\n".join(map(texts, plan(small_world)._tables()))
    for number, (x, y) in enumerate(small_world.cylinders_m.tolist()):
        assert f"{number:4d} {x:7.3f} {y:7.3f}" in pages


@pytest.mark.parametrize("paper", PAPERS)
def test_tiles_are_to_scale_and_show_every_number(small_world, paper):
    tiles = list(plan(small_world, paper=paper, scale=5)._tiles())
    numbers = set()
    for figure in tiles:
        (axes,) = figure.axes
        width_m = figure.get_figwidth() * 0.0254 * axes.get_position().width
        assert np.ptp(axes.get_xlim()) == pytest.approx(5 * width_m)
        height_m = figure.get_figheight() * 0.0254 * axes.get_position().height
        assert np.ptp(axes.get_ylim()) == pytest.approx(5 * height_m)
        numbers |= {int(text.get_text()) for text in axes.texts}
        # Nothing beside a label may look like its minus sign.
        assert {
            tick.tick1line.get_markersize() for tick in axes.yaxis.get_major_ticks()
        } == {0}
    assert numbers == set(range(len(small_world.cylinders_m)))


def test_the_first_page_counts_and_measures(small_world):
    text = texts(plan(small_world, shape="box", size_m=0.1)._overview())
    count = len(small_world.cylinders_m)
    assert f"{count} boxes of 0.1 m" in text
    assert "-0.300, 0.700" in text
    assert "an arc of 0.5 m around the goal" in text
    # A survey is for what its model of the scans is: posts as wide as a cell.
    assert "barn course survey" not in text
    assert "barn course survey" in texts(plan(small_world)._overview())


def test_equal_plans_are_equal_files_that_begin_with_the_overview(
    small_world, monkeypatch
):
    pages = []
    monkeypatch.setattr(PdfPages, "savefig", lambda _, figure: pages.append(figure))
    plan(small_world).pdf()
    assert "plan of the course" in texts(pages[0])
    assert "number, x and y of each center" in texts(pages[1])
    monkeypatch.undo()
    assert plan(small_world).pdf() == plan(small_world).pdf()


def test_what_cannot_be_built_is_refused(small_world):
    with refused(r"at most a cell, 0.15 m, got 0.3: neighbors", BarnError):
        plan(small_world, size_m=0.3)
    with refused(r"scale 1: the plan would have \d+ tiles", BarnError):
        plan(World("wide", np.zeros((200, 200), bool), PATH), scale=1).pdf()
