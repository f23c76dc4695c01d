"""NumPy files and the suite's own data set files, good and malformed."""

import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from archives import pickled, repack
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from refusals import refused

from barn_worlds.base.errors import BarnError, WorldError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.formats import dataset_file
from barn_worlds.formats.dataset_file import read_dataset_file, write_dataset_file
from barn_worlds.formats.npz import encode_npy, parse_npy
from barn_worlds.worlds.world import Provenance, World


def header(text, version=(1, 0)):
    size = struct.pack("<H" if version == (1, 0) else "<I", len(text))
    return b"\x93NUMPY" + bytes(version) + size + text.encode()


def described(shape, descr="'<i8'"):
    return header(f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}\n")


@given(
    npst.arrays(
        st.sampled_from([np.int64, np.uint8, np.float64, np.bool_]),
        npst.array_shapes(max_side=5),
    )
)
def test_arrays_come_back(array):
    assert np.array_equal(
        parse_npy(encode_npy(array), "x"), array, equal_nan=array.dtype == np.float64
    )


@pytest.mark.parametrize(
    "content, message",
    [
        (b"", "not a .npy file"),
        (b"\x93NUMPY", "not a .npy file"),
        (b"\x93NUMPY\x09\x00" + bytes(100), "not a .npy file"),
        (b"PK\x03\x04 something", "not a .npy file"),
        (pickled(), "Object arrays cannot be loaded"),
        (
            described("(3,)", "'<U5'") + bytes(60),
            "must hold numbers, got values of type <U5",
        ),
        (described("(3,)", "[('a', '<i8')]") + bytes(24), "must hold numbers"),
        (described("(30, 30)") + bytes(10), "not a .npy file of numbers"),
        (described(f"({10**9}, {10**9})") + bytes(100), "not a .npy file"),
        (described("(-1, -1)") + bytes(8), "not a .npy file"),
        (described(f"(0, {10**22})"), "not a .npy file"),
        (described("(" + "1, " * 100 + ")") + bytes(8), "not a .npy file"),
        (header("{'descr': '<i8'" + " " * 60_000), "not a .npy file"),
        (header("[" * 9000), "not a .npy file"),
        (
            header(
                "{'descr': '<i8', 'fortran_order': False, 'shape': (1,)}" + " " * 10**6,
                (2, 0),
            ),
            "not a .npy file",
        ),
    ],
)
def test_malformed_arrays_are_refused_at_once(content, message):
    with refused(f"^grid.npy: .*{message}", WorldError):
        parse_npy(content, "grid.npy")


@st.composite
def worlds(draw):
    rows = draw(st.integers(1, 12))
    cols = draw(st.integers(1, 12))
    grid = draw(npst.arrays(bool, (rows, cols)))
    row = draw(st.integers(0, rows - 1))
    grid[row] = False
    path = np.stack([np.full(cols, row), np.arange(cols)], axis=1)
    provenance = Provenance(
        "generated", parameters={"initial_fill": draw(st.floats(0, 1))}, seed=(1, 2, 3)
    )
    return World(
        "w",
        grid,
        path,
        draw(st.sampled_from([0.05, 0.15])),
        draw(st.sampled_from([1, 5])),
        provenance,
    )


@given(st.dictionaries(st.integers(0, 1000), worlds(), min_size=1, max_size=5))
def test_own_files_come_back(tmp_path_factory, numbered):
    path = tmp_path_factory.mktemp("own") / "set.npz"
    write_dataset_file(path, "a set", numbered)
    first = path.read_bytes()
    dataset = open_dataset(path)
    assert dataset.name == "a set"
    assert dataset.world_numbers == tuple(sorted(numbered))
    for index, world in numbered.items():
        read = dataset.load(index)
        assert read.checksum == world.checksum
        assert read.provenance.parameters == world.provenance.parameters
        assert read.provenance.seed == world.provenance.seed
    write_dataset_file(path, "a set", numbered)
    assert path.read_bytes() == first


@pytest.fixture
def npz_file(tmp_path, small_world):
    path = tmp_path / "set.npz"
    write_dataset_file(path, "set", {3: small_world})
    return path


@pytest.mark.parametrize(
    "change, message",
    [
        ({"grid.npy": None}, "world 3 is damaged: 'grid'"),
        ({"index.npy": None}, "its world numbers do not match"),
        ({"grid.npy": b"x"}, "grid.npy: not a .npy file"),
        ({"grid.npy": encode_npy(np.zeros(3))}, "world 3 is damaged: "),
        ({"grid.npy": encode_npy(np.zeros(3, np.uint8))}, "world 3 is damaged: "),
        ({"path.npy": encode_npy(np.zeros((3, 3), int))}, "world 3 is damaged: "),
        (
            {"shape.npy": encode_npy(np.array([[10**6, 10**6]]))},
            "world 3 is damaged: sides must be 1 to 2000 cells",
        ),
        (
            {"shape.npy": encode_npy(np.array([[-9, -12]]))},
            "world 3 is damaged: sides must be 1 to 2000 cells",
        ),
        (
            {"path_cells.npy": encode_npy(np.array([3]))},
            "world 3 is damaged: its checksum",
        ),
        ({"index.npy": encode_npy(np.array([1, 2]))}, "its world numbers do not match"),
        (
            {"index.npy": encode_npy(np.array([-1]))},
            "world numbers must be at least 0 and unique",
        ),
        ({"manifest.json": b"{"}, "manifest.json: not JSON"),
        ({"manifest.json": b"[]"}, "schema version must be 1 or 2, got None"),
        ({"manifest.json": b'{"schema": 3}'}, "schema version must be 1 or 2, got 3"),
        ({"manifest.json": b'{"schema": 1}'}, "its world numbers do not match"),
        (
            {
                "manifest.json": b'{"schema": 1, "name": "set", "worlds": [{}], "robot": ["husky"]}'
            },
            "its manifest lacks a name, or its robot is not a name",
        ),
    ],
)
def test_malformed_own_files_are_refused(npz_file, change, message):
    repack(npz_file, change)
    with refused(f"^{npz_file}.*{message}", BarnError):
        open_dataset(npz_file).load(3)


def test_a_member_that_occurs_twice_is_refused(npz_file):
    with pytest.warns(UserWarning), zipfile.ZipFile(npz_file, "a") as archive:
        archive.writestr("grid.npy", b"")
    with refused(f"^{npz_file}: .*: 'grid.npy' occurs twice; keep only", WorldError):
        read_dataset_file(npz_file)


def test_a_zip_bomb_is_refused_before_it_is_unpacked(npz_file, monkeypatch):
    monkeypatch.setattr(
        "barn_worlds.formats.dataset_file.FORMAT",
        replace(dataset_file.FORMAT, largest=1_000_000),
    )
    repack(npz_file, {"grid.npy": bytes(1_000_000)})
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda *_: pytest.fail("unpacked"))
    with refused("unpacks to more than the allowed", WorldError):
        read_dataset_file(npz_file)
