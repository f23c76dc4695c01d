"""Observations and actions of learned policies, the same in training and on the robot.

The observation is one vector of float32, all of whose entries lie in [-1, 1]:

    beams       nearest return in each of `beams` equal sectors from right to left, by the range limit; 1 is nothing
    1           distance to the goal, by the goal limit
    2           cosine and sine of the goal's bearing in base_link
    2           forward speed and yaw rate as the odometry measures them, by their limits

The action is two numbers in [-1, 1]: from the lowest to the highest forward speed, and the share of the highest yaw
rate.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_planners.interface import FloatArray, Observation
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import Pose2D, Scan, Velocity2D

Vector = npt.NDArray[np.float32]

ACTIONS = 2
_BEYOND_LIDAR = 5  # entries after those of the lidar


@dataclass(frozen=True)
class PolicyObservation(Checked):
    """How sensor readings become the observation of a policy."""

    beams: int = quantity(720, "sectors of the lidar's field of view", "", 1, 20000)
    angle_min_rad: float = quantity(
        -2.35619, "right end of this field", "rad", -math.pi, math.pi
    )
    angle_max_rad: float = quantity(
        2.35619, "left end of this field", "rad", -math.pi, math.pi
    )
    range_limit_m: float = quantity(
        5.0, "range that counts as 1, as does anything further", "m", minimum=0.1
    )
    goal_limit_m: float = quantity(
        10.0, "distance to the goal that counts as 1", "m", minimum=0.1
    )
    speed_limit_mps: float = quantity(
        2.0, "speed that counts as 1", "m/s", minimum=0.01
    )
    yaw_rate_limit_radps: float = quantity(
        4.0, "yaw rate that counts as 1", "rad/s", minimum=0.01
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        above = f"must be above angle_min_rad = {self.angle_min_rad:g}"
        self.require(self.angle_max_rad > self.angle_min_rad, "angle_max_rad", above)

    @property
    def size(self) -> int:
        """Length of the vector."""
        return self.beams + _BEYOND_LIDAR

    def bounds(self) -> tuple[Vector, Vector]:
        """Return the lowest and the highest value of each entry, both (size,)."""
        low, high = np.zeros(self.size, np.float32), np.ones(self.size, np.float32)
        low[self.beams + 1 :] = -1.0
        return low, high


@dataclass(frozen=True)
class PolicyAction(Checked):
    """How actions of a policy become velocities."""

    min_speed_mps: float = quantity(
        -0.5, "forward speed of action -1", "m/s", -10.0, 10.0
    )
    max_speed_mps: float = quantity(
        2.0, "forward speed of action 1", "m/s", -10.0, 10.0
    )
    max_yaw_rate_radps: float = quantity(
        2.0, "yaw rate of action 1, to the left", "rad/s", 0.0, 20.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        above = f"must be above min_speed_mps = {self.min_speed_mps:g}"
        self.require(self.max_speed_mps > self.min_speed_mps, "max_speed_mps", above)

    def command(self, action: npt.NDArray[np.floating]) -> Velocity2D:
        """Return the velocity of an action (2,), clipped to -1 and 1; NaN stays NaN."""
        return Velocity2D(*self.commands(action[None])[0].tolist())

    def commands(self, actions: npt.NDArray[np.floating]) -> FloatArray:
        """Return the speeds and yaw rates (n, 2) of actions (n, 2), as `command` does."""
        # for one action np.clip takes longer
        given: FloatArray = np.minimum(
            np.maximum(actions.astype(np.float64), -1.0), 1.0
        )
        given[:, 0] = self.min_speed_mps + 0.5 * (given[:, 0] + 1.0) * (
            self.max_speed_mps - self.min_speed_mps
        )
        given[:, 1] *= self.max_yaw_rate_radps
        return given

    @property
    def cap_mps(self) -> float:
        """The highest speed that it commands, forwards or backwards."""
        return max(abs(self.min_speed_mps), abs(self.max_speed_mps))


class ObservationEncoder:
    """Makes the vectors of a `PolicyObservation`; stores which beams of a scan fall into which sector."""

    def __init__(self, config: PolicyObservation) -> None:
        self.config = config
        self._geometry: tuple[int, float, float] | None = None
        self._problem = ""
        self._first = np.zeros(0, np.intp)
        self._end = 0
        metres = np.float32(config.range_limit_m)
        self._limits = (
            metres,
            config.goal_limit_m,
            config.speed_limit_mps,
            config.yaw_rate_limit_radps,
        )

    def problem(self, scan: Scan) -> str:
        """Return in one line why this policy cannot use such scans, or an empty text."""
        geometry = (len(scan.ranges), scan.angle_min, scan.angle_increment)
        if geometry != self._geometry:
            self._geometry, self._problem = geometry, self._fit(scan)
        return self._problem

    def encode(self, observation: Observation, goal: Pose2D) -> Vector:
        """Return the vector (size,) for readings and a goal in the planning frame; ConfigError for a `problem`."""
        pose, velocity = observation.pose, observation.odometry.velocity
        seen = np.empty((1, self.config.size), np.float32)
        self.encode_all(
            observation.scan,
            observation.scan.ranges[None],
            np.array([[pose.x, pose.y, pose.yaw]]),
            np.array([[goal.x, goal.y]]),
            np.array([[velocity.linear, velocity.angular]]),
            np.zeros(1, np.intp),
            seen,
        )
        vector: Vector = seen[0]
        return vector

    def encode_all(
        self, scan: Scan, ranges: Vector, poses: FloatArray, goals: FloatArray, velocities: FloatArray,
        which: npt.NDArray[np.intp], seen: Vector,
    ) -> None:  # fmt: skip
        """Fill rows `which` of `seen` (n, size) as `encode` does, for ranges (n, beams) with the geometry of `scan`."""
        if problem := self.problem(scan):
            raise ConfigError(problem)
        ordered = ranges if scan.angle_increment > 0.0 else ranges[:, ::-1]
        readings = (ordered, poses, goals, velocities)
        _encode(
            *readings,
            which,
            self._first,
            self._end,
            np.float32(scan.range_min),
            self._limits,
            seen,
        )

    def _fit(self, scan: Scan) -> str:
        """Store which beams fall into which sector; a sector between two beams uses the one to its left."""
        config = self.config
        angles = scan.angles() if scan.angle_increment > 0.0 else scan.angles()[::-1]
        width = (config.angle_max_rad - config.angle_min_rad) / config.beams
        step = abs(scan.angle_increment)
        if not step > 0.0 or not len(angles):
            return "the scan holds no usable angles"
        slack = max(width, step)
        if (
            angles[0] > config.angle_min_rad + slack
            or angles[-1] < config.angle_max_rad - slack
        ):
            seen = f"{config.angle_min_rad:.3f} to {config.angle_max_rad:.3f} rad"
            return f"the policy sees from {seen}, the scan only from {angles[0]:.3f} to {angles[-1]:.3f} rad"
        edges = config.angle_min_rad + width * np.arange(config.beams)
        edges[0] -= 0.5 * width
        self._end = int(
            np.searchsorted(angles, config.angle_max_rad + 0.5 * width, "right")
        )
        self._first = np.minimum(np.searchsorted(angles, edges, "left"), self._end - 1)
        return ""


@njit(cache=True, nogil=True)
def _encode(  # type: ignore[no-untyped-def]
    ranges, poses, goals, velocities, which, first, end, range_min, limits, seen
):
    """Fill the rows `which` of `seen`; limits: range, distance to the goal, speed and yaw rate that count as 1."""
    count, (furthest, furthest_goal, fastest, fastest_turn) = len(first), limits
    for i in which:
        nearest_returns(ranges[i], first, end, range_min, furthest, seen[i, :count])
        x, y, yaw = poses[i]
        goal_x, goal_y = goals[i]
        c, s = math.cos(yaw), math.sin(yaw)
        back = (math.pi - yaw) % (2.0 * math.pi) - math.pi
        back_c, back_s = math.cos(back), math.sin(back)
        ahead = -c * x - s * y + back_c * goal_x - back_s * goal_y
        left = s * x - c * y + back_s * goal_x + back_c * goal_y
        bearing = math.atan2(left, ahead)
        seen[i, count] = min(math.hypot(ahead, left) / furthest_goal, 1.0)
        seen[i, count + 1], seen[i, count + 2] = math.cos(bearing), math.sin(bearing)
        seen[i, count + 3] = min(max(velocities[i, 0] / fastest, -1.0), 1.0)
        seen[i, count + 4] = min(max(velocities[i, 1] / fastest_turn, -1.0), 1.0)


@njit(cache=True)
def nearest_returns(ranges, first, end, range_min, limit, shares):  # type: ignore[no-untyped-def]
    """Fill `shares` (n,) with the nearest return of each sector by the limit; 0 if all its returns are too near.

    Invalid returns (NaN), and too near ones beside others, are ignored. first (n,): beam of each sector; end: of all.
    """
    if end - first[0] == len(first) and first[-1] == end - 1:
        own = ranges[first[0] : end]
        for sector in range(
            len(shares)
        ):  # a beam each: without a branch, for several of them at once
            nearest = own[sector] if own[sector] < limit else limit
            shares[sector] = np.float32(0.0) if nearest < range_min else nearest / limit
        return
    for sector in range(len(shares)):
        start = first[sector]
        stop = first[sector + 1] if sector + 1 < len(first) else end
        nearest, seen, too_near = limit, False, False
        for beam in range(start, max(start + 1, stop)):
            if ranges[beam] >= range_min:
                seen, nearest = True, min(nearest, ranges[beam])
            elif ranges[beam] < range_min:
                too_near = True
        nothing = (too_near and not seen) or nearest < range_min
        shares[sector] = np.float32(0.0) if nothing else nearest / limit
