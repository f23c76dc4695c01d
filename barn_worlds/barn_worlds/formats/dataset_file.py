"""The suite's data set file: worlds in one .npz, with a copy of its manifest."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from itertools import starmap
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

import barn_worlds
from barn_worlds.base.arrays import AnyArray, Floats
from barn_worlds.base.errors import BarnError, WorldError, format_error
from barn_worlds.base.files import LARGEST_FILE_BYTES, write_bytes
from barn_worlds.formats.npz import Arrays, NpzFormat
from barn_worlds.moving.motion import KINDS, SHAPES, Motion, MovingObstacle, Wall
from barn_worlds.worlds.course import parse_course
from barn_worlds.worlds.world import LARGEST_SIDE, Provenance, World

# Schema of data sets with walls, moving obstacles or arenas, which also need the arrays
# of `_scene_arrays`. Others keep the first schema, which earlier versions can read.
_SCENE_SCHEMA = 2
# Fields of a moving obstacle in the columns of the array `obstacle`, after the shape.
_OBSTACLE_NUMBERS = (
    "radius_m",
    "size_x_m",
    "size_y_m",
    "yaw_rad",
    "height_m",
    "phase_s",
)
FORMAT = NpzFormat(
    "a data set of the suite",
    "manifest.json",
    schema=1,
    largest_file=LARGEST_FILE_BYTES,
    largest=1 << 29,
    other_schemas=(_SCENE_SCHEMA,),
)


@dataclass(frozen=True)
class WorldOrder:
    """The order in which the worlds of a data set are numbered."""

    by: str
    """Meaning of the scores."""

    scores: tuple[float, ...]
    """One score per world."""


@dataclass(frozen=True, eq=False)
class DatasetFile:
    """The content of a data set file."""

    path: Path
    manifest: Mapping[str, Any]
    arrays: Arrays

    @property
    def indices(self) -> list[int]:
        """Numbers of the worlds, by their position in the file."""
        indices: list[int] = self.arrays["index"].tolist()
        return indices

    def world(self, position: int) -> World:
        """Build the world at a position (not number); WorldError if it is damaged.

        Raises:
            WorldError: If its data are damaged or do not match the checksum.
        """
        where = f"{self.path}: world {self.indices[position]} is damaged"
        try:
            world = self._build_world(position)
            is_intact = world.checksum == self.manifest["worlds"][position]["sha256"]
        # Raised by arrays that are missing or have wrong sizes or values.
        except (BarnError, LookupError, ValueError, OverflowError) as error:
            raise WorldError(f"{where}: {format_error(error)}") from None
        except (AttributeError, TypeError):
            raise WorldError(f"{where}: an entry has a different type") from None
        if not is_intact:
            raise WorldError(f"{where}: its checksum differs from the manifest's")
        return world

    def _build_world(self, position: int) -> World:
        """Build the world at a position, unchecked by checksum; any error if bad."""
        arrays = self.arrays
        entry = self.manifest["worlds"][position]
        rows, cols = map(int, arrays["shape"][position])
        if not 1 <= min(rows, cols) <= max(rows, cols) <= LARGEST_SIDE:
            raise ValueError(
                f"sides must be 1 to {LARGEST_SIDE} cells, got {rows} x {cols}"
            )
        # Each grid is packed to whole bytes.
        shapes = arrays["shape"][: position + 1].astype(np.int64)
        packed = _select(arrays["grid"], (np.prod(shapes, axis=1) + 7) // 8, position)
        bits = np.unpackbits(packed, count=rows * cols)

        parameters = {}
        if entry["parameter_set"] is not None:
            parameters = self.manifest["parameter_sets"][entry["parameter_set"]]
        provenance = Provenance(
            entry["source"],
            str(self.path),
            parameters,
            tuple(entry["seed"]),
            entry["path_source"],
        )
        scene: dict[str, Any] = {}
        if self.manifest["schema"] == _SCENE_SCHEMA:
            scene = self._build_scene(position, entry["moving"])
        if "course" in entry:
            scene["start"], scene["goal"] = parse_course(entry["course"], "course")
        return World(
            entry["name"],
            bits.reshape(rows, cols).astype(np.bool_),
            _select(arrays["path"], arrays["path_cells"], position),
            float(arrays["resolution_m"][position]),
            int(arrays["footprint_cells"][position]),
            provenance,
            **scene,
        )

    def _build_scene(self, position: int, names: Sequence[str]) -> dict[str, Any]:
        """Return walls, moving obstacles and corner of a world, by field of `World`.

        Args:
            position: Position of the world in the file.
            names: Names of its moving obstacles.
        """
        arrays = self.arrays
        walls = _select(arrays["wall"], arrays["walls"], position).tolist()
        obstacles = _select(arrays["obstacle"], arrays["moving"], position).tolist()
        motions = _select(arrays["obstacle_motion"], arrays["moving"], position)
        moving = []
        for name, row, index in zip(names, obstacles, motions, strict=True):
            numbers = dict(zip(_OBSTACLE_NUMBERS, row[1:], strict=True))
            motion = self._build_motion(int(index))
            shape = SHAPES[int(row[0])]
            moving.append(MovingObstacle(name, shape, motion=motion, **numbers))
        scene: dict[str, Any] = {
            "walls": tuple(starmap(Wall, walls)),
            "moving": tuple(moving),
        }
        x_m, y_m = map(float, arrays["corner_m"][position])
        # Only arenas have a corner.
        if not (np.isnan(x_m) and np.isnan(y_m)):
            scene["corner_m"] = (x_m, y_m)
        return scene

    def _build_motion(self, index: int) -> Motion:
        """Return the motion with an index in the file's arrays of motions."""
        arrays = self.arrays
        rows = _select(arrays["motion"], arrays["motion_rows"], index).tolist()
        kind = KINDS[int(arrays["motion_kind"][index])]
        period_s = float(arrays["motion_period_s"][index])
        if kind == "polynomial":
            # The first column is the power, which is also the number of the row.
            coefficients_m = tuple((x, y) for _, x, y in rows)
            return Motion(kind, period_s, coefficients_m=coefficients_m)
        return Motion(kind, period_s, keys=tuple(map(tuple, rows)))


def read_dataset_file(path: Path) -> DatasetFile:
    """Read manifest and arrays of a data set's .npz; WorldError unless they match.

    Raises:
        BarnError: If the file is damaged or of another version.
    """
    manifest, arrays = FORMAT.read(path)
    index = arrays.get("index", np.empty(0))
    worlds = manifest.get("worlds")
    if (
        not isinstance(worlds, list)
        or index.shape != (len(worlds),)
        or index.dtype.kind not in "iu"
    ):
        raise WorldError(
            f"{path}: its world numbers do not match its manifest, or one lacks them"
        )
    if index.min(initial=0) < 0 or len(set(index.tolist())) != len(index):
        raise WorldError(f"{path}: world numbers must be at least 0 and unique")
    names = (manifest.get("name"), manifest.get("robot", ""))
    if not all(isinstance(name, str) for name in names):
        raise WorldError(
            f"{path}: its manifest lacks a name, or its robot is not a name"
        )
    return DatasetFile(path, manifest, arrays)


def write_dataset_file(
    path: Path,
    name: str,
    worlds: Mapping[int, World],
    extra_entries: Mapping[str, Any] | None = None,
) -> None:
    """Write a data set's .npz and .manifest.json; WorldError for a surveyed world.

    Args:
        path: File to write.
        name: Name of the data set.
        worlds: Worlds by number.
        extra_entries: Further entries of the manifest, such as generator parameters.

    Raises:
        WorldError: If a file cannot be written, or a world was surveyed.
    """
    ordered = list(worlds.values())
    for world in ordered:
        if world.built_m is not None:
            raise WorldError(
                f"{path}: a data set cannot hold {world.name} as built; write it as"
                " yaml"
            )
    arrays: Arrays = {
        "index": np.array(list(worlds), np.int32),
        "shape": np.array([world.grid.shape for world in ordered], np.int32),
        "grid": np.concatenate([np.packbits(world.grid) for world in ordered]),
        # Sides have at most 2000 cells, so 16 bits are enough.
        "path": np.concatenate([world.path for world in ordered]).astype(np.int16),
        "path_cells": np.array([len(world.path) for world in ordered], np.int32),
        "resolution_m": np.array([world.resolution_m for world in ordered]),
        "footprint_cells": np.array(
            [world.footprint_cells for world in ordered], np.int32
        ),
    }
    manifest = _manifest(name, worlds, extra_entries or {})
    if any(
        world.walls or world.moving or world.corner_m is not None for world in ordered
    ):
        # Data sets without these arrays stay readable for earlier versions.
        arrays |= _scene_arrays(ordered)
        for entry, world in zip(manifest["worlds"], ordered, strict=True):
            entry["moving"] = [obstacle.name for obstacle in world.moving]
        manifest = {"schema": _SCENE_SCHEMA, **manifest}
    # The copy of the manifest is for people; the suite reads the one in the file.
    text = FORMAT.write(path, manifest, arrays)
    write_bytes(path.with_suffix(".manifest.json"), text.encode())


def _manifest(
    name: str, worlds: Mapping[int, World], extra_entries: Mapping[str, Any]
) -> dict[str, Any]:
    """Return a data set's manifest, with provenance and checksum of each world."""
    # Many worlds have the same parameters, which the manifest holds once.
    parameter_sets: list[dict[str, Any]] = []
    entries = []
    for index, world in worlds.items():
        provenance = world.provenance
        parameters = dict(provenance.parameters)
        if parameters and parameters not in parameter_sets:
            parameter_sets.append(parameters)
        entry = {
            "index": index,
            "name": world.name,
            "source": provenance.source,
            "parameter_set": parameter_sets.index(parameters) if parameters else None,
            "seed": list(provenance.seed),
            "path_source": provenance.path_source,
            "sha256": world.checksum,
        }
        if world.course_numbers:
            entry["course"] = list(world.course_numbers)
        entries.append(entry)
    return {
        "name": name,
        "made_by": f"barn_worlds {barn_worlds.__version__}",
        **extra_entries,
        "parameter_sets": parameter_sets,
        "worlds": entries,
    }


def _scene_arrays(worlds: Sequence[World]) -> Arrays:
    """Return corners, walls and moving obstacles of worlds as arrays by name.

    The arrays do not contain the obstacles' names.
    """
    walls = [astuple(wall) for world in worlds for wall in world.walls]
    obstacles = [obstacle for world in worlds for obstacle in world.moving]
    # Equal motions are stored once.
    motions = list(dict.fromkeys(obstacle.motion for obstacle in obstacles))
    motion_indices = {motion: index for index, motion in enumerate(motions)}
    numbers = attrgetter(*_OBSTACLE_NUMBERS)
    rows = []
    for obstacle in obstacles:
        rows.append((SHAPES.index(obstacle.shape), *numbers(obstacle)))
    # Keys, or power, x and y of coefficients.
    motion_rows = [
        motion.keys or [(power, *xy) for power, xy in enumerate(motion.coefficients_m)]
        for motion in motions
    ]
    not_arena = (np.nan, np.nan)
    return {
        "corner_m": np.array([world.corner_m or not_arena for world in worlds]),
        "walls": np.array([len(world.walls) for world in worlds], np.int32),
        "wall": _table(walls, 6),
        "moving": np.array([len(world.moving) for world in worlds], np.int32),
        "obstacle": _table(rows, 7),
        "obstacle_motion": np.array(
            [motion_indices[obstacle.motion] for obstacle in obstacles], np.int32
        ),
        "motion_kind": np.array(
            [KINDS.index(motion.kind) for motion in motions], np.uint8
        ),
        "motion_period_s": np.array([motion.period_s for motion in motions]),
        "motion_rows": np.array(list(map(len, motion_rows)), np.int32),
        "motion": _table([row for rows in motion_rows for row in rows], 3),
    }


def _table(rows: Sequence[Sequence[float]], width: int) -> Floats:
    """Return rows of numbers as a float array (n, width), (0, width) for no rows."""
    return np.array(rows, np.float64).reshape(-1, width)


def _select(values: AnyArray, counts: AnyArray, position: int) -> AnyArray:
    """Return the values of one world or motion from an array that joins those of all.

    Args:
        values: Values of all worlds or motions, one after the other.
        counts: Number of values of each.
        position: Position of the world or motion.
    """
    first = int(counts[:position].sum())
    return values[first : first + int(counts[position])]
