"""The suite's own data set file: worlds in one small .npz, with a manifest inside it and a copy beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import barn_worlds
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import ConfigError, WorldError, format_error
from barn_worlds.base.files import LARGEST_FILE_BYTES, write_bytes
from barn_worlds.formats.npz import Arrays, NpzFormat
from barn_worlds.moving.motion import KINDS, SHAPES, Motion, MovingObstacle, Wall
from barn_worlds.worlds.course import parse_course
from barn_worlds.worlds.world import LARGEST_SIDE, Provenance, World

_WITH_SCENES = 2  # the schema of data sets in which anything is no static world; it has the arrays of `_scenes` as well
FORMAT = NpzFormat(
    "a data set of the suite",
    "manifest.json",
    1,
    LARGEST_FILE_BYTES,
    1 << 29,
    newer=(_WITH_SCENES,),
)
_NUMBERS = attrgetter(
    "radius_m", "size_x_m", "size_y_m", "yaw_rad", "height_m", "phase_s"
)  # of an obstacle, in order


@dataclass(frozen=True)
class WorldOrder:
    """The order in which worlds are numbered: what the scores mean, and one score per world, lowest first."""

    by: str
    scores: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class DatasetFile:
    """The content of a data set file; `world` builds one of its worlds."""

    path: Path
    manifest: Mapping[str, Any]
    arrays: Arrays

    @property
    def indices(self) -> list[int]:
        """Numbers of the worlds as they are stored."""
        return [int(index) for index in self.arrays["index"]]

    def world(self, position: int) -> World:
        """Return the world stored at a position; WorldError if it is damaged."""
        where = f"{self.path}: world {self.indices[position]}"
        try:
            world = self._world(position)
            same = world.checksum == self.manifest["worlds"][position]["sha256"]
        # of arrays that are missing, of other sizes or types, or do not fit together
        except (
            WorldError,
            ConfigError,
            LookupError,
            TypeError,
            ValueError,
            OverflowError,
        ) as error:
            raise WorldError(f"{where} is damaged: {format_error(error)}") from None
        if not same:
            raise WorldError(
                f"{where} is damaged: its checksum is not that of the manifest"
            )
        return world

    def _world(self, position: int) -> World:
        a, about = self.arrays, self.manifest["worlds"][position]
        rows, cols = (int(side) for side in a["shape"][position])
        if not 1 <= min(rows, cols) <= max(rows, cols) <= LARGEST_SIDE:
            raise ValueError(
                f"sides must be 1 to {LARGEST_SIDE} cells, got {rows} x {cols}"
            )
        sizes = (np.prod(a["shape"][: position + 1].astype(np.int64), axis=1) + 7) // 8
        bits = np.unpackbits(_part(a["grid"], sizes, position), count=rows * cols)
        number = about["parameter_set"]
        parameters = {} if number is None else self.manifest["parameter_sets"][number]
        return World(
            about["name"],
            bits.reshape(rows, cols).astype(np.bool_),
            _part(a["path"], a["path_cells"], position),
            float(a["resolution_m"][position]),
            int(a["footprint_cells"][position]),
            Provenance(
                about["source"],
                str(self.path),
                parameters,
                tuple(about["seed"]),
                about["path_source"],
            ),
            *(
                self._scene(position, about["moving"])
                if self.manifest["schema"] == _WITH_SCENES
                else ((), (), None)
            ),
            *(parse_course(about["course"], "course") if "course" in about else ()),
        )

    def _scene(self, position: int, names: Sequence[str]) -> tuple[Any, ...]:
        """Return walls, moving obstacles of these names, and corner of the world at a position."""
        a = self.arrays
        walls = _part(a["wall"], a["walls"], position).tolist()
        rows = _part(a["obstacle"], a["moving"], position).tolist()
        moving = []
        motions = _part(a["obstacle_motion"], a["moving"], position)
        for name, (shape, *sizes), k in zip(names, rows, motions, strict=True):
            kind, period_s = (
                KINDS[int(a["motion_kind"][k])],
                float(a["motion_period_s"][k]),
            )
            table = tuple(
                map(tuple, _part(a["motion"], a["motion_rows"], int(k)).tolist())
            )
            # a row of a polynomial is power, x and y, of any other motion time, x and y
            parts = (
                ((), tuple(row[1:] for row in table))
                if kind == "polynomial"
                else (table,)
            )
            motion = Motion(kind, period_s, *parts)
            moving.append(MovingObstacle(*(name, SHAPES[int(shape)], *sizes, motion)))
        x_m, y_m = map(float, a["corner_m"][position])
        corner = None if np.isnan(x_m) and np.isnan(y_m) else (x_m, y_m)
        return tuple(Wall(*row) for row in walls), tuple(moving), corner


def _part(
    values: npt.NDArray[Any], counts: npt.NDArray[Any], position: int
) -> npt.NDArray[Any]:
    """Return the entries of one of some that lie behind each other, so many of each."""
    first = int(counts[:position].sum())
    return values[first : first + int(counts[position])]


def write_dataset_file(
    path: Path,
    name: str,
    worlds: Mapping[int, World],
    about: Mapping[str, Any] | None = None,
) -> None:
    """Write worlds by number as a data set file and the manifest beside it (NAME.manifest.json).

    about: more entries for the manifest, such as the order and the generator's parameters.
    """
    chosen = list(worlds.values())
    arrays: Arrays = {
        "index": np.array(list(worlds), np.int32),
        "shape": np.array(
            [world.grid.shape for world in chosen], np.int32
        ),  # rows and columns
        "grid": np.concatenate([np.packbits(world.grid) for world in chosen]),
        "path": np.concatenate([world.path for world in chosen]).astype(np.int16),
        "path_cells": np.array([len(world.path) for world in chosen], np.int32),
        "resolution_m": np.array([world.resolution_m for world in chosen]),
        "footprint_cells": np.array(
            [world.footprint_cells for world in chosen], np.int32
        ),
    }
    manifest = _manifest(name, worlds, about or {})
    if any(
        world.walls or world.moving or world.corner_m is not None for world in chosen
    ):
        arrays |= _scenes(chosen)
        for entry, world in zip(manifest["worlds"], chosen, strict=True):
            entry["moving"] = [one.name for one in world.moving]
        manifest = {"schema": _WITH_SCENES, **manifest}
    text = FORMAT.write(path, manifest, arrays)
    write_bytes(path.with_suffix(".manifest.json"), text.encode())


def read_dataset_file(path: Path) -> DatasetFile:
    """Return the content of a data set file; WorldError if it is damaged or of another version."""
    manifest, arrays = FORMAT.read(path)
    index, worlds = FORMAT.array(arrays, "index", path), manifest.get("worlds")
    if (
        not isinstance(worlds, list)
        or index.shape != (len(worlds),)
        or index.dtype.kind not in "iu"
    ):
        raise WorldError(
            f"{path}: numbers of worlds do not match, or its manifest lacks them"
        )
    if index.min(initial=0) < 0 or len(set(index.tolist())) != len(index):
        raise WorldError(f"{path}: numbers of worlds must be from 0, each once")
    if not isinstance(manifest.get("name"), str) or not isinstance(
        manifest.get("robot", ""), str
    ):
        raise WorldError(
            f"{path}: its manifest lacks a name, or has a robot without one"
        )
    return DatasetFile(path, manifest, arrays)


def _manifest(
    name: str, worlds: Mapping[int, World], about: Mapping[str, Any]
) -> dict[str, Any]:
    sets: list[dict[str, Any]] = []
    entries = []
    for index, world in worlds.items():
        origin, parameters = world.provenance, dict(world.provenance.parameters)
        if parameters and parameters not in sets:
            sets.append(parameters)
        entry: dict[str, Any] = {
            "index": index,
            "name": world.name,
            "source": origin.source,
        }
        entry["parameter_set"] = sets.index(parameters) if parameters else None
        entry |= {
            "seed": list(origin.seed),
            "path_source": origin.path_source,
            "sha256": world.checksum,
        }
        entries.append(
            entry
            | ({"course": list(world.course_numbers)} if world.course_numbers else {})
        )
    made_by = f"barn_worlds {barn_worlds.__version__}"
    return {
        "name": name,
        "made_by": made_by,
        **about,
        "parameter_sets": sets,
        "worlds": entries,
    }


def _scenes(worlds: Sequence[World]) -> Arrays:
    """Return walls and moving obstacles of worlds as arrays, equal motions once; names are not in them."""
    walls = [wall for world in worlds for wall in world.walls]
    obstacles = [one for world in worlds for one in world.moving]
    motions = {
        motion: k
        for k, motion in enumerate(dict.fromkeys(one.motion for one in obstacles))
    }
    shaped = [(SHAPES.index(one.shape), *_NUMBERS(one)) for one in obstacles]
    return {
        "corner_m": np.array(
            [world.corner_m or (np.nan, np.nan) for world in worlds]
        ),  # NaN where it is no arena
        "walls": np.array([len(world.walls) for world in worlds], np.int32),
        "wall": _table([astuple(wall) for wall in walls], 6),
        "moving": np.array([len(world.moving) for world in worlds], np.int32),
        "obstacle": _table(shaped, 7),
        "obstacle_motion": np.array(
            [motions[one.motion] for one in obstacles], np.int32
        ),
        "motion_kind": np.array(
            [KINDS.index(motion.kind) for motion in motions], np.uint8
        ),
        "motion_period_s": np.array([motion.period_s for motion in motions]),
        "motion_rows": np.array(
            [len(_rows_of(motion)) for motion in motions], np.int32
        ),
        "motion": _table([row for motion in motions for row in _rows_of(motion)], 3),
    }


def _rows_of(motion: Motion) -> Sequence[tuple[float, float, float]]:
    return motion.keys or [
        (power, x, y) for power, (x, y) in enumerate(motion.coefficients_m)
    ]


def _table(rows: Sequence[Sequence[float]], width: int) -> Floats:
    return np.array(rows, np.float64).reshape(-1, width)
