"""Observations from readings that arrive separately and in any order."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Generic, TypeVar

from barn_planners.interface import Observation
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.types import Odometry, Pose2D, Scan, nanoseconds

T = TypeVar("T")

_MAX_READINGS = 200  # of one source


@dataclass(frozen=True)
class SyncConfig(Checked):
    """How old a reading may be that is combined with a scan."""

    odometry_age_s: float = quantity(
        0.25,
        "greatest age of the odometry that a scan is combined with",
        "s",
        0.0,
        60.0,
    )
    pose_age_s: float = quantity(
        600.0,
        "greatest age of the localization that odometry carries on to a scan",
        "s",
        minimum=0.0,
    )


class Synchronizer:
    """Returns an observation for each scan once its readings have arrived.

    If a source sends one reading per scan with the scan's own stamp, as in lockstep,
    that reading is awaited. Otherwise the latest reading not after the scan is used, as
    soon as a later reading or the next scan shows that no better one will come. Such a
    source is not awaited again until one of its stamps matches a scan.
    """

    def __init__(self, config: SyncConfig, *, use_pose: bool):
        """Store the age limits; `use_pose`: each observation needs a pose, too."""
        self.config = config
        self._use_pose = use_pose
        self._odometry_age_ns = nanoseconds(config.odometry_age_s)
        self._pose_age_ns = nanoseconds(config.pose_age_s)
        self.reset()

    def reset(self) -> None:
        """Forget all readings, the pending scan and `restarted`."""
        self._odometry: _History[Odometry] = _History()
        self._poses: _History[Pose2D] = _History()
        # The scan that waits for its readings, and the stamp of the last complete one.
        self._scan: Scan | None = None
        self._last_ns: int | None = None
        self.restarted = False

    def add_odometry(self, odometry: Odometry) -> Observation | None:
        """Store odometry; return the observation that it completes, if any."""
        self._odometry.add(odometry.stamp_ns, odometry, self._last_ns)
        return self._complete(is_overtaken=False)

    def add_pose(self, stamp_ns: int, pose: Pose2D) -> Observation | None:
        """Store a pose in map; return the observation that it completes, if any.

        Args:
            stamp_ns: Time of the localization in ns.
            pose: Pose in the map frame.
        """
        self._poses.add(stamp_ns, pose, self._last_ns)
        return self._complete(is_overtaken=False)

    def add_scan(self, scan: Scan) -> list[Observation]:
        """Store a scan, forget all if time ran back; return the 0 to 2 observations.

        The scan before it is dropped if it still lacks a reading.

        A scan that is older than the last one means that time has restarted: everything
        is forgotten and `restarted` is set.
        """
        newest_ns = self._scan.stamp_ns if self._scan is not None else self._last_ns
        if newest_ns is not None and scan.stamp_ns < newest_ns:
            self.reset()
            self.restarted = True

        # The previous scan cannot expect better readings anymore.
        previous = self._complete(is_overtaken=True)
        self._scan = scan
        current = self._complete(is_overtaken=False)
        return [item for item in (previous, current) if item is not None]

    def _complete(self, *, is_overtaken: bool) -> Observation | None:
        """Complete the pending scan; return its observation, None if it must wait."""
        scan = self._scan
        if scan is None:
            return None
        stamp_ns = scan.stamp_ns
        if not self._odometry.is_settled(stamp_ns, is_overtaken):
            return None
        if self._use_pose and not self._poses.is_settled(stamp_ns, is_overtaken):
            return None

        odometry = self._odometry.latest(stamp_ns, self._odometry_age_ns)
        if odometry is None:
            return None
        pose = self._pose(stamp_ns, odometry) if self._use_pose else odometry.pose
        if pose is None:
            return None

        self._scan = None
        self._last_ns = stamp_ns
        return Observation(stamp_ns, odometry, scan, pose)

    def _pose(self, stamp_ns: int, odometry: Odometry) -> Pose2D | None:
        """Return the pose in map at a stamp, carried on by odometry; None if too old."""
        pose_ns = self._poses.latest_stamp(stamp_ns)
        pose = self._poses.latest(stamp_ns, self._pose_age_ns)
        if pose is None or pose_ns is None or stamp_ns == pose_ns == odometry.stamp_ns:
            return pose
        # amcl's poses are rare; the odometry carries the last one on to the scan.
        odometry_then = self._odometry.latest(pose_ns, self._odometry_age_ns)
        if odometry_then is None:
            return pose
        return pose @ (odometry_then.pose.inverse() @ odometry.pose)


class _History(Generic[T]):
    """The last readings of one source by stamp, and whether it sends one per scan."""

    def __init__(self) -> None:
        """Begin without readings, expecting one per scan."""
        self._readings: OrderedDict[int, T] = OrderedDict()
        self._sends_per_scan = True

    def add(self, stamp_ns: int, reading: T, last_scan_ns: int | None) -> None:
        """Store a reading by its stamp in ns; beyond 200, drop those stored first.

        One with the stamp of the last scan shows that the source sends one per scan.
        """
        self._readings[stamp_ns] = reading
        if stamp_ns == last_scan_ns:
            self._sends_per_scan = True
        while len(self._readings) > _MAX_READINGS:
            self._readings.popitem(last=False)

    def is_settled(self, stamp_ns: int, is_overtaken: bool) -> bool:
        """Return whether a reading is there for a stamp, and no better one is expected.

        It also updates whether the source sends one reading per scan.
        """
        if stamp_ns in self._readings:
            self._sends_per_scan = True
            return True
        # A later reading shows that the source has its own rate: it will send none for
        # this scan.
        if is_overtaken or (self._readings and max(self._readings) > stamp_ns):
            self._sends_per_scan = False
        return not self._sends_per_scan and self.latest_stamp(stamp_ns) is not None

    def latest_stamp(self, stamp_ns: int) -> int | None:
        """Return the latest stamp in ns not after `stamp_ns`, None if there is none."""
        earlier = [stamp for stamp in self._readings if stamp <= stamp_ns]
        return max(earlier, default=None)

    def latest(self, stamp_ns: int, max_age_ns: int) -> T | None:
        """Return the last reading up to `stamp_ns`, None if older than `max_age_ns`."""
        stamp = self.latest_stamp(stamp_ns)
        if stamp is None or stamp_ns - stamp > max_age_ns:
            return None
        return self._readings[stamp]
