"""A planar laser scanner among cylinders, cast in closed form.

An upright cylinder is a circle in the scan plane. It is compared only with the beams in its angular interval, which
makes about five comparisons per beam in the densest world. Tilted cylinders are intersected with the horizontal beams
in space; one that lies below the plane is not seen. The robot's own pitch and roll (at most half a degree when it
brakes) are neglected.
"""

import math
from functools import cache

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_sim.body.state import Record, Records
from barn_sim.config import LidarConfig
from barn_sim.sensors.odometry import wrap
from barn_worlds.base.arrays import Integers
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Pose2D, Scan
from barn_worlds.geometry.kernels import entry_time

Array = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Triple = tuple[float, float, float]
Frame = tuple[float, float, float, float]

ROUGH_RAD = 5e-4  # error of `rough_angle`
_SPANS = 8  # rows of `cast_spans`
_EDGE_M = 0.2  # between neighbours that do not see the same thing


class Lidar:
    """A scanner with noise, range limits and the values of REP-117; mount: its pose in base_link; rng: of the noise."""

    def __init__(self, config: LidarConfig, rng: np.random.Generator) -> None:
        self.rng = rng
        self.mount = Pose2D(config.mount_x_m, config.mount_y_m, config.mount_yaw_rad)
        spread = config.angle_max_rad - config.angle_min_rad
        # single precision, as in the message, so that sending a scan does not change it
        self._angle_min = float(np.float32(config.angle_min_rad))
        self._increment = float(np.float32(spread / max(config.beams - 1, 1)))
        self._range_min = float(np.float32(config.range_min_m))
        self._range_max = float(np.float32(config.range_max_m))
        self.directions = _directions(self._angle_min, self._increment, config.beams)
        self.fan = (self._angle_min, self._increment, self._range_max)
        self.limits = (
            config.noise_m,
            config.noise_share,
            self._range_min,
            self._range_max,
        )
        self._mixed, self._dropped, self.sweeps = (
            config.mixed_share,
            config.dropout_share,
            config.sweeps,
        )
        turn_s = spread / (2.0 * math.pi * config.rate_hz)
        # of each beam, before the last one; only whoever sweeps has the others earlier
        self.ages_ns = (
            NANOSECONDS_PER_SECOND
            * turn_s
            * np.linspace(1.0, 0.0, config.beams)
            * config.sweeps
        )
        self._ranges = np.empty(config.beams)

    def scan(
        self, stamp_ns: int, robot: Pose2D, centres: Array, radius_m: float, tilted: Array | None = None,
        shapes: Array | None = None, noise: Singles | None = None, sweep: Array | None = None,
    ) -> Scan:  # fmt: skip
        """Take a scan from the robot's pose.

        centres (n, 2): of upright cylinders in metres, in the frame of the pose; radius_m: of all cylinders.
        tilted (m, 7): others as centre x, y and height above the scan plane, unit vector of the axis, half length.
        shapes (k, 7): cylinders of other sizes and boxes, see `barn_worlds.geometry.kernels`. noise (n,): drawn before.
        sweep (n, 3): poses of the robot for each beam, instead of the one.
        """
        ranges = self._ranges
        ranges.fill(np.inf)
        if sweep is not None:
            frames, turn = self._frames(sweep)
            some = [
                np.zeros((0, 7)) if these is None else these
                for these in (tilted, shapes)
            ]
            cast_sweep(
                ranges,
                self.directions,
                self.fan,
                frames,
                turn,
                centres,
                radius_m,
                *some,
            )
        else:
            sensor = robot @ self.mount
            frame = (sensor.x, sensor.y, math.cos(sensor.yaw), math.sin(sensor.yaw))
            cast_circles(ranges, self.directions, self.fan, frame, centres, radius_m)
            if tilted is not None and len(tilted):
                cast_cylinders(ranges, self.directions, frame, tilted, radius_m)
            if shapes is not None:
                cast_shapes(ranges, self.directions, self.fan, frame, shapes)
        measured = np.empty(len(ranges), np.float32)
        if self._mixed:
            self._mix(ranges)
        if noise is None:
            self.draw(noise := np.empty(len(ranges), np.float32))
        measure(ranges, noise, *self.limits, measured)
        if self._dropped:
            measured[self.rng.random(len(measured)) < self._dropped] = np.inf
        return self.scan_of(stamp_ns, measured)

    def _frames(self, poses: Array) -> tuple[Array, float]:
        """Return frames (n, 4) of the sensor for poses (n, 3) of the robot, and how far it turns from the last, rad."""
        x, y, yaw = poses.T
        c, s, seen = np.cos(yaw), np.sin(yaw), yaw + self.mount.yaw
        at = (
            x + c * self.mount.x - s * self.mount.y,
            y + s * self.mount.x + c * self.mount.y,
        )
        return np.stack([*at, np.cos(seen), np.sin(seen)], axis=1), float(
            np.abs(yaw - yaw[-1]).max()
        )

    def _mix(self, ranges: Array) -> None:
        """Let beams on the near side of an edge read something between its sides, evenly, as often as configured."""
        chances, between = self.rng.random((2, len(ranges)))
        true = np.minimum(ranges, self._range_max)
        beside = np.maximum(
            np.append(true[1:], true[-1]), np.insert(true[:-1], 0, true[0])
        )
        mixed = (beside - true > _EDGE_M) & (chances < self._mixed)
        ranges[mixed] = (true + between * (beside - true))[mixed]

    @property
    def plain(self) -> bool:
        """Whether a scan is of one instant, with no more than noise."""
        return not (self.sweeps or self._mixed or self._dropped)

    def draw(self, noise: Singles) -> None:
        """Draw the noise of a scan (n,), or of several (k, n), standard normal."""
        self.rng.standard_normal(out=noise, dtype=np.float32)

    def scan_of(self, stamp_ns: int, measured: Singles) -> Scan:
        """Return the scan of measured ranges (n,)."""
        return Scan(
            stamp_ns,
            measured,
            self._angle_min,
            self._increment,
            self._range_min,
            self._range_max,
        )


@cache
def _directions(angle_min: float, increment: float, beams: int) -> Array:
    """Return unit vectors (n, 2) of beams."""
    angles = angle_min + increment * np.arange(beams)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


@njit(cache=True)
def scan_all(
    robots: Records, indices: Integers, circles: Array, cylinders: Integers, directions: Array, fan: Triple,
    mount: Triple, limits: Frame, noise: Singles, drawn: Integers, measured: Singles,
) -> None:  # fmt: skip
    """Fill the rows `indices` of `measured` (n, beams) with scans among upright cylinders.

    circles (n, 2, m): x and y of the centres in each robot's world, the first `cylinders` (n,) of them; mount: x, y
    (m) and yaw (rad) in base_link; limits: standard deviation, its share of a range, shortest and longest range; noise
    (n, k, beams): whose row `drawn` (n,) is used up.
    """
    ranges, spans = np.empty(len(directions)), np.empty((_SPANS, circles.shape[2]))
    for index in indices:
        robot: Record = robots[index]
        c, s = math.cos(robot.yaw), math.sin(robot.yaw)
        yaw = wrap(robot.yaw + mount[2])
        x, y = (
            robot.x + c * mount[0] - s * mount[1],
            robot.y + s * mount[0] + c * mount[1],
        )
        frame = (x, y, math.cos(yaw), math.sin(yaw))
        ranges[:] = np.inf
        xs, ys = (
            circles[index, 0, : cylinders[index]],
            circles[index, 1, : cylinders[index]],
        )
        cast_spans(ranges, directions, fan, frame, xs, ys, robot.radius_m, spans)
        measure(
            ranges,
            noise[index, drawn[index]],
            limits[0],
            limits[1],
            limits[2],
            limits[3],
            measured[index],
        )
        drawn[index] += 1


@njit(cache=True)
def cast_circles(
    ranges: Array,
    directions: Array,
    fan: Triple,
    frame: Frame,
    centres: Array,
    radius: float,
) -> None:
    """Lower `ranges` (n,) to the first hits on circles (k, 2); 0 everywhere from within one.

    directions (n, 2): unit vectors of the beams in the sensor frame; fan: angle of the first, that from one to the next
    (rad), longest range (m); frame: of the sensor, x, y (m), cosine and sine of its yaw.
    """
    xs, ys, spans = (
        centres[:, 0].copy(),
        centres[:, 1].copy(),
        np.empty((_SPANS, len(centres))),
    )
    cast_spans(ranges, directions, fan, frame, xs, ys, radius, spans)


@njit(cache=True)
def cast_sweep(
    ranges: Array, directions: Array, fan: Triple, frames: Array, turn: float, centres: Array, radius: float,
    tilted: Array, shapes: Array,
) -> None:  # fmt: skip
    """Lower `ranges` (n,) to the first hits of beams that have a frame (n, 4) each, as they do at one instant.

    turn: how far the sensor turns from its last frame, rad. A circle is compared with all beams that may hit it.
    """
    angle_min, increment, range_max = fan
    count, (x, y, c, s) = len(ranges), frames[-1]
    shift, whole = np.hypot(frames[:, 0] - x, frames[:, 1] - y).max(), 2.0 * math.pi
    for i in range(len(centres)):
        dx, dy = centres[i, 0] - x, centres[i, 1] - y
        distance = math.hypot(dx, dy)
        if not distance - radius - shift <= range_max:
            continue
        half = whole
        if distance > radius + 2.0 * shift:
            half = (
                math.asin(shift / distance)
                + math.asin(radius / (distance - shift))
                + turn
                + increment
            )
        middle = math.atan2(c * dy - s * dx, c * dx + s * dy) - angle_min
        after = 0
        for lap in range(-1, 2):
            low, high = middle + lap * whole - half, middle + lap * whole + half
            first, last = (
                max(after, math.floor(low / increment)),
                min(count - 1, math.ceil(high / increment)),
            )
            for beam in range(first, last + 1):
                ax, ay = (
                    centres[i, 0] - frames[beam, 0],
                    centres[i, 1] - frames[beam, 1],
                )
                ahead = frames[beam, 2] * ax + frames[beam, 3] * ay
                left = frames[beam, 2] * ay - frames[beam, 3] * ax
                if ax * ax + ay * ay <= radius * radius:
                    ranges[beam] = 0.0
                else:
                    _cast_circle(ranges, directions, beam, beam, ahead, left, radius)
            after = max(after, last + 1)
    for beam in range(count):
        frame = (frames[beam, 0], frames[beam, 1], frames[beam, 2], frames[beam, 3])
        one, ahead_only = ranges[beam : beam + 1], directions[beam : beam + 1]
        cast_cylinders(one, ahead_only, frame, tilted, radius)
        cast_shapes(
            one,
            ahead_only,
            (angle_min + beam * increment, increment, range_max),
            frame,
            shapes,
        )


@njit(cache=True)
def cast_spans(
    ranges: Array,
    directions: Array,
    fan: Triple,
    frame: Frame,
    xs: Array,
    ys: Array,
    radius: float,
    spans: Array,
) -> None:
    """Do as `cast_circles`; xs, ys (k,): of the centres; spans (8, k): room for what is needed."""
    last_beam, whole, increment = len(ranges) - 1, 2.0 * math.pi, fan[1]
    see_spans(fan, frame, xs, ys, radius, last_beam, spans)
    for i in range(len(xs)):
        if spans[4, i] <= radius * radius:
            ranges[:] = 0.0
            return
        first, last, over = int(spans[5, i]), int(spans[6, i]), spans[7, i] > 0.0
        if first > last and not over:
            continue
        ahead, left = spans[2, i], spans[3, i]
        _cast_circle(ranges, directions, first, last, ahead, left, radius)
        if over:
            for turn in range(-1, 2, 2):
                middle, half = spans[0, i] + turn * whole, spans[1, i]
                first = max(0, math.floor((middle - half) / increment))
                last = min(last_beam, math.ceil((middle + half) / increment))
                _cast_circle(ranges, directions, first, last, ahead, left, radius)


@njit(cache=True, inline="always")
def _cast_circle(
    ranges: Array,
    directions: Array,
    first: int,
    last: int,
    ahead: float,
    left: float,
    radius: float,
) -> None:
    """Compare the beams from `first` to `last` with a circle, whose centre is so far ahead and to the left."""
    for beam in range(first, last + 1):
        along = directions[beam, 0] * ahead + directions[beam, 1] * left
        across = directions[beam, 0] * left - directions[beam, 1] * ahead
        chord = radius * radius - across * across
        hit = along - math.sqrt(chord if chord >= 0.0 else 0.0)
        # a select instead of branches, which no processor would foresee
        ranges[beam] = (
            hit
            if (chord >= 0.0) & (along > 0.0) & (hit < ranges[beam])
            else ranges[beam]
        )


@njit(cache=True, error_model="numpy")
def see_spans(
    fan: Triple,
    frame: Frame,
    xs: Array,
    ys: Array,
    radius: float,
    last_beam: float,
    spans: Array,
) -> None:
    """Fill `spans` (8, k) with how a sensor sees circles at xs, ys (k,), without a branch, for several of them at once.

    Rows: angle of the middle, from the first beam, at least 0, and half the angle that a circle takes up, -1 beyond the
    longest range (rad); distance ahead and to the left; square of the distance (m); first and last of the beams that
    may hit it, the first after the last if none can; 1 where others may hit it a whole turn away, else 0.
    Which beams are compared with a circle may be found roughly: one too many changes nothing.
    """
    angle_min, increment, range_max = fan
    x, y, cos_yaw, sin_yaw = frame
    reach, whole = (range_max + radius) * (range_max + radius), 2.0 * math.pi
    end = (last_beam + 1.0) * increment
    for i in range(len(xs)):
        dx, dy = xs[i] - x, ys[i] - y
        squared = dx * dx + dy * dy
        ahead, left = cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx
        distance = math.sqrt(squared)
        middle = rough_angle(left, ahead) - angle_min
        middle = middle + whole if middle < 0.0 else middle
        sine = radius / distance
        cubed = sine * sine * sine
        half = sine + cubed * (1.0 / 6.0) + 0.1 * cubed * sine * sine
        half = half if sine <= 0.5 else 0.5 * math.pi * sine
        middle = middle - whole if middle >= whole else middle
        half = -1.0 if squared > reach else half + 2.0 * ROUGH_RAD
        spans[0, i], spans[1, i], spans[2, i], spans[3, i], spans[4, i] = (
            middle,
            half,
            ahead,
            left,
            squared,
        )
        low, high = (
            np.ceil((middle - half) / increment),
            np.floor((middle + half) / increment),
        )
        over = 1.0 if middle + half >= whole - increment else 0.0
        over = 1.0 if middle - half <= end - whole else over
        spans[5, i] = low if low > 0.0 else 0.0
        high = high if high < last_beam else last_beam
        spans[6, i] = -1.0 if half < 0.0 else high
        spans[7, i] = 0.0 if half < 0.0 else over


@njit(cache=True)
def cast_shapes(
    ranges: Array, directions: Array, fan: Triple, frame: Frame, shapes: Array
) -> None:
    """Lower `ranges` (n,) to the first hits on shapes (k, 7), see `geometry.kernels`; 0 everywhere from within one."""
    for i in range(len(shapes)):
        if shapes[i, 2] > 0.0:
            cast_circles(
                ranges, directions, fan, frame, shapes[i : i + 1], shapes[i, 2]
            )
        else:
            _cast_box(ranges, directions, fan, frame, shapes[i])


@njit(cache=True)
def _cast_box(
    ranges: Array, directions: Array, fan: Triple, frame: Frame, box: Array
) -> None:
    """Lower `ranges` (n,) to the first hits on a box (7,); 0 everywhere from within it."""
    x, y, cos_yaw, sin_yaw = frame
    dx, dy, half_x, half_y, c, s = (
        x - box[0],
        y - box[1],
        box[3],
        box[4],
        box[5],
        box[6],
    )
    ox, oy = c * dx + s * dy, c * dy - s * dx  # of the sensor in the box's frame
    if math.hypot(max(abs(ox) - half_x, 0.0), max(abs(oy) - half_y, 0.0)) > fan[2]:
        return
    if abs(ox) <= half_x and abs(oy) <= half_y:
        ranges[:] = 0.0
        return
    turn_c, turn_s = (
        c * cos_yaw + s * sin_yaw,
        c * sin_yaw - s * cos_yaw,
    )  # from the sensor's frame to the box's
    right, left = (
        0.0,
        0.0,
    )  # directions of the outermost corners, seen from that of the centre
    for k in range(4):
        px, py = (
            (2.0 * (k % 2) - 1.0) * half_x - ox,
            (2.0 * (k // 2) - 1.0) * half_y - oy,
        )
        beside = rough_angle(oy * px - ox * py, -ox * px - oy * py)
        right, left = min(right, beside), max(left, beside)
    middle = rough_angle(turn_s * ox - turn_c * oy, -turn_c * ox - turn_s * oy) - fan[0]
    whole = 2.0 * math.pi
    for turn in range(-2, 2):
        low, high = (
            middle + turn * whole + right - 2.0 * ROUGH_RAD,
            middle + turn * whole + left + 2.0 * ROUGH_RAD,
        )
        first, last = (
            max(0, math.floor(low / fan[1])),
            min(len(ranges) - 1, math.ceil(high / fan[1])),
        )
        for beam in range(first, last + 1):
            bx = turn_c * directions[beam, 0] - turn_s * directions[beam, 1]
            by = turn_s * directions[beam, 0] + turn_c * directions[beam, 1]
            ranges[beam] = min(ranges[beam], entry_time(ox, oy, bx, by, half_x, half_y))


@njit(cache=True, error_model="numpy")
def rough_angle(y: float, x: float) -> float:
    """Return the direction of a vector to within `ROUGH_RAD`, three times as fast as atan2 does."""
    across, along = abs(y), abs(x)
    steep = across > along
    ratio = (along if steep else across) / (across if steep else along)
    squared = ratio * ratio
    angle = ratio * (
        1.0 + squared * (-0.327622764 + squared * (0.15931422 - 0.0464964749 * squared))
    )
    angle = 0.5 * math.pi - angle if steep else angle
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@njit(cache=True)
def cast_cylinders(
    ranges: Array, directions: Array, frame: Frame, cylinders: Array, radius: float
) -> None:
    """Lower `ranges` (n,) to the first hits on finite cylinders in any attitude; 0 everywhere from within one."""
    x, y, cos_yaw, sin_yaw = frame
    for i in range(len(cylinders)):
        cx, cy, cz, ux, uy, uz, half = cylinders[i]
        ox, oy, oz = x - cx, y - cy, -cz  # sensor relative to the cylinder
        along = ox * ux + oy * uy + oz * uz
        beyond = ox * ox + oy * oy + oz * oz - along * along - radius * radius
        if beyond <= 0.0 and abs(along) <= half:
            ranges[:] = 0.0
            return
        for beam in range(len(ranges)):
            bx = cos_yaw * directions[beam, 0] - sin_yaw * directions[beam, 1]
            by = sin_yaw * directions[beam, 0] + cos_yaw * directions[beam, 1]
            distance = _hit(
                (bx, by), (ox, oy, oz), (ux, uy, uz), along, beyond, half, radius
            )
            ranges[beam] = min(ranges[beam], distance)


@njit(cache=True)
def _hit(
    beam: tuple[float, float],
    offset: Triple,
    axis: Triple,
    along: float,
    beyond: float,
    half: float,
    radius: float,
) -> float:
    """Return the distance along a horizontal beam to the side or a cap of a cylinder, or inf."""
    (bx, by), (ox, oy, oz), (ux, uy, uz) = beam, offset, axis
    slope = bx * ux + by * uy  # advance along the axis per metre of the beam
    nearest = math.inf
    a = 1.0 - slope * slope
    b = ox * bx + oy * by - along * slope
    root = b * b - a * beyond
    if a > 1e-12 and root >= 0.0:
        distance = (-b - math.sqrt(root)) / a
        if distance >= 0.0 and abs(along + slope * distance) <= half:
            nearest = distance
    if abs(slope) > 1e-12:
        distance = (
            -math.copysign(half, slope) - along
        ) / slope  # the cap that faces the beam
        if 0.0 <= distance < nearest:
            px, py = ox + bx * distance, oy + by * distance
            at = px * ux + py * uy + oz * uz
            if px * px + py * py + oz * oz - at * at <= radius * radius:
                nearest = distance
    return nearest


@njit(cache=True)
def measure(
    ranges: Array,
    noise: Singles,
    std: float,
    share: float,
    range_min: float,
    range_max: float,
    measured: Singles,
) -> None:
    """Fill `measured` (n,) float32 with noisy ranges, -inf below `range_min` and +inf above `range_max`.

    Their standard deviation is `std`, or where that is more the share of the range.
    """
    for beam in range(len(ranges)):
        wide = share * min(ranges[beam], range_max)
        distance = ranges[beam] + (wide if wide > std else std) * noise[beam]
        within = np.inf if distance > range_max else distance
        measured[beam] = -np.inf if distance < range_min else within
