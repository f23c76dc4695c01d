"""Files of weights: a header in JSON and plain arrays in one .npz, judged before anything is used.

Nothing in such a file is executed, no pickle is read, and sizes are bounded before memory is taken. The header names
the schema, the inputs and the parts; the arrays have to fit it exactly and to be finite, and their checksum is in it.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
import zlib
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.errors import ModelError
from barn_metrics.model.inputs import INPUTS, input_names
from barn_metrics.model.members import KINDS, Arrays, flatten, read_member
from barn_metrics.model.predictor import DifficultyModel
from barn_worlds.errors import WorldError, suggest
from barn_worlds.formats.files import read_bytes, write_bytes
from barn_worlds.formats.npy import parse_npy, to_npy

SCHEMA = 1
LARGEST_FILE = 32 * 1024 * 1024
LARGEST_UNPACKED = 128 * 1024 * 1024
_HEADER = "header.json"
_MOST_MEMBERS, _MOST_LAYERS, _MOST_PLANNERS = 64, 8, 16


def shipped_weights() -> Path:
    """Return the file of the weights that come with the package, trained in generated worlds that are not barn300's."""
    return Path(str(resources.files("barn_metrics"))) / "data" / "difficulty.npz"


def save_model(model: DifficultyModel, path: Path) -> None:
    """Write a model; the same model gives the same bytes. WorldError if the file cannot be written."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    parts = [flatten(member, f"m{number}", arrays) for number, member in enumerate(model.members)]
    header = {
        "schema": SCHEMA,
        "recipe": model.recipe,
        "inputs": model.inputs,
        "input_names": list(input_names(model.inputs)),
        "planners": list(model.planners),
        "relative_std": model.relative_std,
        "members": parts,
        "about": dict(model.about),
        "sha256": _checksum(arrays),
    }
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        contents = {_HEADER: (json.dumps(header, indent=1) + "\n").encode()}
        contents |= {f"{name}.npy": to_npy(array) for name, array in arrays.items()}
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED, 9)
    write_bytes(path, file.getvalue())


def load_model(path: Path | str | None = None) -> DifficultyModel:
    """Return the model of a file, or the shipped one; ModelError in one line for a file that is no sound model."""
    where = shipped_weights() if path is None else Path(path)
    try:
        return _read(where)
    except WorldError as error:
        raise ModelError(str(error)) from None


def _read(where: Path) -> DifficultyModel:
    header, arrays = _unpack(where)
    parts = _checked_header(header, where)
    if header["sha256"] != _checksum(arrays):
        raise ModelError(f"{where}: damaged: its arrays do not have the checksum of the header")
    outputs = 2 * len(header["planners"]) or 1
    members = tuple(
        read_member(part, f"m{number}", arrays, (header["inputs"], outputs), where) for number, part in enumerate(parts)
    )
    if abs(sum(member.weight for member in members) - 1.0) > 1e-6:
        raise ModelError(f"{where}: weights of the members must add up to 1")
    planners = tuple(header["planners"])
    return DifficultyModel(
        header["recipe"], header["inputs"], planners, members, float(header["relative_std"]), header["about"]
    )


def _unpack(where: Path) -> tuple[Any, dict[str, npt.NDArray[Any]]]:
    content = read_bytes(where, LARGEST_FILE)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > LARGEST_UNPACKED:
                raise ModelError(f"{where}: unpacks to more than the allowed {LARGEST_UNPACKED} bytes")
            if _HEADER not in archive.namelist():
                raise ModelError(f"{where}: holds no difficulty model: it has no {_HEADER}")
            contents = {member.filename: archive.read(member) for member in members}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError) as error:
        raise ModelError(f"{where}: damaged or no .npz file: {' '.join(str(error).split())[:200]}") from None
    try:
        header = json.loads(contents.pop(_HEADER))
    except (ValueError, RecursionError):
        raise ModelError(f"{where}: its {_HEADER} is not JSON") from None
    return header, {
        name.removesuffix(".npy"): parse_npy(data, f"{where}: {name:.60}") for name, data in contents.items()
    }


def _checked_header(header: Any, where: Path) -> list[dict[str, Any]]:
    """Return the parts that a sound header names."""
    version = header.get("schema") if isinstance(header, dict) else None
    if not isinstance(header, dict) or version != SCHEMA or isinstance(version, bool):
        raise ModelError(f"{where}: schema version must be {SCHEMA}, got {version!r:.40}")
    inputs, planners, parts = header.get("inputs"), header.get("planners"), header.get("members")
    if not isinstance(inputs, str) or inputs not in INPUTS:
        raise ModelError(f"{where}: unknown set of inputs {inputs!r:.40}{suggest(inputs, INPUTS)}")
    if header.get("input_names") != list(input_names(inputs)):
        raise ModelError(f"{where}: was trained on other inputs than this version's set {inputs!r}; train it anew")
    if not _texts(planners, _MOST_PLANNERS) or not isinstance(parts, list) or not 1 <= len(parts) <= _MOST_MEMBERS:
        raise ModelError(f"{where}: header must list planners and 1 to {_MOST_MEMBERS} members")
    spread = header.get("relative_std")
    sound = isinstance(header.get("about"), dict) and isinstance(header.get("recipe"), str)
    if not sound or not _number(spread, 0.0, 1e6) or not isinstance(header.get("sha256"), str):
        raise ModelError(f"{where}: header lacks recipe, about, sha256 or a relative_std of 0 or more")
    for number, part in enumerate(parts):
        known = isinstance(part, dict) and part.get("kind") in KINDS
        if not known or not _number(part.get("weight"), 0.0, 1.0):
            raise ModelError(f"{where}: member {number} must be a {' or '.join(KINDS)} with a weight from 0 to 1")
        layers = part.get("layers")
        if part["kind"] != "forest" and not (type(layers) is int and 1 <= layers <= _MOST_LAYERS):
            raise ModelError(f"{where}: member {number} must have 1 to {_MOST_LAYERS} layers, got {layers!r:.40}")
    return parts


def _checksum(arrays: Arrays) -> str:
    """Return SHA-256 over names, types, shapes and contents."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _texts(value: Any, most: int) -> bool:
    return (
        isinstance(value, list) and len(value) <= most and all(isinstance(one, str) and len(one) < 100 for one in value)
    )


def _number(value: Any, low: float, high: float) -> bool:
    return type(value) in (int, float) and math.isfinite(value) and low <= value <= high
