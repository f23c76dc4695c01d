"""Generated worlds and data sets: repeatable, independent, near the published statistics; Algorithm 1 of the paper."""

import dataclasses
import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from refusals import refused
from scipy import ndimage

from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import dataset_files, open_dataset
from barn_worlds.datasets.generate import (
    TABLE_I,
    DatasetParameters,
    WorldParameters,
    automaton_grids,
    generate_dataset,
    generate_world,
    narrowness,
    renumber,
    smooth,
    write_dataset,
    write_ordered,
)
from barn_worlds.formats.dataset_file import WorldOrder

SMALL = DatasetParameters("small", seed=3, worlds_per_set=2, sets=TABLE_I[:4])


@settings(max_examples=25)
@given(
    st.integers(0, 2**32),
    st.builds(
        WorldParameters,
        initial_fill=st.floats(0.0, 0.25),
        smoothing_iterations=st.integers(0, 5),
        rows=st.integers(12, 60),
        cols=st.integers(2, 40),
        footprint_cells=st.sampled_from([1, 3, 5]),
        resolution_m=st.sampled_from([0.05, 0.15, 0.3]),
        attempts=st.just(200),
    ),
)
def test_generated_worlds_can_be_passed(seed, parameters):
    try:
        world = generate_world(parameters, np.random.default_rng(seed))
    except WorldError as error:
        assert "no passable world in 200 attempts" in str(error)
        return
    assert world.grid.shape == (parameters.rows, parameters.cols)
    assert world.grid[[0, -1]].all()
    rows, columns = world.path.T
    assert not world.cspace[rows, columns].any()
    assert world.path[[0, -1], 1].tolist() == [0, parameters.cols - 1]
    assert (world.resolution_m, world.footprint_cells) == (
        parameters.resolution_m,
        parameters.footprint_cells,
    )
    again = generate_world(parameters, np.random.default_rng(seed))
    assert again.checksum == world.checksum


def test_a_world_does_not_depend_on_how_many_others_there_are():
    few = generate_dataset(SMALL)
    larger = dataclasses.replace(SMALL, worlds_per_set=4, sets=TABLE_I[:5])
    many = generate_dataset(larger)
    same_places = [4 * s + k for s in range(4) for k in range(2)]
    assert [world.checksum for world in few] == [
        many[place].checksum for place in same_places
    ]
    other = generate_dataset(dataclasses.replace(SMALL, seed=4))
    assert not {world.checksum for world in few} & {world.checksum for world in other}
    assert few[3].provenance.seed == (3, 1, 1)


def test_progress_is_reported_after_each_world():
    reports = []
    generate_dataset(SMALL, lambda done, total: reports.append((done, total)))
    assert reports == [(k, 8) for k in range(1, 9)]


def test_a_world_nobody_can_pass_ends_with_an_error():
    parameters = WorldParameters(initial_fill=1.0, attempts=5)
    with refused("no passable world in 5 attempts with initial_fill 1", WorldError):
        generate_world(parameters, np.random.default_rng(0))


@pytest.mark.parametrize(
    "change, message",
    [
        ({"footprint_cells": 4}, "footprint_cells must be odd, got 4"),
        (
            {"clear_threshold": 5},
            "clear_threshold must be below fill_threshold = 5, got 5",
        ),
    ],
)
def test_parameters_that_are_not_allowed(change, message):
    with refused(message):
        WorldParameters(**change)


def test_worlds_can_be_numbered_by_any_score(tmp_path):
    worlds = generate_dataset(SMALL)
    scores = tuple(float(k % 3) for k in range(8))
    numbered = renumber(worlds, WorldOrder("a test", scores))
    checksums = [numbered[k].checksum for k in range(8)]
    assert checksums == [worlds[i].checksum for i in (0, 3, 6, 1, 4, 7, 2, 5)]
    assert [numbered[k].name for k in range(2)] == ["world_0", "world_1"]
    for wrong_scores in (scores[1:], (*scores[1:], float("nan"))):
        with refused("one finite score for each of 8 worlds", WorldError):
            renumber(worlds, WorldOrder("a test", wrong_scores))

    order = WorldOrder("a test", scores)
    write_ordered(tmp_path / "small.npz", "small", worlds, order, {"seed": 3})
    dataset = open_dataset(tmp_path / "small.npz")
    assert [dataset.load(k).checksum for k in range(8)] == checksums
    assert dataset.manifest["order"] == {"by": "a test", "scores": sorted(scores)}
    assert dataset.manifest["seed"] == 3


def test_narrowness_is_the_mean_distance_to_the_c_space(small_world):
    # the path runs in row 6; row 4 is the C-space's last row of the block (columns 3 to 9), row 7 that of the wall
    assert narrowness(small_world) == pytest.approx(-1.0)


def test_the_shipped_data_set_is_what_its_command_makes(tmp_path):
    write_dataset(tmp_path / "barn300.npz")
    copy = open_dataset(tmp_path / "barn300.npz")
    shipped = open_dataset("barn300")
    assert shipped.world_numbers == tuple(range(300))
    if shipped.manifest["order"]["by"] == copy.manifest["order"]["by"]:
        assert copy.checksum == shipped.checksum
    assert {copy.load(k).checksum for k in copy.world_numbers} == {
        shipped.load(k).checksum for k in shipped.world_numbers
    }


def test_the_shipped_manifest_says_what_is_inside():
    dataset = open_dataset("barn300")
    file = dataset_files()["barn300"]
    assert (
        json.loads(file.with_suffix(".manifest.json").read_text()) == dataset.manifest
    )
    assert dataset.manifest["schema"] == 1
    assert dataset.manifest["seed"] == DatasetParameters().seed
    assert len({entry["sha256"] for entry in dataset.manifest["worlds"]}) == 300
    per_set = np.bincount(
        [entry["parameter_set"] for entry in dataset.manifest["worlds"]]
    )
    assert per_set.tolist() == [25] * 12
    scores = dataset.manifest["order"]["scores"]
    assert len(scores) == 300
    assert scores == sorted(scores)


GRIDS = npst.arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12)))


def plain_smooth(grid, fill_threshold, clear_threshold):
    walled = np.pad(
        np.pad(grid, ((0, 0), (1, 1))), ((1, 1), (0, 0)), constant_values=True
    )
    neighbors = [[1, 1, 1], [1, 0, 1], [1, 1, 1]]
    count = ndimage.convolve(walled.astype(int), neighbors)[1:-1, 1:-1]
    return np.where(
        count >= fill_threshold, True, np.where(count <= clear_threshold, False, grid)
    )


@given(GRIDS, st.integers(0, 9), st.integers(-1, 8))
def test_smoothing_equals_the_plain_rule(grid, fill, clear):
    before = grid.copy()
    clear = min(clear, fill - 1)
    assert np.array_equal(smooth(grid, fill, clear), plain_smooth(grid, fill, clear))
    assert np.array_equal(grid, before)


@given(st.integers(0, 2**32), st.sampled_from(TABLE_I))
def test_iterations_are_successive_and_keep_the_side_walls(seed, parameters):
    grids = list(automaton_grids(parameters, np.random.default_rng(seed)))
    assert len(grids) == parameters.smoothing_iterations + 1
    for before, after in itertools.pairwise(grids):
        assert np.array_equal(after, smooth(before, 5, 1))
    assert np.stack(grids)[:, [0, -1]].all()


def test_random_fill_has_the_share_asked_for():
    parameters = WorldParameters(initial_fill=0.3, rows=402, cols=500)
    inner = next(automaton_grids(parameters, np.random.default_rng(1)))[1:-1]
    assert abs(inner.mean() - 0.3) < 4 * np.sqrt(0.21 / inner.size)
