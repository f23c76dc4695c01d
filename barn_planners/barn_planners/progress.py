"""Detecting that the robot makes no progress, as Nav2's progress checker does."""

from barn_worlds.types import Pose2D, nanoseconds

_INTERRUPTION_NS = nanoseconds(1.0)


class ProgressCheck:
    """Requires `distance_m` of motion every `limit_s`; restarts after a pause of control, such as a recovery."""

    def __init__(self, distance_m: float, limit_s: float):
        self._distance_m = distance_m
        self._limit_ns = nanoseconds(limit_s)
        self.reset()

    def reset(self) -> None:
        """Forget the last trial."""
        self._place: Pose2D | None = None
        self._since_ns = 0
        self._last_ns = 0

    def stuck(self, stamp_ns: int, pose: Pose2D) -> bool:
        """Update with the robot's pose; tell whether it has been near one place for too long."""
        interrupted = stamp_ns - self._last_ns > _INTERRUPTION_NS
        self._last_ns = stamp_ns
        if self._place is None or interrupted or self._place.distance(pose) >= self._distance_m:
            self._place, self._since_ns = pose, stamp_ns
        return stamp_ns - self._since_ns > self._limit_ns
