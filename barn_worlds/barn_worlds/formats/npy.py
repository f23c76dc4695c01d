"""Untrusted NumPy files: the header is checked before anything is allocated, pickles are refused."""

import io
import tokenize
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_worlds.errors import WorldError
from barn_worlds.formats.files import read_bytes

LARGEST_NPY = 64 * 1024 * 1024


def read_npy(path: Path) -> npt.NDArray[Any]:
    """Return the array of a .npy file of at most 64 MB; WorldError if it is damaged or not a numeric array."""
    return parse_npy(read_bytes(path, LARGEST_NPY), str(path))


def parse_npy(content: bytes, where: str) -> npt.NDArray[Any]:
    """Return the array of the content of a .npy file; WorldError begins with `where`."""
    file = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(file)
        if version == (1, 0):
            shape, _, dtype = np.lib.format.read_array_header_1_0(file)
        elif version == (2, 0):
            shape, _, dtype = np.lib.format.read_array_header_2_0(file)
        else:
            raise ValueError(f"format version {version} is not supported")
    except (ValueError, TypeError, MemoryError, RecursionError, SyntaxError, tokenize.TokenError) as error:
        raise WorldError(f"{where}: not a .npy file: {one_line(error)}") from None
    if dtype.hasobject:
        raise WorldError(f"{where}: holds pickled Python objects, which are not read")
    if dtype.kind not in "biuf":
        raise WorldError(f"{where}: must hold numbers, got values of type {dtype}")
    count = 1
    for side in shape:
        count *= side
    there = len(content) - file.tell()
    if any(side < 0 for side in shape) or count * dtype.itemsize != there:
        raise WorldError(f"{where}: {there} bytes of data do not make an array {shape} of {dtype}")
    file.seek(0)
    try:
        return np.lib.format.read_array(file, allow_pickle=False)
    except (ValueError, OverflowError) as error:  # more dimensions or larger sides than NumPy can have
        raise WorldError(f"{where}: not a .npy file: {one_line(error)}") from None


def to_npy(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a .npy file."""
    file = io.BytesIO()
    np.lib.format.write_array(file, array, allow_pickle=False)
    return file.getvalue()


def one_line(error: BaseException) -> str:
    """Return the text of an error on one line, cut where it is long."""
    return " ".join(str(error).split())[:200]
