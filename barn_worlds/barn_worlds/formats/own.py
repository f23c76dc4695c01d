"""The suite's own data set file: worlds in one small .npz, with a manifest inside it and a copy beside it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import barn_worlds
from barn_worlds.base.errors import WorldError
from barn_worlds.base.files import LARGEST_FILE, write_bytes
from barn_worlds.formats import scenes
from barn_worlds.formats.npz import NpzFormat
from barn_worlds.worlds.world import LARGEST_SIDE, Provenance, World

FORMAT = NpzFormat(
    "a data set of the suite",
    "manifest.json",
    schema=1,
    largest_file=LARGEST_FILE,
    largest=512 * 1024 * 1024,
    newer=(2,),
)
_WITH_SCENES = 2  # the schema of data sets in which anything is no static world; it has the arrays of `scenes` as well
_ARRAYS = {
    "index": 1,  # (n,) number of each world
    "shape": 2,  # (n, 2) rows and columns
    "grid": 1,  # bytes of all grids, each packed separately
    "path": 2,  # (sum of lengths, 2)
    "path_cells": 1,  # (n,) length of each path
    "resolution_m": 1,  # (n,)
    "footprint_cells": 1,  # (n,)
}


@dataclass(frozen=True)
class Order:
    """The order in which worlds are numbered: what the scores mean, and one score per world, lowest first."""

    by: str
    scores: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class OwnFile:
    """The checked content of a data set file; `world` builds one of its worlds."""

    path: Path
    manifest: Mapping[str, Any]
    arrays: Mapping[str, npt.NDArray[Any]]

    @property
    def indices(self) -> list[int]:
        """Numbers of the worlds as they are stored."""
        return [int(index) for index in self.arrays["index"]]

    def world(self, position: int) -> World:
        """Return the world stored at a position; WorldError if it is damaged."""
        a = self.arrays
        where = f"{self.path}: world {int(a['index'][position])}"
        rows, cols = (int(side) for side in a["shape"][position])
        sizes = (np.prod(a["shape"][:position].astype(np.int64), axis=1) + 7) // 8
        first = int(sizes.sum())
        bits = np.unpackbits(a["grid"][first : first + (rows * cols + 7) // 8], count=rows * cols)
        begin = int(a["path_cells"][:position].sum())
        path = a["path"][begin : begin + int(a["path_cells"][position])]
        about = self.manifest["worlds"][position]
        sets = self.manifest["parameter_sets"]
        number = about.get("parameter_set")
        scene: scenes.Scene = ((), (), None)
        if self.manifest["schema"] == _WITH_SCENES:
            scene = scenes.unpacked(a, position, about["moving"], where)
        world = World(
            about["name"],
            bits.reshape(rows, cols).astype(np.bool_),
            path,
            float(a["resolution_m"][position]),
            int(a["footprint_cells"][position]),
            Provenance(
                about["source"],
                str(self.path),
                {} if number is None else sets[number],
                tuple(about["seed"]),
                about["path_source"],
            ),
            *scene,
        )
        if world.checksum != about["sha256"]:
            raise WorldError(f"{where} is damaged: its checksum is not that of the manifest")
        return world


def write_own(path: Path, name: str, worlds: Mapping[int, World], about: Mapping[str, Any] | None = None) -> None:
    """Write worlds by number as a data set file and the manifest beside it (NAME.manifest.json).

    about: more entries for the manifest, such as the order and the generator's parameters.
    """
    chosen = list(worlds.values())
    arrays: dict[str, npt.NDArray[Any]] = {
        "index": np.array(list(worlds), np.int32),
        "shape": np.array([world.grid.shape for world in chosen], np.int32),
        "grid": np.concatenate([np.packbits(world.grid) for world in chosen]),
        "path": np.concatenate([world.path for world in chosen]).astype(np.int16),
        "path_cells": np.array([len(world.path) for world in chosen], np.int32),
        "resolution_m": np.array([world.resolution_m for world in chosen]),
        "footprint_cells": np.array([world.footprint_cells for world in chosen], np.int32),
    }
    manifest = _manifest(name, worlds, about or {})
    if any(world.walls or world.moving or world.corner_m is not None for world in chosen):
        arrays |= scenes.packed(chosen)
        for entry, world in zip(manifest["worlds"], chosen, strict=True):
            entry["moving"] = [one.name for one in world.moving]
        manifest = {"schema": _WITH_SCENES, **manifest}
    text = FORMAT.write(path, manifest, arrays)
    write_bytes(path.with_suffix(".manifest.json"), text.encode())


def read_own(path: Path) -> OwnFile:
    """Return the content of a data set file; WorldError if it is damaged or of another version."""
    manifest, found = FORMAT.read(path)
    arrays = {key: FORMAT.array(found, key, path) for key in _ARRAYS}
    _check_manifest(path, manifest)
    _check_arrays(path, arrays, len(manifest["worlds"]))
    if manifest["schema"] == _WITH_SCENES:
        arrays |= {key: FORMAT.array(found, key, path) for key in scenes.ARRAYS}
        scenes.check(arrays, len(manifest["worlds"]), str(path))
    return OwnFile(path, manifest, arrays)


def _manifest(name: str, worlds: Mapping[int, World], about: Mapping[str, Any]) -> dict[str, Any]:
    sets: list[dict[str, Any]] = []
    entries = []
    for index, world in worlds.items():
        parameters = dict(world.provenance.parameters)
        if parameters and parameters not in sets:
            sets.append(parameters)
        entries.append(
            {
                "index": index,
                "name": world.name,
                "source": world.provenance.source,
                "parameter_set": sets.index(parameters) if parameters else None,
                "seed": list(world.provenance.seed),
                "path_source": world.provenance.path_source,
                "sha256": world.checksum,
            }
        )
    made_by = f"barn_worlds {barn_worlds.__version__}"
    return {"name": name, "made_by": made_by, **about, "parameter_sets": sets, "worlds": entries}


def _check_manifest(path: Path, manifest: Mapping[str, Any]) -> None:
    sets, entries = manifest.get("parameter_sets"), manifest.get("worlds")
    good = isinstance(manifest.get("name"), str) and isinstance(sets, list) and isinstance(entries, list)
    texts = ("name", "source", "path_source", "sha256")
    good = good and isinstance(manifest.get("robot", ""), str)
    scenic = manifest["schema"] == _WITH_SCENES
    for entry in entries if good and isinstance(entries, list) else ():
        number = entry.get("parameter_set") if isinstance(entry, dict) else -1
        good = (
            good
            and (number is None or (isinstance(number, int) and 0 <= number < len(sets or ())))
            and all(isinstance(entry.get(text), str) for text in texts)
            and isinstance(entry.get("seed"), list)
            and (not scenic or _is_texts(entry.get("moving")))
        )
    if not good:
        raise WorldError(f"{path}: its manifest lacks name, parameter_sets or worlds, or they are malformed")


def _is_texts(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(one, str) for one in value)


def _check_arrays(path: Path, arrays: Mapping[str, npt.NDArray[Any]], count: int) -> None:
    for key, dimensions in _ARRAYS.items():
        array = arrays[key]
        kinds = "f" if key == "resolution_m" else "iu"
        per_world = key not in ("grid", "path")
        wrong = array.ndim != dimensions or array.dtype.kind not in kinds or (per_world and len(array) != count)
        if wrong or (array.ndim == 2 and array.shape[1] != 2) or (key == "grid" and array.dtype != np.uint8):
            raise WorldError(f"{path}: {key} is malformed: {array.dtype} of shape {array.shape} for {count} worlds")
    shape, lengths, index = arrays["shape"].astype(np.int64), arrays["path_cells"].astype(np.int64), arrays["index"]
    if count and (shape.min() < 1 or shape.max() > LARGEST_SIDE or lengths.min() < 1 or index.min() < 0):
        raise WorldError(f"{path}: sizes of worlds must be 1 to {LARGEST_SIDE} cells, paths not empty, numbers from 0")
    packed = int(((shape.prod(axis=1) + 7) // 8).sum())
    if packed != len(arrays["grid"]) or int(lengths.sum()) != len(arrays["path"]) or len(set(index.tolist())) != count:
        raise WorldError(f"{path}: sizes of grids, paths and numbers of worlds do not match")
