"""Walls and moving obstacles of worlds as the arrays of a data set file. Equal motions are stored once."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_worlds.base.errors import ConfigError, WorldError
from barn_worlds.moving.motion import KINDS, MOST_KEYS, MOST_MOVING, MOST_WALLS, SHAPES, Motion, MovingObstacle, Wall
from barn_worlds.worlds.world import World

Arrays = Mapping[str, npt.NDArray[Any]]
Scene = tuple[tuple[Wall, ...], tuple[MovingObstacle, ...], tuple[float, float] | None]
ARRAYS = {
    "corner_m": ("f", 2),  # (n, 2) of each world, NaN where it is no arena
    "walls": ("iu", 0),  # (n,) number of walls of each world
    "wall": ("f", 6),  # (sum, 6) as _WALL
    "moving": ("iu", 0),  # (n,) number of moving obstacles of each world
    "obstacle": ("f", 7),  # (sum, 7) place of the shape in SHAPES, then as _OBSTACLE
    "obstacle_motion": ("iu", 0),  # (sum,) number of the motion
    "motion_kind": ("iu", 0),  # (m,) place of the kind in KINDS
    "motion_period_s": ("f", 0),  # (m,)
    "motion_rows": ("iu", 0),  # (m,) number of rows of each motion
    "motion": ("f", 3),  # (sum, 3) of keys: s, x in m, y in m; of a polynomial: power, x in m, y in m
}
_WALL = ("x_m", "y_m", "size_x_m", "size_y_m", "yaw_rad", "height_m")
_OBSTACLE = ("radius_m", "size_x_m", "size_y_m", "yaw_rad", "height_m", "phase_s")
_MOST_OBSTACLES = 1_000_000  # of a data set


def packed(worlds: Sequence[World]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of `ARRAYS` for these worlds; names of moving obstacles are not in them."""
    walls = [wall for world in worlds for wall in world.walls]
    obstacles = [one for world in worlds for one in world.moving]
    motions = {motion: k for k, motion in enumerate(dict.fromkeys(one.motion for one in obstacles))}
    tables = [_rows(motion) for motion in motions]
    return {
        "corner_m": np.array([world.corner_m or (np.nan, np.nan) for world in worlds]),
        "walls": np.array([len(world.walls) for world in worlds], np.int32),
        "wall": _table([[getattr(wall, name) for name in _WALL] for wall in walls], len(_WALL)),
        "moving": np.array([len(world.moving) for world in worlds], np.int32),
        "obstacle": _table(
            [[SHAPES.index(one.shape), *(getattr(one, name) for name in _OBSTACLE)] for one in obstacles], 7
        ),
        "obstacle_motion": np.array([motions[one.motion] for one in obstacles], np.int32),
        "motion_kind": np.array([KINDS.index(motion.kind) for motion in motions], np.uint8),
        "motion_period_s": np.array([motion.period_s for motion in motions]),
        "motion_rows": np.array([len(table) for table in tables], np.int32),
        "motion": np.concatenate([np.empty((0, 3)), *tables]),
    }


def check(arrays: Arrays, worlds: int, where: str) -> None:
    """Raise WorldError, beginning with `where`, unless the arrays of that many worlds fit together."""
    for name, (kinds, width) in ARRAYS.items():
        array = arrays[name]
        if array.dtype.kind not in kinds or array.ndim != (2 if width else 1) or (width and array.shape[1] != width):
            raise WorldError(f"{where}: {name} is malformed: {array.dtype} of shape {array.shape}")
    counts = [
        ("walls", worlds, len(arrays["wall"]), MOST_WALLS),
        ("moving", worlds, len(arrays["obstacle"]), MOST_MOVING),
        ("motion_rows", len(arrays["motion_kind"]), len(arrays["motion"]), MOST_KEYS),
    ]
    for name, entries, total, most in counts:
        numbers = arrays[name].astype(np.int64)
        if len(numbers) != entries or (entries and not 0 <= numbers.min() <= numbers.max() <= most):
            raise WorldError(f"{where}: {name} must be {entries} numbers from 0 to {most}")
        if int(numbers.sum()) != total:
            raise WorldError(f"{where}: {name} adds up to {int(numbers.sum())}, but {total} are there")
    motions, of_each = len(arrays["motion_kind"]), arrays["obstacle_motion"].astype(np.int64)
    same = len(arrays["motion_period_s"]) == motions and len(of_each) == len(arrays["obstacle"]) <= _MOST_OBSTACLES
    if not same or len(arrays["corner_m"]) != worlds:
        raise WorldError(f"{where}: numbers of worlds, obstacles and motions do not match")
    if len(of_each) and not 0 <= of_each.min() <= of_each.max() < motions:
        raise WorldError(f"{where}: obstacle_motion must be from 0 to {motions - 1}")
    if arrays["motion_kind"].max(initial=0) >= len(KINDS) or not np.isin(arrays["obstacle"][:, 0], (0, 1)).all():
        raise WorldError(f"{where}: has a kind of motion or a shape that is not known")


def unpacked(arrays: Arrays, position: int, names: Sequence[str], where: str) -> Scene:
    """Return walls, moving obstacles and corner of the world at a position; WorldError begins with `where`.

    arrays: checked by `check`. names: of the moving obstacles.
    """
    first = int(arrays["moving"][:position].sum())
    count, wall = int(arrays["moving"][position]), int(arrays["walls"][:position].sum())
    if len(names) != count:
        raise WorldError(f"{where}: {len(names)} names of moving obstacles, but {count} of them")
    x_m, y_m = map(float, arrays["corner_m"][position])
    rows = arrays["wall"][wall : wall + int(arrays["walls"][position])]
    try:
        walls = tuple(Wall(**dict(zip(_WALL, row, strict=True))) for row in rows.tolist())
        moving = tuple(_obstacle(arrays, first + k, name) for k, name in enumerate(names))
    except ConfigError as error:
        raise WorldError(f"{where}: {error}") from None
    return walls, moving, None if np.isnan(x_m) and np.isnan(y_m) else (x_m, y_m)


def _obstacle(arrays: Arrays, place: int, name: str) -> MovingObstacle:
    shape, *sizes = arrays["obstacle"][place].tolist()
    motion = int(arrays["obstacle_motion"][place])
    try:
        found = _motion(arrays, motion)
        return MovingObstacle(name, SHAPES[int(shape)], **dict(zip(_OBSTACLE, sizes, strict=True)), motion=found)
    except ConfigError as error:
        raise ConfigError(f"moving obstacle {name!r:.60}: {error}") from None


def _motion(arrays: Arrays, number: int) -> Motion:
    first = int(arrays["motion_rows"][:number].sum())
    rows = arrays["motion"][first : first + int(arrays["motion_rows"][number])].tolist()
    kind, period_s = KINDS[int(arrays["motion_kind"][number])], float(arrays["motion_period_s"][number])
    if kind == "polynomial":
        return Motion(kind, period_s, coefficients_m=tuple((x, y) for _, x, y in rows))
    return Motion(kind, period_s, keys=tuple((time_s, x, y) for time_s, x, y in rows))


def _rows(motion: Motion) -> npt.NDArray[np.float64]:
    if motion.kind == "polynomial":
        return np.array([(power, x, y) for power, (x, y) in enumerate(motion.coefficients_m)], np.float64)
    return np.array(motion.keys, np.float64)


def _table(rows: list[list[Any]], width: int) -> npt.NDArray[np.float64]:
    return np.array(rows, np.float64).reshape(-1, width)
