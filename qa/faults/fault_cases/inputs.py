"""Files that were made to hurt, given to the command that reads them."""

import gzip
import io
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import barn_worlds
from fault_cases.kit import Lab, add_all, case, hold

FAMILY = "inputs"
_DATA = Path(barn_worlds.__file__).parent / "data" / "barn_test.npz"
LONGEST = 700  # characters of a refusal

Make = Callable[[Path], object]


def expect_refusal(
    lab: Lab, name: str, make: Make, words: Sequence[object], named: str = ""
) -> str:
    """Make a file and give it to a command as the last word, which must refuse it.

    The command may take 3 GB of memory at most, and names the file or `named`.
    """
    make(lab.folder / name)
    refusal = lab.expect_refusal(*words, name, prefix=("prlimit", "--as=3000000000"))
    hold((named or name) in refusal, f"{named or name} is not named: {refusal}")
    hold(len(refusal) < LONGEST, f"{len(refusal)} characters")
    return refusal.replace(str(lab.folder), "")[:200]


def text_of(content: str) -> Make:
    """Return what writes a text."""
    return lambda path: path.write_text(content)


def bytes_of(content: bytes) -> Make:
    """Return what writes bytes."""
    return lambda path: path.write_bytes(content)


def _data_set(grid: bytes) -> Make:
    """Return a function that makes a data set with these bytes as its grids."""

    def make(path: Path) -> None:
        with (
            zipfile.ZipFile(_DATA) as good,
            zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        ):
            for name in good.namelist():
                archive.writestr(name, grid if name == "grid.npy" else good.read(name))

    return make


def _npy(shape: str, dtype: str = "<f8") -> bytes:
    head = (
        f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117)
        + "\n"
    )
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode()


def _bomb(path: Path) -> None:
    _data_set(_npy("(700000000,)", "|u1") + bytes(700_000_000))(path)


def _pickle_payload() -> bytes:
    file = io.BytesIO()
    np.save(file, np.array([{"a": 1}], object), allow_pickle=True)
    return file.getvalue()


def _pgm_map(image: bytes) -> Make:
    def make(path: Path) -> None:
        path.with_name("map.pgm").write_bytes(image)
        path.write_text(
            "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.2\nnegate: 0\n"
        )

    return make


# 10^9 times lol
_LAUGHS = '<!ENTITY a0 "lol">'
for _level in range(1, 10):
    _inner = f"&a{_level - 1};" * 10
    _LAUGHS += f'<!ENTITY a{_level} "{_inner}">'
_LIST = ("worlds", "list")
MUST = "Refused in one line that names the file, within 3 GB."
_CASES = (
    (
        "npz-pickled",
        "A data set with a pickled array.",
        "w.npz",
        _data_set(_pickle_payload()),
        _LIST,
    ),
    ("npz-bomb", "A data set of 1 MB that unpacks to 700 MB.", "w.npz", _bomb, _LIST),
    (
        "npz-shape",
        "A data set whose array claims 10^22 elements.",
        "w.npz",
        _data_set(_npy("(10000000000000000000000,)")),
        _LIST,
    ),
    ("npz-text", "A text file as a data set.", "w.npz", text_of("no archive"), _LIST),
    (
        "npz-cut-off",
        "A data set that is cut in half.",
        "w.npz",
        lambda path: path.write_bytes(_DATA.read_bytes()[:-2000]),
        _LIST,
    ),
    (
        "npy-nan",
        "A world whose grid has NaN.",
        "w.npy",
        lambda path: np.save(path, np.full((30, 30), np.nan)),
        ("show", "--out", "x.png"),
    ),
    (
        "npy-objects",
        "A world whose grid is an array of Python objects.",
        "w.npy",
        bytes_of(_npy("(2,)", "|O")),
        ("show", "--out", "x.png"),
    ),
    (
        "pgm-huge",
        "A map whose image claims 10^6 by 10^6 pixels.",
        "map.yaml",
        _pgm_map(b"P5 1000000 1000000 255\n" + bytes(100)),
        _LIST,
        "map.pgm",
    ),
    (
        "pgm-cut-off",
        "A map whose image ends too early.",
        "map.yaml",
        _pgm_map(b"P5 100 100 255\n" + bytes(99)),
        _LIST,
        "map.pgm",
    ),
    (
        "map-outside",
        "A map whose image is /etc/passwd.",
        "map.yaml",
        text_of(
            "image: /etc/passwd\nresolution: 0.05\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.2\nnegate: 0\n"  # noqa: E501, RUF100
        ),
        _LIST,
        "/etc/passwd",
    ),
    (
        "xml-laughs",
        "A Gazebo world with XML entities that stand for 3 GB.",
        "w.world",
        text_of(
            f"<?xml version='1.0'?><!DOCTYPE x [{_LAUGHS}]><sdf version='1.6'><world name='w'>&a9;</world></sdf>"
        ),
        _LIST,
    ),
    (
        "xml-external",
        "A Gazebo world with an external entity, /etc/passwd.",
        "w.world",
        text_of(
            '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><sdf version="1.6"><world name="w">&e;</world></sdf>'
        ),
        _LIST,
    ),
    (
        "xml-attribute",
        "A Gazebo world with an attribute of 20 MB.",
        "w.world",
        text_of(f'<sdf version="1.6"><world name="{"x" * 20_000_000}"/></sdf>'),
        _LIST,
    ),
    (
        "xml-deep",
        "A Gazebo world nested 100,000 deep.",
        "w.world",
        text_of("<sdf>" + "<a>" * 100_000 + "</a>" * 100_000 + "</sdf>"),
        _LIST,
    ),
    (
        "world-yaml",
        "A YAML world whose grid is a mapping.",
        "w.world.yaml",
        text_of("schema_version: 1\ngrid: {a: 1}\n"),
        _LIST,
    ),
    (
        "mcap-garbage",
        "A bag of random bytes.",
        "b.mcap",
        bytes_of(bytes(range(256)) * 40),
        ("replay",),
    ),
    ("mcap-empty", "A bag without a byte.", "b.mcap", bytes_of(b""), ("replay",)),
    (
        "sqlite-garbage",
        "A rosbag2 folder whose database is a text.",
        "bag",
        lambda path: (
            path.mkdir(),
            (path / "metadata.yaml").write_text(
                "rosbag2_bagfile_information: {version: 5, storage_identifier: sqlite3, relative_file_paths: [bag_0.db3]}\n"  # noqa: E501, RUF100
            ),
            (path / "bag_0.db3").write_text("no database"),
        ),
        ("replay",),
    ),
)
add_all(FAMILY, MUST, expect_refusal, _CASES)


@case(FAMILY)
def gzipped_world(lab: Lab) -> str:
    """A Gazebo world of 100 kB, gzipped, that unpacks to 100 MB.

    Refused in one line that names the file, within 3 GB.
    """
    content = gzip.compress(
        b'<sdf version="1.6"><world name="w">'
        + b"<model/>" * 12_000_000
        + b"</world></sdf>"
    )
    return expect_refusal(lab, "w.world.gz", bytes_of(content), _LIST)
