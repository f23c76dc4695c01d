"""What the dynamic window approach remembers between cycles: turns in place and escapes."""

from barn_planners.dwa_config import DwaConfig
from barn_worlds.types import Pose2D, wrap_angle

LEFT, RIGHT = 0, 1


class DwaMemory:
    """Keeps the robot from oscillating in place, and from driving forward during an escape."""

    def __init__(self, config: DwaConfig):
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._turned = [False, False]
        self._committed = [False, False]
        self._turned_at: Pose2D | None = None
        self._escape_from: Pose2D | None = None

    @property
    def escaping(self) -> bool:
        """Whether an escape is in progress, so that driving forward is forbidden."""
        return self._escape_from is not None

    def allowed_turns(self) -> tuple[bool, bool]:
        """Return whether turning in place is allowed to the left and to the right.

        After two turns in place to one side the other side is forbidden.
        """
        return not self._committed[RIGHT], not self._committed[LEFT]

    def chose(self, pose: Pose2D, speed: float, turn: float) -> None:
        """Record the sample chosen at a pose."""
        if speed <= 0.0:
            side = LEFT if turn > 0.0 else RIGHT
            self._committed[side] = self._turned[side]
            self._turned[side] = True
            self._turned_at = pose
        self._moved(pose)

    def escapes(self, pose: Pose2D, *, begin: bool) -> None:
        """Record an escape at a pose; `begin`: it may be the first cycle of one."""
        if begin and self._escape_from is None:
            self._escape_from = pose
        self._moved(pose)

    def _moved(self, pose: Pose2D) -> None:
        if self._turned_at is not None and pose.distance(self._turned_at) > self._config.oscillation_reset_m:
            self._turned, self._committed, self._turned_at = [False, False], [False, False], None
        start = self._escape_from
        if start is not None and (
            pose.distance(start) > self._config.escape_reset_m
            or abs(wrap_angle(pose.yaw - start.yaw)) > self._config.escape_reset_rad
        ):
            self._escape_from = None
