"""The check that stops a planner with a reason before it acts on bad readings."""

import math
from dataclasses import dataclass

import numpy as np

from barn_planners.interface import Observation
from barn_worlds.base.arrays import Singles, kernel
from barn_worlds.base.config import Checked, optional, quantity
from barn_worlds.base.types import Pose2D, Scan, nanoseconds

# Anything beyond these is a fault of the source, not a fast robot or a large world.
_MAX_COORDINATE_M = 1.0e5
_MAX_SPEED = 1.0e3


@dataclass(frozen=True)
class LidarMountConfig(Checked):
    """Pose of the lidar on the robot."""

    lidar_x_m: float = quantity(
        0.055, "distance of the lidar ahead of base_link", "m", -10.0, 10.0
    )
    lidar_y_m: float = optional(
        0.0, "distance of the lidar to the left of base_link", "m", -10.0, 10.0
    )
    lidar_yaw_rad: float = optional(
        0.0, "direction of a scan's angle 0", "rad", -3.15, 3.15
    )

    @property
    def lidar(self) -> Pose2D:
        """Pose of the lidar in base_link, in m and rad."""
        return Pose2D(self.lidar_x_m, self.lidar_y_m, self.lidar_yaw_rad)


@dataclass(frozen=True)
class ObservationCheckConfig(Checked):
    """When a scan without any return means that the lidar is blind.

    In the open no beam returns either, so the distance of the last return decides.
    """

    stop_when_blind: bool = quantity(True, "stop while the lidar seems blind")
    blind_near_m: float = quantity(
        2.5,
        "the lidar counts as blind at once if its last return was nearer than this, or if it has had no return yet",
        "m",
        minimum=0.0,
    )
    blind_limit_s: float = quantity(
        2.0,
        "the lidar counts as blind after this time without a return",
        "s",
        minimum=0.0,
    )


class ObservationCheck:
    """Finds observations that a planner must not use, over the course of one trial."""

    def __init__(self, config: ObservationCheckConfig):
        """Store the limits; `reset` begins each trial."""
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget the last stamp and the last return of the lidar."""
        self._last_stamp_ns: int | None = None
        self._last_return_ns: int | None = None
        self._nearest_return_m = 0.0

    def problem(self, observation: Observation) -> str:
        """Return why an observation is older, invalid or blind, or ""; store its stamp."""
        stamp_ns = observation.stamp_ns
        if self._last_stamp_ns is not None and stamp_ns < self._last_stamp_ns:
            age_ns = self._last_stamp_ns - stamp_ns
            return f"the observation is {age_ns} ns older than the last one"
        self._last_stamp_ns = stamp_ns

        # Comparisons with NaN are false, so each test also catches values that are no
        # numbers.
        odometry = observation.odometry
        speed_is_usable = abs(odometry.velocity.linear) < _MAX_SPEED
        if not (_is_usable(odometry.pose) and speed_is_usable):
            return "the odometry holds no usable pose or velocity"
        if not abs(odometry.velocity.angular) < _MAX_SPEED:
            return "the odometry holds no usable yaw rate"
        if not _is_usable(observation.pose):
            return "the localization holds no usable pose"
        return self._scan_problem(stamp_ns, observation.scan)

    def _scan_problem(self, stamp_ns: int, scan: Scan) -> str:
        """Return why a scan is unusable, or an empty string; store its nearest return."""
        if len(scan.ranges) == 0:
            return "the scan is empty"
        geometry = (scan.angle_min, scan.angle_increment, scan.range_min)
        if not all(map(math.isfinite, geometry)):
            return "the scan holds no usable angles"

        nearest_m, has_far_beam = _nearest_return(
            scan.ranges, scan.shortest_return_m, scan.range_max
        )
        if nearest_m < math.inf:
            self._last_return_ns = stamp_ns
            self._nearest_return_m = nearest_m
            return ""
        if not has_far_beam:
            return "the scan holds no valid range"

        return self._blind_problem(stamp_ns)

    def _blind_problem(self, stamp_ns: int) -> str:
        """Return why a scan without returns means a blind lidar, or an empty string."""
        if not self.config.stop_when_blind:
            return ""
        if self._last_return_ns is None:
            return "the lidar has returned nothing yet"
        if self._nearest_return_m < self.config.blind_near_m:
            distance = f"{self._nearest_return_m:.2f} m away"
            return f"the lidar returns nothing though an obstacle was {distance}"
        limit_s = self.config.blind_limit_s
        if stamp_ns - self._last_return_ns > nanoseconds(limit_s):
            return f"the lidar has returned nothing for more than {limit_s:g} s"
        return ""


@kernel
def _nearest_return(
    ranges: Singles, range_min: float, range_max: float
) -> tuple[float, bool]:
    """Return the least valid range in m or inf, and whether one reaches `range_max`."""
    # Limits are rounded to the precision of the ranges, so that a range at the limit
    # compares as equal to it.
    lowest = np.float32(range_min)
    highest = np.float32(range_max)
    nearest = np.float32(np.inf)
    has_far_beam = False
    for k in range(len(ranges)):
        has_far_beam |= ranges[k] >= highest
        if lowest <= ranges[k] < highest:
            nearest = min(nearest, ranges[k])
    return float(nearest), has_far_beam


def _is_usable(pose: Pose2D) -> bool:
    """Return whether a pose is finite, and within 100 km of the origin in x and y."""
    return (
        abs(pose.x) < _MAX_COORDINATE_M
        and abs(pose.y) < _MAX_COORDINATE_M
        and math.isfinite(pose.yaw)
    )
