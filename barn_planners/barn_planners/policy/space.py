"""Observations and actions of learned policies, the same in training and on the robot.

The observation is one vector of float32. All entries lie in [-1, 1]:

    beams   nearest return in each of `beams` equal sectors from right to left, as a
            share of the range limit; 1: no return
    1       distance to the goal, as a share of the goal limit
    2       cosine and sine of the goal's bearing in base_link
    2       forward speed and yaw rate of the odometry, as shares of their limits

With `frames` above 1 the vector holds as many of these frames, `frame_steps` steps of the
policy apart, the newest first. At the start of a trial all are the first one.

The action is two numbers in [-1, 1]: the speed from the lowest to the highest, and the
share of the highest yaw rate. It holds for `repeat` control periods.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_planners.interface import FloatArray, Observation
from barn_worlds.base.arrays import Bools, Singles, kernel
from barn_worlds.base.config import Checked, optional, quantity
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import Pose2D, Scan, Velocity2D, wrap_angle

Vector = Singles
Indices = npt.NDArray[np.intp]

ACTIONS = 2
# Entries after those of the lidar: goal distance, cosine, sine, speed, yaw rate.
_EXTRA_ENTRIES = 5


@dataclass(frozen=True)
class PolicyObservation(Checked):
    """How sensor readings become the observation of a policy."""

    beams: int = quantity(720, "sectors of the lidar's field of view", "", 1, 20000)
    angle_min_rad: float = quantity(
        -2.35619, "right end of the field of view", "rad", -math.pi, math.pi
    )
    angle_max_rad: float = quantity(
        2.35619, "left end of the field of view", "rad", -math.pi, math.pi
    )
    range_limit_m: float = quantity(
        5.0, "range that counts as 1, like any longer range", "m", minimum=0.1
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
    frames: int = optional(1, "frames in a vector, the newest first", "", 1, 64)
    frame_steps: int = optional(
        1, "steps of the policy from one frame to the next", "", 1, 100
    )

    def check_rules(self) -> None:
        """Raise ConfigError unless `angle_max_rad` is above `angle_min_rad`."""
        self.require_order("angle_max_rad", "above", "angle_min_rad")

    @property
    def frame_size(self) -> int:
        """Length of one frame: `beams` and five other entries."""
        return self.beams + _EXTRA_ENTRIES

    @property
    def size(self) -> int:
        """Length of the observation vector: all of its frames."""
        return self.frames * self.frame_size

    def bounds(self) -> tuple[Vector, Vector]:
        """Return lowest (0 or -1) and highest (1) value of each entry, both (size,)."""
        low = np.zeros(self.frame_size, np.float32)
        # Ranges and the goal's distance are not negative; all other entries have a sign.
        low[self.beams + 1 :] = -1.0
        return np.tile(low, self.frames), np.ones(self.size, np.float32)


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
    repeat: int = optional(1, "control periods for which an action is held", "", 1, 100)

    def check_rules(self) -> None:
        """Raise ConfigError unless `max_speed_mps` is above `min_speed_mps`."""
        self.require_order("max_speed_mps", "above", "min_speed_mps")

    @property
    def cap_mps(self) -> float:
        """Highest speed in m/s that an action commands, forward or backward."""
        return max(abs(self.min_speed_mps), abs(self.max_speed_mps))

    def command(self, action: npt.NDArray[np.floating]) -> Velocity2D:
        """Return the velocity of an action (2,), clipped to [-1, 1]; NaN stays NaN."""
        return Velocity2D(*self.commands(action[None])[0].tolist())

    def commands(self, actions: npt.NDArray[np.floating]) -> FloatArray:
        """Return (n, 2) speeds in m/s, yaw rates in rad/s of clipped actions (n, 2)."""
        values: FloatArray = actions.astype(np.float64)
        limits = (self.min_speed_mps, self.max_speed_mps, self.max_yaw_rate_radps)
        _scale_actions(values, limits)
        return values


class FrameStack:
    """The last frames of some robots, which make up their observation vectors."""

    def __init__(self, count: int, config: PolicyObservation):
        """Allocate empty memories for `count` robots."""
        self._config = config
        # As far back as a vector reaches, the newest first.
        depth = (config.frames - 1) * config.frame_steps + 1
        self._last = np.zeros((count, depth, config.frame_size), np.float32)
        self._is_empty = np.ones(count, np.bool_)

    def clear(self, row: int) -> None:
        """Forget the frames of robot `row`: a new trial begins."""
        self._is_empty[row] = True

    def push(self, rows: Indices, frames: Vector, vectors: Vector) -> None:
        """Store new frames of some robots and write their vectors, in place.

        The first frame after `clear` fills the whole memory of a robot.

        Args:
            rows: Robots that have a new frame, (k,).
            frames: Frames (n, frame_size) of all robots.
            vectors: Vectors (n, size), changed in place.
        """
        _push_frames(
            self._last, self._is_empty, self._config.frame_steps, rows, frames, vectors
        )


class ObservationEncoder:
    """Makes the frames of a `PolicyObservation`.

    It stores which beams fall into which sector, as that is the same for all scans.
    """

    def __init__(self, config: PolicyObservation):
        """Store the limits; the first scan decides which beams a sector has."""
        self.config = config
        # Number of beams, first angle and increment that the sectors were computed for.
        self._geometry: tuple[int, float, float] | None = None
        self._problem = ""
        # First beam of each sector, and the beam after the last sector: (beams + 1,).
        self._beam_bounds = np.zeros(1, np.intp)
        # Beams from right to left, where a scan passes the direction behind the lidar.
        self._order: Indices | None = None
        self._limits = (
            np.float32(config.range_limit_m),
            config.goal_limit_m,
            config.speed_limit_mps,
            config.yaw_rate_limit_radps,
        )

    def problem(self, scan: Scan) -> str:
        """Return why a scan's angles are unusable, or ""; assign beams if they are new."""
        geometry = (len(scan.ranges), scan.angle_min, scan.angle_increment)
        if geometry != self._geometry:
            self._geometry = geometry
            self._problem = self._assign_beams(scan)
        return self._problem

    def encode(self, observation: Observation, goal: Pose2D) -> Vector:
        """Return the float32 frame (frame_size,); ConfigError for a bad scan.

        Args:
            observation: Readings of one control cycle.
            goal: Goal in the planning frame.

        Returns:
            Frame (frame_size,).

        Raises:
            ConfigError: If the scan has a `problem`.
        """
        frames = np.empty((1, self.config.frame_size), np.float32)
        self.encode_all(
            observation.scan,
            observation.scan.ranges[None],
            np.array([observation.pose.numbers]),
            np.array([goal.position]),
            np.array([observation.odometry.velocity.numbers]),
            np.zeros(1, np.intp),
            frames,
        )
        frame: Vector = frames[0]
        return frame

    def encode_all(
        self,
        scan: Scan,
        ranges: Vector,
        poses: FloatArray,
        goals: FloatArray,
        velocities: FloatArray,
        rows: Indices,
        frames: Vector,
    ) -> None:
        """Fill frames of robots in `rows` as `encode` does; ConfigError for a bad scan.

        Args:
            scan: Any scan with the geometry of all of them.
            ranges: Ranges (n, beams) in m.
            poses: Poses (n, 3) in the planning frame: x and y in m, yaw in rad.
            goals: Goals (n, 2) in the planning frame, in m.
            velocities: Speeds in m/s and yaw rates in rad/s, (n, 2).
            rows: Robots whose frames are filled, (k,).
            frames: Frames (n, frame_size), changed in place.

        Raises:
            ConfigError: If the scan has a `problem`.
        """
        problem = self.problem(scan)
        if problem:
            raise ConfigError(problem)
        # Some lidars turn clockwise, or begin ahead; sectors go from right to left.
        if self._order is not None:
            ranges = ranges[:, self._order]
        elif scan.angle_increment < 0.0:
            ranges = ranges[:, ::-1]
        _encode(
            ranges,
            poses,
            goals,
            velocities,
            rows,
            self._beam_bounds,
            (np.float32(scan.shortest_return_m), np.float32(scan.range_max)),
            self._limits,
            frames,
        )

    def _assign_beams(self, scan: Scan) -> str:
        """Store which beams each sector has; return why that fails or an empty string."""
        config = self.config
        angles = scan.angles() if scan.angle_increment > 0.0 else scan.angles()[::-1]
        width = (config.angle_max_rad - config.angle_min_rad) / config.beams
        step = abs(scan.angle_increment)
        if not step > 0.0 or not len(angles):
            return "the scan holds no usable angles"

        # The outermost beams may lie up to a sector or a beam inside the ends.
        slack = max(width, step)
        self._order = None
        has_gap = False
        if max(-angles[0], angles[-1]) > math.pi + step:
            # Such as from 0 to 2 pi: the same directions from -pi to pi.
            turned = wrap_angle(scan.angles())
            self._order = np.argsort(turned, kind="stable")
            angles = turned[self._order]
            has_gap = bool(np.diff(angles).max(initial=0.0) > 1.5 * slack)
        if (
            has_gap
            or angles[0] > config.angle_min_rad + slack
            or angles[-1] < config.angle_max_rad - slack
        ):
            needed = f"{config.angle_min_rad:.3f} to {config.angle_max_rad:.3f} rad"
            available = f"{angles[0]:.3f} to {angles[-1]:.3f} rad"
            return f"the policy sees {needed}, but the scan covers only {available}"

        # Beams up to half a sector beyond both ends belong to the outermost sectors.
        edges = config.angle_min_rad + width * np.arange(config.beams)
        edges[0] -= 0.5 * width
        end_beam = np.searchsorted(angles, config.angle_max_rad + 0.5 * width, "right")

        # A sector between two beams uses the beam to its left.
        first_beams = np.searchsorted(angles, edges, "left")
        first_beams = np.minimum(first_beams, end_beam - 1)
        self._beam_bounds = np.append(first_beams, end_beam)
        return ""


@njit(cache=True, nogil=True)
def _encode(
    ranges: Vector,
    poses: FloatArray,
    goals: FloatArray,
    velocities: FloatArray,
    rows: Indices,
    beam_bounds: Indices,
    valid_range: tuple[np.float32, np.float32],
    limits: tuple[np.float32, float, float, float],
    frames: Vector,
) -> None:
    """Write the sectors' ranges, goal and velocity of robots in `rows` to `frames`.

    The limits are those of range, goal distance, speed and yaw rate.
    """
    range_limit, goal_limit, speed_limit, rate_limit = limits
    count = len(beam_bounds) - 1
    for i in rows:
        shares = frames[i, :count]
        nearest_returns(ranges[i], beam_bounds, valid_range, range_limit, shares)

        # The same operations as `pose.inverse() @ goal`, so that the bits are the same.
        x, y, yaw = poses[i]
        goal_x, goal_y = goals[i]
        c = math.cos(yaw)
        s = math.sin(yaw)
        inverse_yaw = (math.pi - yaw) % (2.0 * math.pi) - math.pi
        inverse_c = math.cos(inverse_yaw)
        inverse_s = math.sin(inverse_yaw)
        ahead = -c * x - s * y + inverse_c * goal_x - inverse_s * goal_y
        left = s * x - c * y + inverse_s * goal_x + inverse_c * goal_y

        bearing = math.atan2(left, ahead)
        frames[i, count] = min(math.hypot(ahead, left) / goal_limit, 1.0)
        frames[i, count + 1] = math.cos(bearing)
        frames[i, count + 2] = math.sin(bearing)
        frames[i, count + 3] = min(max(velocities[i, 0] / speed_limit, -1.0), 1.0)
        frames[i, count + 4] = min(max(velocities[i, 1] / rate_limit, -1.0), 1.0)


@kernel
def _scale_actions(values: FloatArray, limits: tuple[float, float, float]) -> None:
    """Turn actions (n, 2) into velocities in place, as `PolicyAction.commands` does.

    Args:
        values: Actions of any size; speeds in m/s and yaw rates in rad/s afterwards.
        limits: Lowest and highest speed, highest yaw rate.
    """
    min_speed_mps, max_speed_mps, max_yaw_rate_radps = limits
    for i in range(len(values)):
        for k in range(values.shape[1]):
            # NaN fails both comparisons and stays.
            if values[i, k] < -1.0:
                values[i, k] = -1.0
            elif values[i, k] > 1.0:
                values[i, k] = 1.0
        share = 0.5 * (values[i, 0] + 1.0)
        values[i, 0] = min_speed_mps + share * (max_speed_mps - min_speed_mps)
        values[i, 1] *= max_yaw_rate_radps


@kernel
def _push_frames(
    last: Singles,
    is_empty: Bools,
    frame_steps: int,
    rows: Indices,
    frames: Vector,
    vectors: Vector,
) -> None:
    """Shift in frames of robots `rows` and write vectors; a first frame fills all.

    Args:
        last: Last frames (n, depth, frame_size), newest first, changed in place.
        is_empty: Robots (n,) without a frame so far, changed in place.
        frame_steps: Places in `last` between two frames of a vector.
        rows: Robots that have a new frame, (k,).
        frames: Frames (n, frame_size) of all robots.
        vectors: Vectors (n, size), changed in place.
    """
    depth = last.shape[1]
    size = last.shape[2]
    for row in rows:
        for place in range(depth - 1, 0, -1):
            # Nothing came before the first frame, so it fills the whole memory.
            older = frames[row] if is_empty[row] else last[row, place - 1]
            last[row, place] = older
        last[row, 0] = frames[row]
        is_empty[row] = False

        start = 0
        for place in range(0, depth, frame_steps):
            vectors[row, start : start + size] = last[row, place]
            start += size


@kernel
def nearest_returns(
    ranges: Vector,
    beam_bounds: Indices,
    valid_range: tuple[np.float32, np.float32],
    limit: np.float32,
    shares: Vector,
) -> None:
    """Write each sector's nearest return to `shares`, as a share (0 to 1) of `limit`.

    As in the other planners, a range outside the valid ones is no return. A sector
    without returns has the share 1.

    Args:
        ranges: Ranges (beams,) in m, from right to left.
        beam_bounds: First beam of each sector, and the beam after the last, (n + 1,).
        valid_range: Shortest valid range in m, and the one from which none is valid.
        limit: Range in m that counts as 1.
        shares: Shares (n,), changed in place.
    """
    lowest, highest = valid_range
    # With one beam per sector the loop has no branch, so the compiler vectorizes it.
    first = beam_bounds[0]
    end = beam_bounds[-1]
    if end - first == len(shares) and beam_bounds[-2] == end - 1:
        sector_ranges = ranges[first:end]
        for sector in range(len(shares)):
            # NaN fails the comparisons and becomes the limit.
            value = sector_ranges[sector]
            is_return = (lowest <= value) & (value < min(highest, limit))
            nearest = value if is_return else limit
            shares[sector] = nearest / limit
        return

    for sector in range(len(shares)):
        start = beam_bounds[sector]
        stop = beam_bounds[sector + 1]
        nearest = limit
        for beam in range(start, max(start + 1, stop)):
            if lowest <= ranges[beam] < highest:
                nearest = min(nearest, ranges[beam])
        shares[sector] = nearest / limit
