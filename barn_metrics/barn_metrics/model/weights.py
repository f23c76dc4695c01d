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
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_metrics.model.errors import ModelError
from barn_metrics.model.forest import Forest
from barn_metrics.model.inputs import INPUTS, input_names
from barn_metrics.model.network import Network
from barn_metrics.model.predictor import DifficultyModel, Member
from barn_worlds.errors import WorldError, suggest
from barn_worlds.formats.files import read_bytes, write_bytes
from barn_worlds.formats.npy import parse_npy, to_npy

SCHEMA = 1
LARGEST_FILE = 32 * 1024 * 1024
LARGEST_UNPACKED = 128 * 1024 * 1024
_HEADER = "header.json"
_MOST_MEMBERS, _MOST_LAYERS, _MOST_PLANNERS = 64, 8, 16
_TREE_ARRAYS = {"roots": "i4", "column": "i2", "threshold": "f8", "left": "i4", "right": "i4", "value": "f4"}

Arrays = Mapping[str, npt.NDArray[Any]]


def shipped_weights() -> Path:
    """Return the file of the weights that come with the package, trained on trials in barn300."""
    return Path(str(resources.files("barn_metrics"))) / "data" / "difficulty_barn300.npz"


def save_model(model: DifficultyModel, path: Path) -> None:
    """Write a model; the same model gives the same bytes. WorldError if the file cannot be written."""
    arrays: dict[str, npt.NDArray[Any]] = {}
    parts = [_flatten(member, f"m{number}", arrays) for number, member in enumerate(model.members)]
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
    size = len(input_names(header["inputs"]))
    outputs = 2 * len(header["planners"]) or 1
    members = tuple(_member(part, f"m{number}", arrays, (size, outputs), where) for number, part in enumerate(parts))
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
        known = isinstance(part, dict) and part.get("kind") in ("network", "forest")
        if not known or not _number(part.get("weight"), 0.0, 1.0):
            raise ModelError(f"{where}: member {number} must be a network or forest with a weight from 0 to 1")
        layers = part.get("layers")
        if part["kind"] == "network" and not (type(layers) is int and 1 <= layers <= _MOST_LAYERS):
            raise ModelError(f"{where}: member {number} must have 1 to {_MOST_LAYERS} layers, got {layers!r:.40}")
    return parts


def _flatten(member: Member, prefix: str, arrays: dict[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """Add a member's arrays under a prefix and return its line of the header."""
    function = member.function
    if isinstance(function, Forest):
        arrays |= {
            f"{prefix}_{name}": getattr(function, name).astype("<" + kind) for name, kind in _TREE_ARRAYS.items()
        }
        return {"kind": "forest", "weight": member.weight, "trees": len(function.roots)}
    arrays[f"{prefix}_mean"], arrays[f"{prefix}_std"] = (one.astype("<f8") for one in (function.mean, function.std))
    for number, (weights, bias) in enumerate(function.layers):
        arrays[f"{prefix}_weights{number}"], arrays[f"{prefix}_bias{number}"] = (
            weights.astype("<f8"),
            bias.astype("<f8"),
        )
    sizes = [len(function.mean), *(len(bias) for _, bias in function.layers)]
    return {"kind": "network", "weight": member.weight, "layers": len(function.layers), "sizes": sizes}


def _member(part: Mapping[str, Any], prefix: str, arrays: Arrays, ends: tuple[int, int], where: Path) -> Member:
    weight = float(part["weight"])
    if part["kind"] == "forest":
        return Member(_forest(prefix, arrays, ends, where), weight)
    mean, std = (_array(arrays, f"{prefix}_{name}", (ends[0],), "f8", where) for name in ("mean", "std"))
    if not (std > 0.0).all():
        raise ModelError(f"{where}: {prefix}_std must be above 0")
    layers = []
    width = ends[0]
    for number in range(part["layers"]):
        last = number == part["layers"] - 1
        weights = _array(arrays, f"{prefix}_weights{number}", (width, ends[1] if last else None), "f8", where)
        width = weights.shape[1]
        layers.append((weights, _array(arrays, f"{prefix}_bias{number}", (width,), "f8", where)))
    return Member(Network(mean, std, tuple(layers)), weight)


def _forest(prefix: str, arrays: Arrays, ends: tuple[int, int], where: Path) -> Forest:
    nodes = len(_array(arrays, f"{prefix}_column", (None,), "i2", where))
    shapes: dict[str, tuple[int | None, ...]] = dict.fromkeys(_TREE_ARRAYS, (nodes,))
    shapes |= {"roots": (None,), "value": (nodes, ends[1])}
    read = {name: _array(arrays, f"{prefix}_{name}", shapes[name], kind, where) for name, kind in _TREE_ARRAYS.items()}
    forest = Forest(**read)
    inner = forest.column >= 0
    after = np.stack([forest.left, forest.right])[:, inner]
    # A way down leads to later nodes only, so that it ends.
    sound = (
        nodes > 0
        and len(forest.roots) > 0
        and ((forest.roots >= 0) & (forest.roots < nodes)).all()
        and ((forest.column >= -1) & (forest.column < ends[0])).all()
        and ((after > np.flatnonzero(inner)) & (after < nodes)).all()
    )
    if not sound:
        raise ModelError(f"{where}: {prefix} is no forest: a node leads outside, back, or looks at no input")
    return forest


def _array(arrays: Arrays, name: str, shape: tuple[int | None, ...], kind: str, where: Path) -> npt.NDArray[Any]:
    """Return an array of the shape (None: any) and kind that it must have, all its values finite."""
    if name not in arrays:
        raise ModelError(f"{where}: has no array {name}")
    array = arrays[name]
    fits = array.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))
    if not fits or array.dtype != np.dtype("<" + kind):
        wanted = " x ".join("any" if side is None else str(side) for side in shape)
        raise ModelError(f"{where}: {name} must be {wanted} of {kind}, got {array.dtype} of shape {array.shape}")
    if not np.isfinite(array).all():
        raise ModelError(f"{where}: {name} holds values that are not finite")
    return array


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
