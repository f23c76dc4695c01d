"""What a robot did in a trial, as arrays, and the measures taken from that."""

from dataclasses import dataclass

import numpy as np

from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    Odometry,
    Pose2D,
    Velocity2D,
    nanoseconds,
    wrap_angle,
)
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.geometry.kernels import distance_to_line
from barn_worlds.messages.topics import PLAN

NEAR_CONTACT_M = 0.1  # from an obstacle
MAX_PLAN_POINTS = 10_000

# Poses whose distances to all cylinders are computed at a time, to bound memory.
_BLOCK = 64


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The readings of a trial, one row per instant."""

    stamps_ns: Integers  # (n,)
    truth: Floats  # (n, 3) x, y m, yaw rad in the map frame
    velocity: Floats  # (n, 2) true forward speed m/s and yaw rate rad/s
    command: Floats  # (n, 2) answer to each reading, NaN where there was none
    contact: Bools  # (n,)
    off_plan_m: Floats  # (n,) from the planner's last plan, NaN without one
    command_counts: Integers  # (n,) commands that answer each reading
    # (n,) as measured, NaN where unknown; None to compute it from truth and world.
    clearance_m: Floats | None = None


class TrajectoryLog:
    """Collects a trajectory instant by instant."""

    def __init__(self) -> None:
        """Begin without readings, commands and plans."""
        self._stamps: list[int] = []
        # x, y, yaw; speed, yaw rate; contact; x and y in the frame of plans; speed and
        # yaw rate of the last command; number of commands.
        self._rows: list[list[float]] = []
        self._plans: list[tuple[int, Floats]] = []

    def reading(
        self, truth: Odometry, collision: bool, plan_pose: Pose2D | None = None
    ) -> None:
        """Append a reading of the true state, still without a command.

        Args:
            truth: True pose and twist in the map frame.
            collision: Whether there was a contact since the reading before.
            plan_pose: Pose of the robot in the frame of the planner's plans.
        """
        x, y = (np.nan, np.nan) if plan_pose is None else plan_pose.position
        state = [*truth.pose.numbers, *truth.velocity.numbers]
        self._stamps.append(truth.stamp_ns)
        self._rows.append([*state, collision, x, y, np.nan, np.nan, 0])

    def command(self, command: Velocity2D) -> None:
        """Set the command of the last reading, over an earlier one; count both.

        Before the first reading it is dropped.
        """
        if self._rows:
            row = self._rows[-1]
            row[8:10] = command.numbers
            row[10] += 1

    def plan(self, points: Floats, stamp_ns: int) -> None:
        """Keep a plan; drop it if too soon after the last, too long or malformed.

        Args:
            points: Points (n, 2) of the plan, in m.
            stamp_ns: Time of the reading that it answers; later ones may have come.
        """
        if self._plans and stamp_ns - self._plans[-1][0] < nanoseconds(PLAN.period_s):
            return
        if points.ndim != 2 or points.shape[1] != 2:
            return
        if 0 < len(points) <= MAX_PLAN_POINTS and np.isfinite(points).all():
            self._plans.append((stamp_ns, points.astype(np.float64)))

    def trajectory(self) -> Trajectory:
        """Return all readings so far as arrays, with distances from plans."""
        rows = np.array(self._rows, np.float64).reshape(-1, 11)

        # Each reading is measured against the last plan that answers an earlier one.
        plan_stamps = [stamp_ns for stamp_ns, _ in self._plans]
        plan_counts = np.searchsorted(plan_stamps, self._stamps).tolist()
        off_plan_m = np.full(len(rows), np.nan)
        for i, plan_count in enumerate(plan_counts):
            if plan_count:
                _, points = self._plans[plan_count - 1]
                off_plan_m[i] = distance_to_line(points, *rows[i, 6:8])

        return Trajectory(
            np.array(self._stamps, np.int64),
            rows[:, :3],
            rows[:, 3:5],
            rows[:, 8:10],
            rows[:, 5].astype(np.bool_),
            off_plan_m,
            rows[:, 10].astype(np.int64),
        )


@dataclass(frozen=True)
class Measures:
    """Figures of a trajectory; None where it is too short for them.

    Clearance is the distance from the robot's outline to the nearest cylinder as it
    stood at the start, below zero where they overlap. Steps lead from each command to
    the next.
    """

    driven_m: float  # length of the true path
    driven_ratio: (
        float | None
    )  # over the straight line from its first to its last point
    mean_speed_mps: float | None
    min_clearance_m: float | None
    mean_clearance_m: float | None  # over time
    contact_s: float | None  # None, as `contacts`, where nobody reports contacts
    contacts: int | None
    rms_jerk_mps3: float | None  # of the forward speed
    rotation_rad: float  # sum of absolute turns
    unanswered_cycles: int | None  # readings that no command answered
    near_contact_s: float | None = None  # within `NEAR_CONTACT_M` of a cylinder
    rms_yaw_jerk_radps3: float | None = None  # of the yaw rate
    speed_variation_mps: float | None = None  # sum of absolute steps
    turn_variation_radps: float | None = None
    rms_speed_step_mps: float | None = None  # root of the mean squared step
    rms_turn_step_radps: float | None = None
    off_plan_m: float | None = None  # mean distance from the planner's last plan


def measure_trajectory(
    trajectory: Trajectory,
    cylinders_m: Floats,
    radius_m: float,
    outline: Footprint,
    *,
    reports_contacts: bool = True,
) -> Measures:
    """Return a trajectory's length, clearances, contacts, jerk and command steps.

    Args:
        trajectory: What the robot did, in the map frame.
        cylinders_m: Centers (k, 2) of the cylinders in m, in the map frame.
        radius_m: Their radius in m.
        outline: What can touch of the robot, in base_link.
        reports_contacts: Whether contacts are known; else they are None.
    """
    truth = trajectory.truth
    contact = trajectory.contact
    dx, dy, turned = np.diff(truth, axis=0).T
    driven_m = float(np.hypot(dx, dy).sum())
    straight_m = 0.0
    if len(truth):
        straight_m = float(np.hypot(*(truth[-1] - truth[0])[:2]))
    # Yaw is wrapped: a jump by a full turn at pi is no rotation.
    turns = np.abs(wrap_angle(turned))

    # Each period belongs to the reading at its end.
    periods_ns = np.diff(trajectory.stamps_ns)
    duration_s = float(periods_ns.sum()) / NANOSECONDS_PER_SECOND
    contact_ns = periods_ns[contact[1:]].sum()
    contact_began = contact & ~np.concatenate(([False], contact[:-1]))
    contact_s = None
    contacts = None
    if reports_contacts:
        contact_s = float(contact_ns) / NANOSECONDS_PER_SECOND
        contacts = int(contact_began.sum())

    clearance = trajectory.clearance_m
    near_s = None
    if clearance is None:
        clearance = compute_clearances(truth, cylinders_m, radius_m, outline)
        near_s = 0.0
    min_clearance_m = None
    mean_clearance_m = None
    if np.isfinite(clearance).any():
        near_ns = periods_ns[clearance[1:] < NEAR_CONTACT_M].sum()
        near_s = float(near_ns) / NANOSECONDS_PER_SECOND
        min_clearance_m = float(np.nanmin(clearance))
        mean_clearance_m = float(np.nanmean(clearance))

    command = trajectory.command
    # Readings without an answer are skipped: a step leads to the next command.
    answers = command[np.isfinite(command).all(axis=1)]
    # Squares of the largest numbers would be infinite.
    steps = np.diff(answers.clip(-1e100, 1e100), axis=0)
    variation: list[float | None] = [None, None]
    rms_step: list[float | None] = [None, None]
    if len(steps):
        variation = np.abs(steps).sum(axis=0).tolist()
        rms_step = np.sqrt((steps**2).mean(axis=0)).tolist()

    distances_m = trajectory.off_plan_m[~np.isnan(trajectory.off_plan_m)]

    return Measures(
        driven_m=driven_m,
        driven_ratio=driven_m / straight_m if straight_m > 0.0 else None,
        mean_speed_mps=driven_m / duration_s if duration_s > 0.0 else None,
        min_clearance_m=min_clearance_m,
        mean_clearance_m=mean_clearance_m,
        contact_s=contact_s,
        contacts=contacts,
        rms_jerk_mps3=_rms_jerk(trajectory, 0),
        rotation_rad=float(turns.sum()),
        # The last reading usually ends the trial, so it needs no answer.
        unanswered_cycles=int(np.isnan(command[:-1]).any(axis=1).sum()),
        near_contact_s=near_s,
        rms_yaw_jerk_radps3=_rms_jerk(trajectory, 1),
        speed_variation_mps=variation[0],
        turn_variation_radps=variation[1],
        rms_speed_step_mps=rms_step[0],
        rms_turn_step_radps=rms_step[1],
        off_plan_m=float(distances_m.mean()) if distances_m.size else None,
    )


def compute_clearances(
    poses: Floats, cylinders_m: Floats, radius_m: float, outline: Footprint
) -> Floats:
    """Return distances (n,) in m to the nearest cylinder, < 0 inside; empty without.

    Args:
        poses: Poses (n, 3) of the robot in the frame of the cylinders: x, y m, yaw rad.
        cylinders_m: Centers (k, 2) of the cylinders in m.
        radius_m: Their radius in m.
        outline: What can touch of the robot, in base_link.

    Returns:
        Distances (n,) in m. Below zero where they overlap: minus the depth to which the
        cylinder's center lies inside the outline grown by the radius. Empty without
        cylinders.
    """
    if not len(cylinders_m):
        return np.empty(0)
    clearance = np.empty(len(poses))
    for start in range(0, len(poses), _BLOCK):
        block = slice(start, start + _BLOCK)
        x = cylinders_m[:, 0] - poses[block, 0, None]
        y = cylinders_m[:, 1] - poses[block, 1, None]
        cos = np.cos(poses[block, 2, None])
        sin = np.sin(poses[block, 2, None])
        distances = outline.distances(cos * x + sin * y, cos * y - sin * x)
        clearance[block] = distances.min(axis=1) - radius_m
    return clearance


def _rms_jerk(trajectory: Trajectory, axis: int) -> float | None:
    """Return the RMS jerk of forward speed (axis 0) or yaw rate (1), None if unknown.

    That is for fewer than three readings, or stamps that do not increase.
    """
    periods = np.diff(trajectory.stamps_ns) / NANOSECONDS_PER_SECOND
    if len(periods) < 2 or not (periods > 0.0).all():
        return None
    acceleration = np.diff(trajectory.velocity[:, axis]) / periods
    # An acceleration belongs to the middle of its period, so neighbors are half of
    # both periods apart.
    jerk = np.diff(acceleration) / (0.5 * (periods[1:] + periods[:-1]))
    return float(np.sqrt(np.mean(jerk**2)))
