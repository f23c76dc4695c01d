"""Data sets from every kind of source, used the same way, the original layout both ways, and a choice of worlds."""

import pickle
import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from barn_worlds.base.errors import WorldError
from barn_worlds.datasets.dataset import open_dataset, select_worlds
from barn_worlds.datasets.generate import (
    TABLE_I,
    DatasetParameters,
    WorldParameters,
    generate_dataset,
)
from barn_worlds.formats.dataset_file import write_dataset_file
from barn_worlds.formats.npz import encode_npy
from barn_worlds.formats.original import write_original
from barn_worlds.formats.sdf import write_sdf
from barn_worlds.robots.files import ROBOTS


@pytest.fixture(scope="module")
def worlds():
    """Three worlds by number."""
    parameters = DatasetParameters("made", seed=1, worlds_per_set=1, sets=TABLE_I[::5])
    return dict(zip((0, 6, 120), generate_dataset(parameters), strict=True))


@pytest.fixture
def layout(tmp_path, worlds):
    """A folder with the three worlds in the original layout."""
    folder = tmp_path / "layout"
    write_original(folder, worlds, {6: np.arange(5.0)})
    return folder


def same(dataset, worlds):
    checksums = {k: dataset.load(k).checksum for k in dataset.world_numbers}
    return checksums == {k: world.checksum for k, world in worlds.items()}


@pytest.mark.parametrize(
    "missing", [(), ("grid_files",), ("world_files",), ("cspace_files", "map_files")]
)
def test_the_original_layout_comes_back_from_what_is_there(layout, worlds, missing):
    for part in missing:
        shutil.rmtree(layout / part)
    dataset = open_dataset(layout)
    assert (dataset.name, dataset.world_numbers) == ("layout", (0, 6, 120))
    assert same(dataset, worlds)
    assert dataset.load(6).provenance.source == "original"
    metrics = np.load(layout / "metrics_files" / "metrics_6.npy")
    assert metrics.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("part", ["grid_files", "world_files", "map_files"])
def test_parts_of_the_layout_are_data_sets_too(layout, worlds, part):
    assert same(open_dataset(layout / part), worlds)


def test_the_originals_written_again_are_the_originals(original_folder, tmp_path):
    dataset = open_dataset(original_folder)
    some = {index: dataset.load(index) for index in dataset.world_numbers[::10]}
    write_original(tmp_path / "again", some, {})
    assert same(open_dataset(tmp_path / "again"), some)
    for index in some:
        for kind in ("grid", "cspace", "path"):
            name = f"{kind}_files/{kind}_{index}.npy"
            written = np.load(tmp_path / "again" / name)
            published = np.load(original_folder / name)
            assert written.dtype == published.dtype
            assert np.array_equal(written, published)


def test_footprint_and_resolution_survive_the_layout(tmp_path):
    parameters = WorldParameters(
        resolution_m=0.3, footprint_cells=3, initial_fill=0.1, rows=20, cols=12
    )
    coarse = DatasetParameters("coarse", worlds_per_set=1, sets=(parameters,))
    (world,) = generate_dataset(coarse)
    write_original(tmp_path / "coarse", {4: world}, {})
    assert same(open_dataset(tmp_path / "coarse"), {4: world})


def test_single_files_and_where_their_path_comes_from(layout, worlds, tmp_path):
    beside = open_dataset(layout / "world_files" / "world_6.world.gz")
    assert same(beside, {6: worlds[6]})
    assert beside.load(6).provenance.path_source == "given"
    write_sdf(worlds[6], tmp_path / "alone.sdf", "gz")
    alone = open_dataset(tmp_path / "alone.sdf").load(0)
    assert alone.provenance.path_source == "planned"
    assert (alone.name, *alone.path[[0, -1], 1]) == ("alone", 0, 29)
    assert np.array_equal(alone.grid, worlds[6].grid)
    turtle = open_dataset(tmp_path / "alone.sdf", ROBOTS["turtlebot3_burger"]).load(0)
    assert (alone.footprint_cells, turtle.footprint_cells) == (5, 3)


def test_unnumbered_files_are_numbered_by_name(worlds, tmp_path):
    for name in ("b", "a"):
        (tmp_path / f"{name}.npy").write_bytes(encode_npy(worlds[0].grid))
    dataset = open_dataset(tmp_path)
    assert [dataset.load(index).name for index in dataset.world_numbers] == ["a", "b"]


def test_data_sets_can_be_handed_to_other_processes(layout, worlds):
    for source in (layout, layout / "world_files", "barn300"):
        dataset = open_dataset(source)
        copy = pickle.loads(pickle.dumps(dataset))
        assert copy.load(6).checksum == dataset.load(6).checksum


def test_a_world_is_read_once_and_not_handed_to_other_processes():
    dataset = open_dataset("barn300")
    before = len(pickle.dumps(dataset))
    first = dataset.load(6)
    assert dataset.load(6) is first and dataset.load(7) is not first
    assert len(pickle.dumps(dataset)) == before


def test_only_so_many_worlds_are_kept(monkeypatch):
    monkeypatch.setattr("barn_worlds.datasets.dataset.MAX_CACHED_WORLDS", 2)
    dataset = open_dataset("barn300")
    first = dataset.load(0)
    assert dataset.load(1) is dataset.load(1) and dataset.load(0) is first
    assert dataset.load(2).name == "world_2"
    assert dataset.load(0) is not first and dataset.load(0).checksum == first.checksum


def test_no_data_set_takes_the_name_of_one_of_the_suite(worlds, tmp_path):
    write_original(tmp_path / "barn300", worlds, {})
    write_dataset_file(tmp_path / "made.npz", "barn300", worlds)
    for source in ("barn300", "made.npz"):
        assert open_dataset(tmp_path / source).name == "own_barn300"
    assert open_dataset("barn300").name == "barn300"


def test_checksum_tells_data_sets_apart(layout, worlds, tmp_path):
    others = {0: worlds[6], 6: worlds[0], 120: worlds[120]}
    write_original(tmp_path / "other", others, {})
    assert open_dataset(layout).checksum == open_dataset(layout / "grid_files").checksum
    assert open_dataset(layout).checksum != open_dataset(tmp_path / "other").checksum


@pytest.mark.parametrize(
    "source, message",
    [
        ("barn30", "no such file, folder or data set; did you mean 'barn300'"),
        ("none/at/all", "no such file, folder or data set; known: barn300"),
        ("a\0b", "no such file|cannot be read"),
        ("x" * 5000, "cannot be read: .*[Nn]ame too long"),
    ],
)
def test_sources_that_are_not_there(source, message):
    with refused(message, WorldError, longest=6000):
        open_dataset(source)


def test_what_holds_no_worlds_is_refused(tmp_path, layout):
    with refused("contains no worlds", WorldError):
        open_dataset(tmp_path / "layout" / "metrics_files")
    (tmp_path / "notes.txt").write_text("x")
    with refused(
        r"notes\.txt: a world's file name must end in one of \.world", WorldError
    ):
        open_dataset(tmp_path / "notes.txt")
    with refused("layout: no world 1; there are 3 worlds from 0 to 120", WorldError):
        open_dataset(layout).load(1)


@pytest.mark.parametrize(
    "name, array, message",
    [
        (
            "grid_files/grid_6.npy",
            np.full((30, 30), 7),
            "grid_6.npy: grid must hold zeros and ones, got 7",
        ),
        (
            "path_files/path_6.npy",
            np.zeros((4, 3), int),
            "world_6: path must be an array of rows and columns",
        ),
        (
            "cspace_files/cspace_6.npy",
            np.eye(30),
            "cspace_6.npy: is not the C-space of the grid for any footprint",
        ),
    ],
)
def test_malformed_parts_of_the_layout_are_named(layout, name, array, message):
    (layout / name).write_bytes(encode_npy(array))
    dataset = open_dataset(layout)
    with refused(message, WorldError):
        dataset.load(6)


def test_a_grid_without_a_way_through_is_refused(tmp_path):
    grid = np.zeros((30, 30), np.int64)
    grid[:, 15] = 1
    (tmp_path / "wall.npy").write_bytes(encode_npy(grid))
    with refused(
        "no path from the first to the last column for a robot of 5 x 5 cells",
        WorldError,
    ):
        open_dataset(tmp_path / "wall.npy").load(0)


def test_a_layout_is_written_whole_or_not_at_all(tmp_path, worlds):
    with pytest.raises(ValueError, match="could not convert"):
        write_original(tmp_path / "half", worlds, {0: ["no number"] * 5})
    assert list(tmp_path.iterdir()) == []


SIXTH = tuple(range(0, 300, 6))


@pytest.mark.parametrize(
    "spec, indices, selection",
    [
        ("0", range(300), [0]),
        ("0-3", range(300), [0, 1, 2, 3]),
        ("0:300:100", range(300), [0, 100, 200]),
        ("2:5", range(300), [2, 3, 4]),
        ("1,4,7-9", range(300), [1, 4, 7, 8, 9]),
        (" 9, 3-4 ,3", range(300), [9, 3, 4]),
        ("all", SIXTH, list(SIXTH)),
        ("0-20", SIXTH, [0, 6, 12, 18]),
        ("0:999999999", SIXTH, list(SIXTH)),
    ],
)
def test_choices(spec, indices, selection):
    assert select_worlds(spec, indices) == selection


@pytest.mark.parametrize(
    "spec, message",
    [
        ("", "must be a number"),
        ("x", "'x' must be a number, first-last"),
        ("-1", "'-1' must be a number"),
        ("1-", "must be a number"),
        ("0:10:0", "step in '0:10:0' must be at least 1"),
        ("1e3", "must be a number"),
        ("1", "no world 1 among the 50 from 0 to 294"),
        ("1-5", "no world 1-5 among"),
        ("5-1", "no world 5-1 among"),
        ("6,1", "no world 1 among"),
        ("9" * 10, "must be a number"),
        ("1," * 10_000, "at most 10000 characters"),
        ("all,?", "'\\?' must be"),
    ],
)
def test_mistakes_are_one_line(spec, message):
    with refused(message, WorldError, longest=300):
        select_worlds(spec, SIXTH)


@pytest.mark.parametrize(
    "spec, missing",
    [("0:999", "300 of 0:999"), ("298-301", "300 of 298-301"), ("0:400:100", "300")],
)
def test_a_range_beyond_a_set_without_gaps_is_refused(spec, missing):
    with refused(f"no world {missing}", WorldError):
        select_worlds(spec, range(300))


@given(st.text(max_size=30))
def test_any_text_either_chooses_or_is_refused(spec):
    try:
        selection = select_worlds(spec, SIXTH)
    except WorldError:
        return
    assert selection
    assert len(set(selection)) == len(selection)
    assert set(selection) <= set(SIXTH)


def test_no_worlds_no_choice():
    with refused("no worlds to select from", WorldError):
        select_worlds("all", [])
