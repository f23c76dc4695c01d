"""Untrusted .npz files of plain arrays and a header in JSON: bounded in size, and nothing in them is executed."""

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy.typing as npt

from barn_worlds.errors import WorldError, shown
from barn_worlds.formats.files import read_bytes, write_bytes
from barn_worlds.formats.npy import one_line, parse_npy, to_npy

Arrays = dict[str, npt.NDArray[Any]]

_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError)


@dataclass(frozen=True)
class NpzFormat:
    """A kind of .npz file.

    what: its name in messages, such as "a policy file". header: the header's file name inside, such as "policy.json".
    schema: the version that the header must have. largest: most bytes of a file, packed and unpacked.
    """

    what: str
    header: str
    schema: int
    largest: int

    def write(self, path: Path, header: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> str:
        """Write a file atomically and return the text of its header; equal content gives equal bytes."""
        text = json.dumps({"schema": self.schema, **header}, indent=1) + "\n"
        members = [(self.header, text.encode()), *((f"{name}.npy", to_npy(array)) for name, array in arrays.items())]
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            for name, content in members:
                archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED, 9)
        write_bytes(path, file.getvalue())
        return text

    def read(self, path: Path) -> tuple[dict[str, Any], Arrays]:
        """Return the header and the arrays by name; WorldError if the file is damaged or of another version."""
        try:
            with zipfile.ZipFile(io.BytesIO(read_bytes(path, self.largest))) as archive:
                if sum(member.file_size for member in archive.infolist()) > self.largest:
                    raise WorldError(f"{path}: unpacks to more than the allowed {self.largest} bytes")
                contents = {name: archive.read(name) for name in archive.namelist()}
        except _DAMAGED as error:
            raise WorldError(f"{path}: not {self.what}, or a damaged one: {one_line(error)}") from None
        if self.header not in contents:
            raise WorldError(f"{path}: not {self.what}: it has no {self.header}")
        try:
            header = json.loads(contents.pop(self.header))
        except (ValueError, RecursionError):
            raise WorldError(f"{path}: its {self.header} is not JSON") from None
        version = header.get("schema") if isinstance(header, dict) else None
        if version != self.schema or isinstance(version, bool):
            raise WorldError(f"{path}: schema version must be {self.schema}, got {shown(version)}")
        arrays = {name.removesuffix(".npy"): parse_npy(data, f"{path}: {name:.60}") for name, data in contents.items()}
        return header, arrays

    def array(self, arrays: Arrays, name: str, path: Path) -> npt.NDArray[Any]:
        """Return the array of that name; WorldError if the file at `path` does not have it."""
        if name not in arrays:
            raise WorldError(f"{path}: not {self.what}: it has no {name}.npy")
        return arrays[name]
