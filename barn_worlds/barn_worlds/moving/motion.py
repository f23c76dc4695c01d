"""Obstacles that move, as data: their shapes, their motions and the walls around them.

Nothing of the robot changes a motion, and obstacles pass through each other and through walls: where one is depends on
the time alone.
"""

import json
import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, as_dict, quantity
from barn_worlds.base.errors import ConfigError, WorldError, format_value

MOST_MOVING = 1000  # obstacles of a world
MOST_WALLS = 1000
MOST_KEYS = 10_000  # of a motion
MOST_COEFFICIENTS = 16
KINDS = ("gazebo", "linear", "polynomial")
SHAPES = ("cylinder", "box")
CLOSED_M = 1e-6  # how far apart begin and end of a closed polynomial may be

_FARTHEST_M = 10_000.0
_LARGEST_M = 1000.0
_SMALLEST_M = 0.01
_LARGEST_NAME = 200
_LONGEST_PERIOD_S = 100_000.0
_SAME_POINT_M = 1e-3  # ignition::math::Vector3 takes coordinates this near for equal


@dataclass(frozen=True)
class Motion(Checked):
    """A path over time that repeats.

    gazebo: keys (time in s, x, y in m), and between them what Gazebo Classic's PoseAnimation does: a cubic Hermite
    curve over the share of the time between two keys, uniform Catmull-Rom tangents of tension 0. The tangent at an end
    is half the step to its neighbour; if the first and the last key are one place it is that of a closed curve. (Below
    a millionth of a segment Gazebo rounds down to the key; this does not.) linear: straight between keys. Both rest at
    the last key until the period ends, then jump to the first; they rest at the first key before its time.

    polynomial: coefficients (x, y in m) of the powers 0, 1, 2, ... of the share of the period that has passed; they
    must end where they begin, so there is no jump.
    """

    kind: str = quantity(
        "gazebo", "how positions between keys are found", choices=KINDS
    )
    period_s: float = quantity(
        10.0, "time after which it repeats", "s", 0.001, _LONGEST_PERIOD_S
    )
    keys: tuple[tuple[float, float, float], ...] = ()
    coefficients_m: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        polynomial = self.kind == "polynomial"
        given, other = (
            ("coefficients_m", "keys") if polynomial else ("keys", "coefficients_m")
        )
        most = MOST_COEFFICIENTS if polynomial else MOST_KEYS
        number = len(getattr(self, given))
        if not 2 <= number <= most:
            raise ConfigError(
                f"{given} of a {self.kind} motion must be 2 to {most}, got {number}"
            )
        if getattr(self, other):
            raise ConfigError(f"{other} must be left out for a {self.kind} motion")
        if not polynomial:
            self._check_keys()
            return
        table = self._table("coefficients_m", self.coefficients_m, 2, "x and y")
        gap_m = max(abs(math.fsum(axis)) for axis in table[1:].T.tolist())
        if gap_m > CLOSED_M:
            raise ConfigError(
                f"coefficients_m must end where they begin, to {CLOSED_M:g} m, but end {gap_m:g} m off"
            )

    def pieces(self) -> tuple[Floats, Floats, Floats]:
        """Return begin (n,) and duration (n,) in s of n pieces, and their coefficients (n, 2, k) in m.

        coefficients: of x and y, of the powers 0, 1, ... of the share of the piece that has passed.
        """
        if self.kind == "polynomial":
            return (
                np.zeros(1),
                np.array([self.period_s]),
                np.array(self.coefficients_m).T[None],
            )
        table = np.array(self.keys)
        begin, points = table[:, 0], table[:, 1:]
        steps = np.diff(points, axis=0)
        parts = [points[:-1], steps]
        if self.kind == "gazebo":
            tangents = _tangents(points)
            out, into = tangents[:-1], tangents[1:]
            parts = [
                points[:-1],
                out,
                3.0 * steps - 2.0 * out - into,
                out + into - 2.0 * steps,
            ]
        return begin[:-1], np.diff(begin), np.stack(parts, axis=2)

    def _check_keys(self) -> None:
        table = self._table("keys", self.keys, 3, "time, x and y")
        times_s = table[:, 0]
        for place in np.flatnonzero(times_s < 0.0):
            raise ConfigError(
                f"keys[{place}] must not be before 0 s, got {times_s.min():g} s"
            )
        for place in np.flatnonzero(np.diff(times_s) <= 0.0):
            before, after = times_s[place : place + 2]
            rule = (
                f"must be later than the key before, at {before:g} s, got {after:g} s"
            )
            raise ConfigError(f"keys[{place + 1}] {rule}")
        rule = f"must not be shorter than the time of the last key, {times_s[-1]:g} s"
        self.require(self.period_s >= times_s[-1], "period_s", rule)

    def _table(
        self, name: str, rows: tuple[tuple[float, ...], ...], width: int, meaning: str
    ) -> Floats:
        """Return rows of numbers as an array (n, width)."""
        for number, row in enumerate(rows):
            if len(row) != width:
                raise ConfigError(
                    f"{name}[{number}] must be {meaning}, got {len(row)} numbers"
                )
        table: Floats = np.array(rows, np.float64)
        limits = [_LONGEST_PERIOD_S, _FARTHEST_M, _FARTHEST_M][-width:]
        for place in np.flatnonzero(~(np.abs(table) <= limits).all(axis=1)):
            raise ConfigError(
                f"{name}[{place}] must be finite, up to {_FARTHEST_M:g} m, got {list(rows[place])}"
            )
        return table


def _tangents(points: Floats) -> Floats:
    """Return the tangents (n, 2) of Gazebo Classic's spline through points (n, 2)."""
    tangents = np.empty_like(points)
    tangents[1:-1] = (points[2:] - points[:-2]) * 0.5
    if np.all(np.abs(points[0] - points[-1]) <= _SAME_POINT_M):
        tangents[[0, -1]] = (points[1] - points[-2]) * 0.5
    else:
        tangents[0], tangents[-1] = (
            (points[1] - points[0]) * 0.5,
            (points[-1] - points[-2]) * 0.5,
        )
    return tangents


@dataclass(frozen=True)
class Wall(Checked):
    """A box that stands upright on the ground, its centre at x, y in the map frame."""

    x_m: float = quantity(0.0, "x of its centre", "m", -_FARTHEST_M, _FARTHEST_M)
    y_m: float = quantity(0.0, "y of its centre", "m", -_FARTHEST_M, _FARTHEST_M)
    size_x_m: float = quantity(1.0, "length along its own x", "m", 0.01, _LARGEST_M)
    size_y_m: float = quantity(1.0, "length along its own y", "m", 0.01, _LARGEST_M)
    yaw_rad: float = quantity(0.0, "heading of its own x", "rad", -math.pi, math.pi)
    height_m: float = quantity(1.0, "height", "m", 0.01, 100.0)


@dataclass(frozen=True)
class MovingObstacle(Checked):
    """An upright cylinder or box that follows a motion and does not turn. Sizes of the other shape are 0."""

    name: str = quantity("obstacle", "its name, unique in the world")
    shape: str = quantity("cylinder", "its shape", choices=SHAPES)
    radius_m: float = quantity(0.0, "radius of a cylinder", "m", 0.0, 10.0)
    size_x_m: float = quantity(0.0, "length of a box along its own x", "m", 0.0, 20.0)
    size_y_m: float = quantity(0.0, "length of a box along its own y", "m", 0.0, 20.0)
    yaw_rad: float = quantity(0.0, "heading of a box's own x", "rad", -math.pi, math.pi)
    height_m: float = quantity(1.0, "height", "m", 0.01, 100.0)
    phase_s: float = quantity(
        0.0,
        "time into its motion at time 0",
        "s",
        -_LONGEST_PERIOD_S,
        _LONGEST_PERIOD_S,
    )
    motion: Motion = field(
        default_factory=lambda: Motion(keys=((0.0, 0.0, 0.0), (10.0, 1.0, 0.0)))
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < len(self.name) <= _LARGEST_NAME or not self.name.isprintable():
            raise ConfigError(
                f"name must have 1 to {_LARGEST_NAME} printable characters, got {format_value(self.name)}"
            )
        sizes = {"cylinder": ("radius_m",), "box": ("size_x_m", "size_y_m")}
        for shape, name in (
            (shape, name) for shape, names in sizes.items() for name in names
        ):
            size_m, least = (
                getattr(self, name),
                f"of a {shape} must be at least {_SMALLEST_M:g} m",
            )
            self.require(shape != self.shape or size_m >= _SMALLEST_M, name, least)
            other = f"is of a {shape}; leave it out for a {self.shape}"
            self.require(shape == self.shape or size_m == 0.0, name, other)


def check_scene(
    walls: tuple[Wall, ...], moving: tuple[MovingObstacle, ...], where: str
) -> None:
    """Raise WorldError, beginning with `where`, if these walls and moving obstacles cannot be those of a world."""
    for what, most, some in (
        ("walls", MOST_WALLS, walls),
        ("moving obstacles", MOST_MOVING, moving),
    ):
        if len(some) > most:
            raise WorldError(
                f"{where}: must have at most {most} {what}, got {len(some)}"
            )
    for name, times in Counter(one.name for one in moving).items():
        if times > 1:
            raise WorldError(
                f"{where}: two moving obstacles have the name {format_value(name)}"
            )


def scene_content(walls: tuple[Wall, ...], moving: tuple[MovingObstacle, ...]) -> bytes:
    """Return all that walls and moving obstacles are, apart from their names, as bytes to make a checksum of."""
    plain = (
        [as_dict(wall) for wall in walls],
        [{**as_dict(one), "name": ""} for one in moving],
    )
    return json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()
