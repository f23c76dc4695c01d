"""The check whether a robot still makes progress."""

from barn_worlds.base.types import Pose2D, nanoseconds

# A longer gap between two calls means that something else drove, such as a recovery.
_INTERRUPTION_NS = nanoseconds(1.0)


class ProgressCheck:
    """Tells when a robot has not moved a given distance within a time limit."""

    def __init__(self, distance_m: float, limit_s: float):
        """Require a move of `distance_m` within every `limit_s` of simulated time."""
        self._distance_m = distance_m
        self._limit_ns = nanoseconds(limit_s)
        self.reset()

    def reset(self) -> None:
        """Forget the last trial; the next pose starts the clock."""
        self._anchor: Pose2D | None = None
        self._anchor_ns = 0
        self._last_ns = 0

    def is_stuck(self, stamp_ns: int, pose: Pose2D) -> bool:
        """Record a pose; return whether the robot stayed near one place for too long.

        Args:
            stamp_ns: Simulated time in ns. A pause of over one second restarts the
                clock.
            pose: Pose of the robot in any frame that stays the same.

        Returns:
            Whether the robot has stayed near one place for longer than the limit.
        """
        is_interrupted = stamp_ns - self._last_ns > _INTERRUPTION_NS
        self._last_ns = stamp_ns
        if (
            self._anchor is None
            or is_interrupted
            or self._anchor.distance(pose) >= self._distance_m
        ):
            self._anchor = pose
            self._anchor_ns = stamp_ns
        return stamp_ns - self._anchor_ns > self._limit_ns
