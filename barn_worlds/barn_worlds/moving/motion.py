"""Moving obstacles as data: their shapes, their motions and the walls around them.

The position of an obstacle depends only on the time. The robot does not change its
motion, and obstacles pass through each other and through walls.
"""

import json
import math
from dataclasses import dataclass, field

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, as_dict, quantity
from barn_worlds.base.errors import (
    ConfigError,
    WorldError,
    find_duplicates,
    format_value,
)

# Of a world.
MOST_MOVING = 1000
MOST_WALLS = 1000
# Of a motion.
MOST_KEYS = 10_000
MOST_COEFFICIENTS = 16
KINDS = ("gazebo", "linear", "polynomial")
SHAPES = ("cylinder", "box")
# How far apart the ends of a closed polynomial may be.
CLOSED_M = 1e-6

_FARTHEST_M = 10_000.0
_LARGEST_M = 1000.0
_SMALLEST_M = 0.01
_LONGEST_NAME = 200
_LONGEST_PERIOD_S = 100_000.0
# ignition::math::Vector3 takes coordinates this close for equal.
_SAME_POINT_M = 1e-3


@dataclass(frozen=True)
class Motion(Checked):
    """A path over time that repeats.

    gazebo: Between keys, as Gazebo Classic's PoseAnimation: a cubic Hermite curve over
    the share of the time between two keys, with uniform Catmull-Rom tangents of tension
    0. The tangent at an end is half the step to its neighbor; if the first and the last
    key are at the same place, it is that of a closed curve. (Below a millionth of a
    segment Gazebo rounds down to the key; this does not.)

    linear: Straight between keys. Both kinds rest at the last key until the period
    ends, then jump to the first; before the time of the first key they rest there.

    polynomial: A polynomial of the share of the period that has passed.
    """

    kind: str = quantity("gazebo", "interpolation between keys", choices=KINDS)
    period_s: float = quantity(
        10.0, "time after which the motion repeats", "s", 0.001, _LONGEST_PERIOD_S
    )
    # Time in s, x and y in m; not of a polynomial.
    keys: tuple[tuple[float, float, float], ...] = ()
    # x and y of the powers 0, 1, 2, ...; only of a polynomial. It must end where it
    # begins, so that there is no jump.
    coefficients_m: tuple[tuple[float, float], ...] = ()

    def check_rules(self) -> None:
        """Raise ConfigError unless keys or coefficients suit the kind of motion."""
        if self.kind == "polynomial":
            self._check_count("coefficients_m", len(self.coefficients_m))
            if self.keys:
                raise ConfigError("keys must be left out for a polynomial motion")
            table = _number_table("coefficients_m", self.coefficients_m, 2, "x and y")
            # At the end of the period all powers of the share are 1.
            gap_m = max(abs(math.fsum(axis)) for axis in table[1:].T.tolist())
            if gap_m > CLOSED_M:
                raise ConfigError(
                    f"coefficients_m must end within {CLOSED_M:g} m of where they "
                    f"begin, got {gap_m:g} m"
                )
        else:
            self._check_count("keys", len(self.keys))
            if self.coefficients_m:
                raise ConfigError(
                    f"coefficients_m must be left out for a {self.kind} motion"
                )
            times_s = _number_table("keys", self.keys, 3, "time, x and y")[:, 0]
            for place in np.flatnonzero(times_s < 0.0):
                raise ConfigError(
                    f"keys[{place}] must not be before 0 s, got {times_s.min():g} s"
                )
            for place in np.flatnonzero(np.diff(times_s) <= 0.0):
                raise ConfigError(
                    f"keys[{place + 1}] must be later than the key before, "
                    f"at {times_s[place]:g} s, got {times_s[place + 1]:g} s"
                )
            self.require(
                self.period_s >= times_s[-1],
                "period_s",
                f"must not be shorter than the time of the last key, {times_s[-1]:g} s",
            )

    def pieces(self) -> tuple[Floats, Floats, Floats]:
        """Return the motion as n polynomials: begins, durations and coefficients.

        Returns:
            Begin (n,) and duration (n,) in s of each piece, and coefficients (n, 2, k)
            in m: of x and y, of the powers 0, 1, ... of the share of the piece that has
            passed.
        """
        if self.kind == "polynomial":
            # One piece, (1, 2, k).
            coefficients = np.array(self.coefficients_m).T[None]
            return np.zeros(1), np.array([self.period_s]), coefficients

        table = np.array(self.keys)
        begin_s = table[:, 0]
        points = table[:, 1:]
        steps = np.diff(points, axis=0)
        # Linear: from the key by its step.
        powers = [points[:-1], steps]
        if self.kind == "gazebo":
            # Hermite's cubic from key to key, by powers of the share.
            tangents = _spline_tangents(points)
            first = tangents[:-1]
            last = tangents[1:]
            powers = [
                points[:-1],
                first,
                3.0 * steps - 2.0 * first - last,
                first + last - 2.0 * steps,
            ]
        return begin_s[:-1], np.diff(begin_s), np.stack(powers, axis=2)

    def _check_count(self, name: str, count: int) -> None:
        """Raise ConfigError unless `count` is from 2 to the limit of the kind."""
        limit = MOST_COEFFICIENTS if self.kind == "polynomial" else MOST_KEYS
        if not 2 <= count <= limit:
            raise ConfigError(
                f"{name} of a {self.kind} motion must be 2 to {limit}, got {count}"
            )


def _number_table(
    name: str, rows: tuple[tuple[float, ...], ...], width: int, meaning: str
) -> Floats:
    """Return rows as an array (n, width); ConfigError for a bad length or number."""
    for number, row in enumerate(rows):
        if len(row) != width:
            raise ConfigError(
                f"{name}[{number}] must be {meaning}, got {len(row)} numbers"
            )

    table: Floats = np.array(rows, np.float64)
    limits = [_LONGEST_PERIOD_S, _FARTHEST_M, _FARTHEST_M][-width:]
    # Written so that NaN is refused as well.
    for place in np.flatnonzero(~(np.abs(table) <= limits).all(axis=1)):
        raise ConfigError(
            f"{name}[{place}] must be finite, up to {_FARTHEST_M:g} m, "
            f"got {list(rows[place])}"
        )
    return table


def _spline_tangents(points: Floats) -> Floats:
    """Return the tangents (n, 2) of Gazebo Classic's spline through points (n, 2)."""
    tangents = np.empty_like(points)
    tangents[1:-1] = (points[2:] - points[:-2]) * 0.5
    if np.all(np.abs(points[0] - points[-1]) <= _SAME_POINT_M):
        # Closed: the last but one point comes before the first.
        tangents[[0, -1]] = (points[1] - points[-2]) * 0.5
    else:
        tangents[0] = (points[1] - points[0]) * 0.5
        tangents[-1] = (points[-1] - points[-2]) * 0.5
    return tangents


@dataclass(frozen=True)
class Wall(Checked):
    """A box that stands upright on the ground, its center at x, y in the map frame."""

    x_m: float = quantity(0.0, "x of its center", "m", -_FARTHEST_M, _FARTHEST_M)
    y_m: float = quantity(0.0, "y of its center", "m", -_FARTHEST_M, _FARTHEST_M)
    size_x_m: float = quantity(1.0, "length along its own x", "m", 0.01, _LARGEST_M)
    size_y_m: float = quantity(1.0, "length along its own y", "m", 0.01, _LARGEST_M)
    yaw_rad: float = quantity(0.0, "heading of its own x", "rad", -math.pi, math.pi)
    height_m: float = quantity(1.0, "height", "m", 0.01, 100.0)


@dataclass(frozen=True)
class MovingObstacle(Checked):
    """An upright cylinder or box that follows a motion and does not turn.

    Sizes of the other shape are 0.
    """

    name: str = quantity("obstacle", "name, unique in the world")
    shape: str = quantity("cylinder", "shape", choices=SHAPES)
    radius_m: float = quantity(0.0, "radius of a cylinder", "m", 0.0, 10.0)
    size_x_m: float = quantity(0.0, "length of a box along its own x", "m", 0.0, 20.0)
    size_y_m: float = quantity(0.0, "length of a box along its own y", "m", 0.0, 20.0)
    yaw_rad: float = quantity(0.0, "heading of a box's own x", "rad", -math.pi, math.pi)
    height_m: float = quantity(1.0, "height", "m", 0.01, 100.0)
    phase_s: float = quantity(
        0.0,
        "time in the motion at the start",
        "s",
        -_LONGEST_PERIOD_S,
        _LONGEST_PERIOD_S,
    )
    motion: Motion = field(
        default_factory=lambda: Motion(keys=((0.0, 0.0, 0.0), (10.0, 1.0, 0.0)))
    )

    def check_rules(self) -> None:
        """Raise ConfigError for a bad name or a size of another shape."""
        if not 0 < len(self.name) <= _LONGEST_NAME or not self.name.isprintable():
            raise ConfigError(
                f"name must have 1 to {_LONGEST_NAME} printable characters, "
                f"got {format_value(self.name)}"
            )
        self._check_size("cylinder", "radius_m")
        self._check_size("box", "size_x_m")
        self._check_size("box", "size_y_m")

    def _check_size(self, shape: str, name: str) -> None:
        """Raise ConfigError if a size is too small, or is set for the other shape."""
        size_m = getattr(self, name)
        if shape == self.shape:
            limit = f"of a {shape} must be at least {_SMALLEST_M:g} m"
            self.require(size_m >= _SMALLEST_M, name, limit)
        else:
            advice = f"is of a {shape}; leave it out for a {self.shape}"
            self.require(size_m == 0.0, name, advice)


def check_scene(
    walls: tuple[Wall, ...], moving: tuple[MovingObstacle, ...], where: str
) -> None:
    """Raise WorldError for too many walls or moving obstacles or for equal names.

    Args:
        walls: All straight walls of the world.
        moving: All moving obstacles of the world.
        where: Beginning of error messages, such as the name of a file.

    Raises:
        WorldError: If there are too many, or two obstacles have the same name.
    """
    _check_limit("walls", len(walls), MOST_WALLS, where)
    _check_limit("moving obstacles", len(moving), MOST_MOVING, where)
    for name in find_duplicates(obstacle.name for obstacle in moving):
        raise WorldError(
            f"{where}: two moving obstacles have the name {format_value(name)}"
        )


def _check_limit(things: str, count: int, limit: int, where: str) -> None:
    """Raise WorldError if `count` is above `limit`."""
    if count > limit:
        raise WorldError(f"{where}: must have at most {limit} {things}, got {count}")


def scene_content(walls: tuple[Wall, ...], moving: tuple[MovingObstacle, ...]) -> bytes:
    """Return JSON bytes of walls and moving obstacles, without names, for a checksum.

    Args:
        walls: All their numbers count.
        moving: All their numbers count, too; their names do not count.
    """
    content = (
        [as_dict(wall) for wall in walls],
        [{**as_dict(obstacle), "name": ""} for obstacle in moving],
    )
    return json.dumps(content, sort_keys=True, separators=(",", ":")).encode()
