"""Untrusted NumPy files: a .npy array, or a .npz of plain arrays and a header in JSON.

Both are bounded in size, and nothing in them is executed.
"""

import io
import json
import tokenize
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_worlds.base.errors import ConfigError, WorldError, format_error, format_value
from barn_worlds.base.files import ZIP_ERRORS, pack_zip, read_bytes, write_bytes
from barn_worlds.base.text_files import parse_json

LARGEST_NPY = 64 * 1024 * 1024
Arrays = dict[str, npt.NDArray[Any]]
# what NumPy raises for other bytes, for a header that is no Python, and for sizes that no memory has
_NO_ARRAY = (
    ValueError,
    TypeError,
    MemoryError,
    RecursionError,
    SyntaxError,
    OverflowError,
    tokenize.TokenError,
)


def read_npy(path: Path) -> npt.NDArray[Any]:
    """Return the array of a .npy file of at most 64 MB; WorldError if it is damaged or not a numeric array."""
    return parse_npy(read_bytes(path, LARGEST_NPY), str(path))


def parse_npy(content: bytes, where: str) -> npt.NDArray[Any]:
    """Return the array of the content of a .npy file; WorldError begins with `where`."""
    try:
        array = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    except _NO_ARRAY as error:
        raise WorldError(
            f"{where}: not a .npy file of numbers: {format_error(error)}"
        ) from None
    if array.dtype.kind not in "biuf":
        raise WorldError(
            f"{where}: must hold numbers, got values of type {array.dtype}"
        )
    return array


def encode_npy(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a .npy file."""
    file = io.BytesIO()
    np.lib.format.write_array(file, array, allow_pickle=False)
    return file.getvalue()


@dataclass(frozen=True)
class NpzFormat:
    """A kind of .npz file.

    what: its name in messages, such as "a policy file". header: the header's file name inside, such as "policy.json".
    schema: the version that the header must have. largest_file: most bytes of a file. largest: most bytes of what it
    unpacks to. newer: further versions, which files have that need them; their headers say so themselves.
    """

    what: str
    header: str
    schema: int
    largest_file: int
    largest: int
    newer: tuple[int, ...] = ()

    def write(
        self,
        path: Path,
        header: Mapping[str, Any],
        arrays: Mapping[str, npt.NDArray[Any]],
    ) -> str:
        """Write a file atomically and return the text of its header; equal content gives equal bytes."""
        text = json.dumps({"schema": self.schema, **header}, indent=1) + "\n"
        members = {
            self.header: text.encode(),
            **{f"{name}.npy": encode_npy(array) for name, array in arrays.items()},
        }
        write_bytes(path, pack_zip(members))
        return text

    def read(self, path: Path) -> tuple[dict[str, Any], Arrays]:
        """Return the header and the arrays by name; WorldError if the file is damaged or of another version."""
        try:
            with zipfile.ZipFile(
                io.BytesIO(read_bytes(path, self.largest_file))
            ) as archive:
                if (
                    sum(member.file_size for member in archive.infolist())
                    > self.largest
                ):
                    raise WorldError(
                        f"{path}: unpacks to more than the allowed {self.largest} bytes"
                    )
                contents = {name: archive.read(name) for name in archive.namelist()}
        except ZIP_ERRORS as error:
            raise WorldError(
                f"{path}: not {self.what}, or a damaged one: {format_error(error)}"
            ) from None
        if self.header not in contents:
            raise WorldError(f"{path}: not {self.what}: it has no {self.header}")
        try:
            header = parse_json(contents.pop(self.header), f"{path}: {self.header}")
        except ConfigError as error:
            raise WorldError(str(error)) from None
        version = header.get("schema") if isinstance(header, dict) else None
        if version not in (self.schema, *self.newer) or isinstance(version, bool):
            known = " or ".join(map(str, (self.schema, *self.newer)))
            raise WorldError(
                f"{path}: schema version must be {known}, got {format_value(version)}"
            )
        arrays = {
            name.removesuffix(".npy"): parse_npy(data, f"{path}: {name:.60}")
            for name, data in contents.items()
        }
        return header, arrays

    def array(self, arrays: Arrays, name: str, path: Path) -> npt.NDArray[Any]:
        """Return the array of that name; WorldError if the file at `path` does not have it."""
        if name not in arrays:
            raise WorldError(f"{path}: not {self.what}: it has no {name}.npy")
        return arrays[name]
