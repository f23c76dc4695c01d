"""What a robot did in a trial, as arrays, and the measures taken from them; among moving obstacles, whom it met."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_eval.trials.protocol import Protocol
from barn_worlds.base.arrays import Bools, Floats
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    Odometry,
    Pose2D,
    Velocity2D,
    nanoseconds,
)
from barn_worlds.geometry.bodies import shape_rows, wall_bodies
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.geometry.kernels import distance_to
from barn_worlds.messages.topics import PLAN
from barn_worlds.moving.tracks import Tracks
from barn_worlds.worlds.world import World

NEAR_CONTACT_M = 0.1  # from an obstacle, so that it counts as near contact
MAX_PLAN_POINTS = 10_000  # of a plan


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The readings of a trial, one row per instant."""

    stamps_ns: npt.NDArray[np.int64]  # (n,)
    truth: Floats  # (n, 3) x, y m, yaw rad in the map frame
    velocity: Floats  # (n, 2) true forward speed m/s and yaw rate rad/s
    command: (
        Floats  # (n, 2) the command answering each reading, NaN where there was none
    )
    contact: Bools  # (n,)
    off_plan_m: Floats | None = (
        None  # (n,) from the planner's last plan, NaN without one; None: plans were not taken
    )


class TrajectoryLog:
    """Collect a trajectory instant by instant."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._rows: list[tuple[float, ...]] = []
        self._commands: list[tuple[float, float]] = []
        self._plans: list[tuple[int, Floats]] = []

    def reading(
        self, truth: Odometry, collision: bool, place: Pose2D | None = None
    ) -> None:
        """Add the true state at an instant; place: of the robot in the frame of its plans."""
        pose, velocity = truth.pose, truth.velocity
        at = (np.nan, np.nan) if place is None else (place.x, place.y)
        self._stamps.append(truth.stamp_ns)
        self._rows.append(
            (
                pose.x,
                pose.y,
                pose.yaw,
                velocity.linear,
                velocity.angular,
                collision,
                *at,
            )
        )
        self._commands.append((np.nan, np.nan))

    def command(self, command: Velocity2D) -> None:
        """Add the command that answers the last reading."""
        if self._commands:
            self._commands[-1] = (command.linear, command.angular)

    def plan(self, points: Floats, stamp_ns: int) -> None:
        """Add a plan (n, 2) that answers the reading of an instant, as often as plans are published.

        It may come after later readings. What is no plan is left out.
        """
        if self._plans and stamp_ns - self._plans[-1][0] < nanoseconds(PLAN.period_s):
            return
        if (
            points.ndim == 2
            and points.shape[1] == 2
            and 0 < len(points) <= MAX_PLAN_POINTS
            and np.isfinite(points).all()
        ):
            self._plans.append((stamp_ns, points.astype(np.float64)))

    def trajectory(self) -> Trajectory:
        """Return what has been collected."""
        rows = np.array(self._rows, np.float64).reshape(len(self._rows), 8)
        commands = np.array(self._commands, np.float64).reshape(len(self._commands), 2)
        # off the last plan that answers an earlier reading
        last = (
            np.searchsorted([stamp_ns for stamp_ns, _ in self._plans], self._stamps) - 1
        ).tolist()
        off_plan_m = [
            distance_to(self._plans[k][1], *rows[i, 6:]) if k >= 0 else np.nan
            for i, k in enumerate(last)
        ]
        stamps_ns, contact = (
            np.array(self._stamps, np.int64),
            rows[:, 5].astype(np.bool_),
        )
        return Trajectory(
            stamps_ns,
            rows[:, :3],
            rows[:, 3:5],
            commands,
            contact,
            np.array(off_plan_m),
        )


@dataclass(frozen=True)
class Measures:
    """Figures of a trajectory; None where it is too short for them. Steps are from each command to the next.

    Clearance is from the outline of what can touch of the robot to the nearest cylinder as it stood at the start, below
    zero where they overlap.
    """

    driven_m: float  # length of the true path
    driven_ratio: float | None  # by the straight line from its first to its last point
    mean_speed_mps: float | None
    min_clearance_m: float | None
    mean_clearance_m: float | None  # over time
    contact_s: float
    contacts: int
    rms_jerk_mps3: float | None  # of the forward speed
    rotation_rad: float  # sum of absolute turns
    unanswered_cycles: int  # readings that no command answered
    near_contact_s: float | None = None  # within `CLOSE_M` of a cylinder
    rms_yaw_jerk_radps3: float | None = None  # of the yaw rate
    speed_variation_mps: float | None = None  # sum of absolute steps
    turn_variation_radps: float | None = None
    rms_speed_step_mps: float | None = None  # root of the mean squared step
    rms_turn_step_radps: float | None = None
    off_plan_m: float | None = None  # mean distance from the planner's last plan


def measure_trajectory(
    trajectory: Trajectory, cylinders_m: Floats, radius_m: float, outline: Footprint
) -> Measures:
    """Return the measures of a trajectory among cylinders with centres (k, 2) in the map frame."""
    dx, dy, turned = np.diff(trajectory.truth, axis=0).T
    periods_ns = np.diff(trajectory.stamps_ns)
    driven = float(np.hypot(dx, dy).sum())
    straight = (
        float(np.hypot(*(trajectory.truth[-1] - trajectory.truth[0])[:2]))
        if len(trajectory.truth)
        else 0.0
    )
    duration = float(periods_ns.sum()) / NANOSECONDS_PER_SECOND
    clearance = compute_clearances(trajectory.truth, cylinders_m, radius_m, outline)
    turns = np.abs((turned + np.pi) % (2.0 * np.pi) - np.pi)
    began = trajectory.contact & ~np.concatenate(([False], trajectory.contact[:-1]))
    near = (
        clearance[1:] < NEAR_CONTACT_M
        if clearance.size
        else np.zeros(len(periods_ns), np.bool_)
    )
    jumps = np.diff(
        trajectory.command[np.isfinite(trajectory.command).all(axis=1)], axis=0
    )
    speed_sum, turn_sum, speed_rms, turn_rms = (
        [
            *np.abs(jumps).sum(axis=0).tolist(),
            *np.sqrt((jumps**2).mean(axis=0)).tolist(),
        ]
        if len(jumps)
        else [None] * 4
    )
    off_plan = np.empty(0) if trajectory.off_plan_m is None else trajectory.off_plan_m
    off_plan = off_plan[~np.isnan(off_plan)]
    return Measures(
        driven_m=driven,
        driven_ratio=driven / straight if straight > 0.0 else None,
        mean_speed_mps=driven / duration if duration > 0.0 else None,
        min_clearance_m=float(clearance.min()) if clearance.size else None,
        mean_clearance_m=float(clearance.mean()) if clearance.size else None,
        contact_s=float(periods_ns[trajectory.contact[1:]].sum())
        / NANOSECONDS_PER_SECOND,
        contacts=int(began.sum()),
        rms_jerk_mps3=_rms_jerk(trajectory, 0),
        rotation_rad=float(turns.sum()),
        unanswered_cycles=int(np.isnan(trajectory.command[:-1]).any(axis=1).sum()),
        near_contact_s=float(periods_ns[near].sum()) / NANOSECONDS_PER_SECOND,
        rms_yaw_jerk_radps3=_rms_jerk(trajectory, 1),
        speed_variation_mps=speed_sum,
        turn_variation_radps=turn_sum,
        rms_speed_step_mps=speed_rms,
        rms_turn_step_radps=turn_rms,
        off_plan_m=float(off_plan.mean()) if off_plan.size else None,
    )


def compute_clearances(
    poses: Floats, cylinders_m: Floats, radius_m: float, outline: Footprint
) -> Floats:
    """Return the distance (n,) from the robot's outline at poses (n, 3) to the nearest cylinder (k, 2), all in metres.

    Below zero where they overlap: minus the depth to which the cylinder's centre lies inside the outline grown by
    its radius. Empty where there are no cylinders.
    """
    if not len(cylinders_m):
        return np.empty(0)
    nearest = np.empty(len(poses))
    for first in range(0, len(poses), 64):
        part = slice(first, first + 64)
        x, y = (cylinders_m[:, axis] - poses[part, axis, None] for axis in (0, 1))
        c, s = np.cos(poses[part, 2, None]), np.sin(poses[part, 2, None])
        nearest[part] = (
            outline.distances(c * x + s * y, c * y - s * x).min(axis=1) - radius_m
        )
    return nearest


def _rms_jerk(trajectory: Trajectory, axis: int) -> float | None:
    """Return the root mean square of the second difference of the true forward speed (0) or yaw rate (1)."""
    periods = np.diff(trajectory.stamps_ns) / NANOSECONDS_PER_SECOND
    if len(periods) < 2 or not (periods > 0.0).all():
        return None
    acceleration = np.diff(trajectory.velocity[:, axis]) / periods
    jerk = np.diff(acceleration) / (0.5 * (periods[1:] + periods[:-1]))
    return float(np.sqrt(np.mean(jerk**2)))


NEAR_M = 0.5


@dataclass(frozen=True)
class Encounters:
    """Figures of a trial among moving obstacles; None where there is nothing to tell.

    Those of a hit are of the last reading before the first contact; those over the straight run, to what counts as
    arrival, are of a success.
    """

    phase_s: float  # time into their motions at the start
    moving_clearance_m: (
        float | None
    )  # smallest distance from the robot's outline, 0 in contact
    # the shortest at any reading, if all kept their velocities and the robot its heading; of a box, the disc around it
    time_to_collision_s: float | None
    near_s: float  # within `NEAR_M` of one
    path_over_straight: float | None  # driven length by that of the run
    time_over_straight: (
        float | None
    )  # time on the clock by that of the run at the protocol's reference speed
    touched: str = ""  # name of the moving obstacle of the first contact
    hit_robot_mps: float | None = None  # the robot's speed
    hit_closing_mps: float | None = None  # at which the two closed in on each other
    hit_robot_share: float | None = (
        None  # of the robot in that: 1 against one at rest, 0 if it was run over
    )


def measure_encounters(
    trajectory: Trajectory,
    world: World,
    phase_s: float,
    outline: Footprint,
    protocol: Protocol,
    traversal_s: float | None,
) -> Encounters | None:
    """Return the figures of a trajectory in a world whose obstacles were `phase_s` into their motions at its start."""
    if not world.moving:
        return None
    course = protocol.course(world)
    times_s = (
        trajectory.stamps_ns - trajectory.stamps_ns[:1]
    ) / NANOSECONDS_PER_SECOND + phase_s
    gaps, waits = _nearness(trajectory, world.tracks, times_s, outline)
    periods_s = np.diff(times_s, prepend=times_s[:1])
    straight_m = course.start.distance(course.goal) - protocol.goal_distance_m
    dx, dy, _ = np.diff(trajectory.truth, axis=0).T
    driven_m = float(np.hypot(dx, dy).sum())
    shortest_s = float(waits.min(initial=math.inf))
    return Encounters(
        phase_s=phase_s,
        moving_clearance_m=float(gaps.min()) if gaps.size else None,
        time_to_collision_s=shortest_s if math.isfinite(shortest_s) else None,
        near_s=float(periods_s[(gaps <= NEAR_M).any(axis=1)].sum()),
        path_over_straight=None if traversal_s is None else driven_m / straight_m,
        time_over_straight=None
        if traversal_s is None
        else traversal_s * protocol.reference_speed_mps / straight_m,
        **_first_hit(trajectory, world, times_s, gaps, outline),
    )


def moving_shapes(tracks: Tracks, positions: Floats) -> Floats:
    """Return moving obstacles at positions (n, 2) as shapes (n, 7) of `barn_worlds.geometry.kernels`."""
    return shape_rows(positions, tracks.radius_m, tracks.size_m, tracks.yaw_rad)


def _nearness(
    trajectory: Trajectory, tracks: Tracks, times_s: Floats, outline: Footprint
) -> tuple[Floats, Floats]:
    """Return distance (m, n) in m and time to collision (m, n) in s of n obstacles at m readings."""
    positions, velocities = tracks.over(times_s)
    gaps, waits = np.empty(positions.shape[:2]), np.empty(positions.shape[:2])
    for k, (x, y, yaw) in enumerate(trajectory.truth.tolist()):
        shapes = moving_shapes(tracks, positions[k])
        gaps[k] = outline.gaps(shapes, x, y, yaw)
        waits[k] = outline.times_to_contact(
            shapes, velocities[k], x, y, yaw, trajectory.velocity[k, 0]
        )
    return gaps, waits


def _first_hit(
    trajectory: Trajectory,
    world: World,
    times_s: Floats,
    gaps: Floats,
    outline: Footprint,
) -> dict[str, Any]:
    """Return what `Encounters` has of the first contact, if that was with a moving obstacle.

    Contact lies between two readings; the obstacle is the one that is nearest at either of them. Speeds are those along
    the line from the robot's outline to it at the earlier one.
    """
    touching = np.flatnonzero(trajectory.contact)
    if not len(touching):
        return {}
    before = max(int(touching[0]) - 1, 0)
    rows = slice(before, int(touching[0]) + 1)
    nearest = gaps[rows].min(axis=0)
    index = int(nearest.argmin())
    if _standing_gap(trajectory.truth[rows], world, outline) < nearest[index]:
        return {}
    positions, velocities = world.tracks.at(float(times_s[before]))
    shape, position, velocity = (
        moving_shapes(world.tracks, positions)[index],
        positions[index],
        velocities[index],
    )
    x, y, yaw = trajectory.truth[before].tolist()
    speed, turn = trajectory.velocity[before].tolist()
    ahead, left = axes = np.array(
        [[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]]
    )
    base, towards = np.array([x, y]), position
    if not shape[2]:  # of a box, the point that is nearest to the robot
        side, across = sides = np.array([shape[5:], [-shape[6], shape[5]]])
        along = np.array([(base - position) @ axis for axis in sides]).clip(
            -shape[3:5], shape[3:5]
        )
        towards = position + along[0] * side + along[1] * across
    local = outline.nearest(*((towards - base) @ axis for axis in axes))
    lever = local[0] * ahead + local[1] * left
    line = towards - base - lever
    length = float(np.hypot(*line)) or math.inf
    own = speed * ahead + turn * np.array([-lever[1], lever[0]])
    robot, other = (float(one @ line) / length for one in (own, -velocity))
    both = max(robot, 0.0) + max(other, 0.0)
    share = max(robot, 0.0) / both if both > 0.0 else None
    hit = {
        "hit_robot_mps": abs(speed),
        "hit_closing_mps": robot + other,
        "hit_robot_share": share,
    }
    return {"touched": world.tracks.names[index], **hit}


def _standing_gap(poses: Floats, world: World, outline: Footprint) -> float:
    """Return the smallest distance from the robot at poses (n, 3) to a cylinder or a wall, infinite without any."""
    still = compute_clearances(
        poses, world.cylinders_m, world.cylinder_radius_m, outline
    )
    walls = wall_bodies(world.walls).shapes()
    gaps = [
        outline.gaps(walls, x, y, yaw).min(initial=math.inf)
        for x, y, yaw in poses.tolist()
    ]
    return min(max(float(still.min(initial=math.inf)), 0.0), float(min(gaps)))
