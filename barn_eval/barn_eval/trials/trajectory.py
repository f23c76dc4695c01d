"""What a robot did in a trial, as arrays, and the measures taken from them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from barn_worlds.base.types import NANOSECONDS, Odometry, Velocity2D
from barn_worlds.geometry.footprint import Footprint

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The readings of a trial, one row per instant.

    stamps_ns: (n,) int64. truth: (n, 3) x, y m, yaw rad in the map frame. velocity: (n, 2) true forward speed m/s and
    yaw rate rad/s. command: (n, 2) the command answering each reading, NaN where there was none. contact: (n,) bool.
    """

    stamps_ns: npt.NDArray[np.int64]
    truth: Floats
    velocity: Floats
    command: Floats
    contact: npt.NDArray[np.bool_]


class TrajectoryLog:
    """Collect a trajectory instant by instant."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._rows: list[tuple[float, ...]] = []
        self._contact: list[bool] = []
        self._commands: list[tuple[float, float]] = []

    def reading(self, truth: Odometry, collision: bool) -> None:
        """Add the true state at an instant."""
        self._stamps.append(truth.stamp_ns)
        pose, velocity = truth.pose, truth.velocity
        self._rows.append((pose.x, pose.y, pose.yaw, velocity.linear, velocity.angular))
        self._contact.append(collision)
        self._commands.append((np.nan, np.nan))

    def command(self, command: Velocity2D) -> None:
        """Add the command that answers the last reading."""
        if self._commands:
            self._commands[-1] = (command.linear, command.angular)

    def trajectory(self) -> Trajectory:
        """Return what has been collected."""
        rows = np.array(self._rows, np.float64).reshape(-1, 5)
        return Trajectory(
            np.array(self._stamps, np.int64),
            rows[:, :3],
            rows[:, 3:],
            np.array(self._commands, np.float64).reshape(-1, 2),
            np.array(self._contact, np.bool_),
        )


@dataclass(frozen=True)
class Measures:
    """Figures of a trajectory; None where it is too short for them.

    driven_m: length of the true path; driven_ratio: by the straight line from its first to its last point.
    min_clearance_m, mean_clearance_m: from the outline of what can touch of the robot to the nearest cylinder as it
    stood at the start (below zero: overlap), the mean over time. rms_jerk_mps3: of the forward speed.
    rotation_rad: sum of absolute turns. unanswered_cycles: readings that no command answered.
    """

    driven_m: float
    driven_ratio: float | None
    mean_speed_mps: float | None
    min_clearance_m: float | None
    mean_clearance_m: float | None
    contact_s: float
    contacts: int
    rms_jerk_mps3: float | None
    rotation_rad: float
    unanswered_cycles: int


def measure(trajectory: Trajectory, cylinders_m: Floats, radius_m: float, outline: Footprint) -> Measures:
    """Return the measures of a trajectory among cylinders with centres (k, 2) in the map frame."""
    steps = np.diff(trajectory.truth, axis=0)
    periods_ns = np.diff(trajectory.stamps_ns)
    driven = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
    straight = float(np.hypot(*(trajectory.truth[-1] - trajectory.truth[0])[:2])) if len(trajectory.truth) else 0.0
    duration = float(periods_ns.sum()) / NANOSECONDS
    clearance = clearances(trajectory.truth, cylinders_m, radius_m, outline)
    turns = np.abs((steps[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    began = trajectory.contact & ~np.concatenate(([False], trajectory.contact[:-1]))
    return Measures(
        driven_m=driven,
        driven_ratio=driven / straight if straight > 0.0 else None,
        mean_speed_mps=driven / duration if duration > 0.0 else None,
        min_clearance_m=float(clearance.min()) if clearance.size else None,
        mean_clearance_m=float(clearance.mean()) if clearance.size else None,
        contact_s=float(periods_ns[trajectory.contact[1:]].sum()) / NANOSECONDS,
        contacts=int(began.sum()),
        rms_jerk_mps3=_rms_jerk(trajectory),
        rotation_rad=float(turns.sum()),
        unanswered_cycles=int(np.isnan(trajectory.command[:-1, 0]).sum()),
    )


def clearances(poses: Floats, cylinders_m: Floats, radius_m: float, outline: Footprint) -> Floats:
    """Return the distance (n,) from the robot's outline at poses (n, 3) to the nearest cylinder (k, 2), all in metres.

    Below zero where they overlap: minus the depth to which the cylinder's centre lies inside the outline grown by
    its radius. Empty where there are no cylinders.
    """
    if not len(cylinders_m):
        return np.empty(0)
    nearest = np.empty(len(poses))
    for first in range(0, len(poses), 64):
        part = slice(first, first + 64)
        offset_x = cylinders_m[None, :, 0] - poses[part, 0, None]
        offset_y = cylinders_m[None, :, 1] - poses[part, 1, None]
        c, s = np.cos(poses[part, 2, None]), np.sin(poses[part, 2, None])
        away = outline.distances(c * offset_x + s * offset_y, c * offset_y - s * offset_x)
        nearest[part] = away.min(axis=1) - radius_m
    return nearest


def _rms_jerk(trajectory: Trajectory) -> float | None:
    """Return the root mean square of the second difference of the true forward speed, evenly sampled."""
    periods = np.diff(trajectory.stamps_ns) / NANOSECONDS
    if len(periods) < 2 or not (periods > 0.0).all():
        return None
    acceleration = np.diff(trajectory.velocity[:, 0]) / periods
    jerk = np.diff(acceleration) / (0.5 * (periods[1:] + periods[:-1]))
    return float(np.sqrt(np.mean(jerk**2)))
