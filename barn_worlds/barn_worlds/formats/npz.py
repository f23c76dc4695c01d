"""Untrusted NumPy files: a .npy array, or a .npz of plain arrays and a JSON header.

Their size is limited, and nothing in them is executed.
"""

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from barn_worlds.base.arrays import AnyArray
from barn_worlds.base.errors import (
    WorldError,
    format_error,
    format_value,
    refuse_duplicates,
)
from barn_worlds.base.files import (
    ZIP_ERRORS,
    pack_zip,
    parse_json,
    read_bytes,
    write_bytes,
)

LARGEST_NPY = 64 * 1024 * 1024
Arrays = dict[str, AnyArray]
Shape = Sequence[int | None]


def read_npy(path: Path) -> AnyArray:
    """Return the array in a .npy file; WorldError if above 64 MB or not numbers.

    Raises:
        WorldError: If the file cannot be read or does not hold numbers.
    """
    return parse_npy(read_bytes(path, LARGEST_NPY), str(path))


def parse_npy(content: bytes, where: str) -> AnyArray:
    """Return the array of numbers in .npy bytes; WorldError for anything else.

    Args:
        content: Bytes of the file.
        where: Path of the file, to begin an error message with.

    Raises:
        WorldError: If the content is damaged or does not hold numbers.
    """
    try:
        # A pickle could run arbitrary code.
        array = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    # NumPy raises errors of any kind: for bytes that are not an array, for a header
    # that is not Python, and for arrays that do not fit into memory.
    except Exception as error:
        raise WorldError(
            f"{where}: not a .npy file of numbers: {format_error(error)}"
        ) from None
    if array.dtype.kind not in "biuf":
        raise WorldError(
            f"{where}: must hold numbers, got values of type {array.dtype}"
        )
    return array


def encode_npy(array: AnyArray) -> bytes:
    """Return an array as the bytes of a .npy file."""
    file = io.BytesIO()
    np.lib.format.write_array(file, array, allow_pickle=False)
    return file.getvalue()


@dataclass(frozen=True)
class NpzFormat:
    """A kind of .npz file: arrays and a JSON header."""

    what: str
    """Kind of file for messages, such as "a policy file"."""

    header: str
    """Name of the header inside the file, such as "policy.json"."""

    schema: int
    """Version that the header must have."""

    largest_file: int
    """Most bytes of a file."""

    largest: int
    """Most bytes that a file unpacks to."""

    other_schemas: tuple[int, ...] = ()
    """Further versions that are read; a header of one of them must contain it."""

    def write(
        self, path: Path, header: Mapping[str, Any], arrays: Mapping[str, AnyArray]
    ) -> str:
        """Write a .npz file atomically and return its header as JSON text.

        Equal content gives equal bytes.

        Args:
            path: File to write.
            header: Plain data. The schema is added if the header has none.
            arrays: Arrays by name.

        Returns:
            The text of the header.
        """
        text = json.dumps({"schema": self.schema, **header}, indent=1) + "\n"
        members = {self.header: text.encode()}
        for name, array in arrays.items():
            members[f"{name}.npy"] = encode_npy(array)
        write_bytes(path, pack_zip(members))
        return text

    def read(self, path: Path) -> tuple[dict[str, Any], Arrays]:
        """Read a .npz's header and arrays; BarnError if damaged or of another schema.

        Raises:
            BarnError: If the file is damaged or of another version.
        """
        contents = self._unpack(path)
        if self.header not in contents:
            raise WorldError(f"{path}: not {self.what}: it has no {self.header}")
        header = parse_json(contents.pop(self.header), f"{path}: {self.header}")
        version = header.get("schema") if isinstance(header, dict) else None
        versions = (self.schema, *self.other_schemas)
        # In Python True is equal to 1.
        if version not in versions or isinstance(version, bool):
            raise WorldError(
                f"{path}: schema version must be {' or '.join(map(str, versions))}, "
                f"got {format_value(version)}"
            )
        arrays = {
            name.removesuffix(".npy"): parse_npy(data, f"{path}: {name:.60}")
            for name, data in contents.items()
        }
        return header, arrays

    def array(
        self, arrays: Arrays, name: str, path: Path, shape: Shape, dtype: str
    ) -> AnyArray:
        """Return a named array; WorldError unless finite, of that shape and dtype.

        Args:
            arrays: The arrays that `read` returned.
            name: Name of the array.
            path: The file, for an error message.
            shape: Length of each side, None for any.
            dtype: Type of its numbers, such as "float32".

        Raises:
            WorldError: If the array is missing, has another shape or type, or contains
                numbers that are not finite.
        """
        if name not in arrays:
            raise WorldError(f"{path}: not {self.what}: it has no {name}.npy")
        array = arrays[name]
        fits = array.ndim == len(shape) and all(
            side in (None, length)
            for side, length in zip(shape, array.shape, strict=True)
        )
        if not fits or array.dtype != np.dtype(dtype):
            sides = " x ".join("any" if side is None else str(side) for side in shape)
            raise WorldError(
                f"{path}: {name} must be {sides} of {dtype}, "
                f"got {array.dtype} of shape {array.shape}"
            )
        if not np.isfinite(array).all():
            raise WorldError(f"{path}: {name} holds values that are not finite")
        return array

    def _unpack(self, path: Path) -> dict[str, bytes]:
        """Read the bytes of all members by name; WorldError if damaged or too large."""
        file = io.BytesIO(read_bytes(path, self.largest_file))
        try:
            with zipfile.ZipFile(file) as archive:
                # zipfile unpacks no more of a member than its size here says.
                size = sum(member.file_size for member in archive.infolist())
                if size > self.largest:
                    raise WorldError(
                        f"{path}: unpacks to more than the allowed {self.largest} bytes"
                    )
                names = archive.namelist()
                refuse_duplicates(names)
                return {name: archive.read(name) for name in names}
        except ZIP_ERRORS as error:
            raise WorldError(
                f"{path}: not {self.what}, or a damaged one: {format_error(error)}"
            ) from None
