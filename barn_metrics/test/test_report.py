"""The table of metrics: equal to its parts, valid in every format, and written whole or not at all."""

from dataclasses import asdict, replace
from statistics import pstdev

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

from barn_metrics.metrics import METRICS, world_cell_metrics, world_metrics
from barn_metrics.report import metrics_table
from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import Dataset, open_dataset
from barn_worlds.worlds.world import World


def _worlds():
    generator = np.random.default_rng(7)
    worlds = []
    for number in range(4):
        grid = generator.random((12, 15)) < 0.1
        grid[[0, -1]] = True
        grid[5] = False
        path = np.array([[5, column] for column in range(15)])
        worlds.append(World(f"world {number}", grid, path, footprint_cells=1))
    return worlds


@pytest.mark.parametrize("formula", ["published", "corrected", "paper_text"])
def test_rows_and_extremes_are_those_of_the_worlds(formula):
    worlds = _worlds()
    table = metrics_table(iter(worlds), formula)
    assert table.worlds == tuple(world.name for world in worlds)
    assert table.rows() == [asdict(world_metrics(world, formula)) for world in worlds]
    cells = np.vstack([world_cell_metrics(world, formula) for world in worlds])
    assert_array_equal(table.cell_minimum, cells.min(axis=0))
    assert_array_equal(table.cell_maximum, cells.max(axis=0))


def test_worlds_are_taken_one_by_one():
    arena = replace(_worlds()[0], corner_m=(0.0, 0.0))

    def two_worlds():
        yield arena
        raise AssertionError("the first world is refused, so no second one is needed")

    with refused(r"is an arena or .*; metrics and difficulty need", WorldError):
        metrics_table(two_worlds())


def test_a_data_set_is_labelled_by_its_numbers():
    readers = {10 * k: (lambda world=world: world) for k, world in enumerate(_worlds())}
    table = metrics_table(Dataset("mine", readers))
    assert table.worlds == ("0", "10", "20", "30")
    for metric, values in zip(METRICS, table.values.T, strict=True):
        summary = table.summary_of(metric)
        assert summary["minimum"] == values.min()
        assert summary["maximum"] == values.max()
        assert summary["mean"] == pytest.approx(values.mean())
        assert summary["std"] == pytest.approx(pstdev(values))


def test_json_holds_worlds_summary_and_formula():
    table = metrics_table(_worlds(), "published")
    document = table.as_json()
    assert document["schema_version"] == 1
    assert document["formula"] == {
        "visibility": "published",
        "dispersion": "published",
        "axes": 4,
    }
    assert [entry["world"] for entry in document["worlds"]] == list(table.worlds)
    assert document["worlds"][2]["tortuosity"] == 1.0
    closest = document["summary"]["closest_obstacle"]
    assert (
        closest["cell_minimum"]
        <= closest["minimum"]
        <= closest["mean"]
        <= closest["maximum"]
    )
    assert "cell_minimum" not in document["summary"]["tortuosity"]


def test_json_of_a_world_without_obstacles_is_still_json():
    path = np.array([[2, column] for column in range(6)])
    free = World("free", np.zeros((6, 6), bool), path)
    (entry,) = metrics_table([free], "published").as_json()["worlds"]
    assert entry["closest_obstacle"] is None
    assert entry["average_visibility"] is None
    assert entry["dispersion"] == 0


def test_summary_cells_are_the_summary_to_two_decimals():
    table = metrics_table(_worlds())
    headings, lines = table.summary_cells()
    assert all(len(line) == len(headings) for line in lines)
    means = [float(line[-2]) for line in lines]
    assert means == pytest.approx(table.values.mean(axis=0), abs=0.005)
    assert lines[4][1:3] == ["-", "-"]


def test_no_worlds_and_unknown_formulas_are_refused():
    with refused("no world", WorldError):
        metrics_table([])
    with refused("did you mean"):
        metrics_table(_worlds(), "corected")


def test_the_original_folder_gives_what_was_published_with_it(original_folder):
    dataset = open_dataset(original_folder)
    table = metrics_table(dataset, "published")
    for world, row in zip(table.worlds, table.values, strict=True):
        published = np.load(original_folder / "metrics_files" / f"metrics_{world}.npy")
        assert_allclose(row, published, rtol=0, atol=1e-9)
