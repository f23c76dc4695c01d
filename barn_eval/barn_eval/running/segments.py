"""The part of a recorded drive that is one trial, and what the referee makes of it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from barn_eval.results.bags.decode import find_mount
from barn_eval.results.bags.observed import ObservedDrive
from barn_eval.results.run_file import WORLDS
from barn_eval.trials.result import Outcome, format_trial_id
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.system import ObservedTrial
from barn_eval.trials.trajectory import Trajectory
from barn_eval.trials.trial import (
    FinishedTrial,
    RunningTrial,
    doubt_poses,
    finish_trial,
)
from barn_worlds.base.arrays import Floats, side_lengths, unit_vectors
from barn_worlds.base.errors import BagError
from barn_worlds.base.files import as_mapping
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    ORIGIN,
    Odometry,
    Pose2D,
    Velocity2D,
    seconds,
)

UNKNOWN_PLANNER = "unknown"

_FARTHEST_START_M = 1.0  # from the world's start, in the world's frame
_LARGEST_TURN_RAD = 0.1  # of the goal seen from the start against the world's
_FARTHEST_GOAL_M = 0.1  # from the world's goal, before a remark says so
# Scans of fewer degrees see too little of what is near the robot.
_NARROWEST_SCAN_RAD = math.pi
_DEEPEST_M = 0.05  # within the robot, for what a lidar sees to be no part of it
_GAP_PERIODS = 3.0  # without a pose, before a remark says so
_LONGEST_GAP_S = 0.5  # likewise, where poses are rare
_TWIST_TOLERANCE = 0.1  # of positions against the twist, before a remark says so
_CLOCK_TOLERANCE = 0.1  # of stamps against the log, before a remark says so
_SHORTEST_M = 0.5  # of a drive whose positions and twists are compared


@dataclass(frozen=True, eq=False)
class Segment:
    """The part of a drive that is one trial."""

    drive: ObservedDrive
    first: int  # index of its first pose
    end: int  # index after its last pose
    goal: Pose2D | None  # in the frame of the poses
    goal_frame: str = ""
    home: Pose2D | None = None  # where the bag's first trial began
    # World, planner and repetition as a bag of the suite, or its name, has them.
    dataset: str = ""
    world: int = 0
    planner: str = UNKNOWN_PLANNER
    repetition: int = 0

    @property
    def is_known(self) -> bool:
        """Whether more is known about its world than start and goal."""
        return self.dataset != WORLDS

    @property
    def start(self) -> Pose2D:
        """First pose of the segment, in the frame of the drive's poses."""
        pose: Pose2D = self.drive.poses[self.first].content.pose
        return pose

    @property
    def goal_problem(self) -> str:
        """Why the bag's goal cannot be used; "" if it can, or if there is none."""
        if self.goal or not self.drive.goals:
            return ""
        return (
            f"its goal is in frame {self.goal_frame!r}, but poses are in"
            f" {self.drive.frame!r}"
        )

    @property
    def trial_id(self) -> str:
        """Name of the trial, such as "gap_w0012_r00"."""
        return format_trial_id(self.planner, self.world, self.repetition)


def judge_segment(
    segment: Segment, spec: TrialSpec, operator_contacts_s: Sequence[float] | None
) -> FinishedTrial:
    """Judge a segment by the referee; return the trial; BagError if in another world.

    Args:
        segment: The segment.
        spec: The trial that it is.
        operator_contacts_s: Times of contacts from the start, if an operator and not
            the bag reports them.

    Raises:
        BagError: The poses are not those of the world.
    """
    drive = segment.drive
    if segment.end - segment.first < 2:
        raise BagError(f"{drive.path}: no poses between this goal and the next")
    origin, remarks = _place_poses(segment, spec)
    clocks = drive.clocks[segment.first : segment.end]
    # Stamps of a clock that was set in the trial say nothing about its times.
    later = np.flatnonzero(clocks > clocks[clocks >= 0].min(initial=clocks.max()))
    if len(later):
        segment = replace(segment, end=segment.first + int(later[0]))
    readings = _take_readings(segment, origin)
    if len(readings) < 2:
        raise BagError(f"{drive.path}: fewer than two of its stamps increase")
    trial = RunningTrial(spec)
    contacts = _find_contacts(segment, readings, operator_contacts_s)
    _replay(trial, segment, readings, contacts)
    trajectory = trial.log.trajectory()
    used = list(readings)[: len(trajectory.stamps_ns)]
    verdict = trial.verdict
    if verdict is None:
        left_m = trial.referee.standing.goal_distance_m
        detail = f"the bag ends {left_m:.2f} m from the goal, before a verdict"
        if len(later):
            stamp_ns = drive.poses[segment.end].content.stamp_ns
            jump_s = seconds(stamp_ns - int(trajectory.stamps_ns[-1]))
            detail = (
                f"stamps of poses jump by {jump_s:+.2f} s: the clock was set, so times"
                " are unknown"
            )
        verdict = trial.referee.fail(Outcome.ENVIRONMENT_FAILED, detail)
    else:
        # What comes later does not matter.
        segment = replace(segment, end=used[-1] + 1)
    doubts, uncertainty_s = _list_doubts(segment, spec, trajectory)
    jumps, arrival_error_s = doubt_poses(spec, verdict, trajectory)
    uncertainty_s += arrival_error_s
    remarks += doubts + jumps
    if not spec.system.reports_contacts:
        remarks.append("contacts are unknown, as nobody reported them")
    remarks += _list_ignored_goals(segment)
    if drive.problem:
        remarks.append(drive.problem)

    clearance_by = "world"
    if not segment.is_known or spec.system.frame != "world":
        clearance_m, doubts = _scan_clearances(drive, spec, used)
        remarks += doubts
        clearance_by = "scans" if np.isfinite(clearance_m).any() else ""
        trajectory = replace(trajectory, clearance_m=clearance_m)
    return finish_trial(
        spec,
        "ros",
        verdict,
        trajectory,
        remarks="; ".join(remarks),
        observed=ObservedTrial.of(spec.system, clearance_by, uncertainty_s),
    )


def _place_poses(segment: Segment, spec: TrialSpec) -> tuple[Pose2D, list[str]]:
    """Return (frame of poses in the world's, remarks); BagError if of another world.

    Raises:
        BagError: The poses are not those of the world.
    """
    if not segment.is_known:
        return ORIGIN, []
    drive = segment.drive
    course = spec.course
    checksum = as_mapping(drive.trial.get("world")).get("checksum", spec.world.checksum)
    if checksum != spec.world.checksum:
        raise BagError(
            f"{drive.path}: was not recorded in world {segment.world} of"
            f" {segment.dataset}; name its data set by --dataset"
        )
    origin = ORIGIN
    away_m = segment.start.distance(course.start)
    if spec.system.frame == "odom":
        origin = course.start @ segment.start.inverse()
    elif away_m > _FARTHEST_START_M:
        raise BagError(
            f"{drive.path}: its poses in frame {drive.frame} begin {away_m:.1f} m from the start of world"
            f" {segment.world}; if the origin of this frame is arbitrary, add --frame odom"
        )
    if segment.goal is None:
        return origin, []
    course_m = course.start.distance(course.goal)
    home = segment.home
    if home and segment.goal.distance(home) < _FARTHEST_START_M < course_m:
        raise BagError(
            f"{drive.path}: its goal is where the first trial began; a drive back is no"
            f" trial of world {segment.world}"
        )
    if spec.system.frame == "odom":
        # One heading of odometry is noisy; the direction of the goal is not.
        planned = course.start.inverse() @ course.goal
        recorded = segment.start.inverse() @ segment.goal
        turn = math.atan2(planned.y, planned.x) - math.atan2(recorded.y, recorded.x)
        if abs(math.remainder(turn, math.tau)) < _LARGEST_TURN_RAD:
            turned = course.start @ Pose2D(0.0, 0.0, turn)
            origin = turned @ segment.start.inverse()
    goal_away_m = (origin @ segment.goal).distance(course.goal)
    if goal_away_m <= _FARTHEST_GOAL_M:
        return origin, []
    return origin, [f"the goal in the bag is {goal_away_m:.2f} m from the world's"]


def _replay(
    trial: RunningTrial,
    segment: Segment,
    readings: Mapping[int, Odometry],
    contacts: set[int],
) -> None:
    """Give a trial its readings and the commands after each, up to its verdict."""
    drive = segment.drive
    commands: dict[int, list[Velocity2D]] = {}
    for logged in drive.commands:
        commands.setdefault(drive.index_at(logged.log_ns), []).append(logged.content)
    start_inverse = trial.spec.course.start.inverse()
    for index, truth in readings.items():
        measured = replace(truth, pose=start_inverse @ truth.pose)
        trial.read(measured, truth, index in contacts)
        for command in commands.get(index, ()):
            if trial.verdict is None:
                trial.command(command)
        if trial.verdict is not None:
            return


def _take_readings(segment: Segment, origin: Pose2D) -> dict[int, Odometry]:
    """Return readings in the world's frame by pose index, where stamps are right.

    Poses whose stamps are wrong or repeated are left out. A twist that is not known
    follows from the pose before.

    Args:
        segment: The segment.
        origin: The frame of its poses in the frame of the world.
    """
    readings: dict[int, Odometry] = {}
    last: Odometry | None = None
    for index in range(segment.first, segment.end):
        odometry: Odometry = segment.drive.poses[index].content
        stamp_ns = odometry.stamp_ns
        is_wrong = segment.drive.clocks[index] < 0
        if is_wrong or (last is not None and stamp_ns <= last.stamp_ns):
            continue
        pose = odometry.pose
        if origin != ORIGIN:
            pose = origin @ pose
        velocity = odometry.velocity
        if not velocity.is_finite():
            velocity = Velocity2D()
            if last is not None:
                step = last.pose.inverse() @ pose
                period_s = seconds(stamp_ns - last.stamp_ns)
                velocity = Velocity2D(step.x / period_s, step.yaw / period_s)
        last = Odometry(stamp_ns, pose, velocity)
        readings[index] = last
    return readings


def _list_ignored_goals(segment: Segment) -> list[str]:
    """Return remarks on goals in the bag that do not count."""
    drive = segment.drive
    remarks = []
    # In a bag of the suite, the goal is the world's in any frame.
    if segment.goal_problem and not drive.trial:
        remarks.append(f"{segment.goal_problem}: --world or --course sets the goal")
    if drive.other_goals:
        remarks.append(f"goals on {drive.other_goals} are ignored; --goal selects them")
    return remarks


def _list_doubts(
    segment: Segment, spec: TrialSpec, trajectory: Trajectory
) -> tuple[list[str], float]:
    """Return (remarks on doubtful times, their error in s).

    Args:
        segment: The segment.
        spec: The trial that it is.
        trajectory: Its readings.
    """
    periods_s = np.diff(trajectory.stamps_ns) / NANOSECONDS_PER_SECOND
    if not len(periods_s):
        return [], 0.0
    period_s = float(np.median(periods_s))
    gap_s = float(periods_s.max())
    doubts = []
    if gap_s > min(_GAP_PERIODS * period_s, _LONGEST_GAP_S):
        doubts.append(f"no pose for {gap_s:.2f} s")
    # The clock starts at a reading and stops at one, each up to a period late.
    uncertainty_s = max(2.0 * period_s, gap_s)
    drive = segment.drive
    part = slice(segment.first, segment.end)
    stamps_ns = np.array([pose.content.stamp_ns for pose in drive.poses[part]])
    log_ns = drive.log_times_ns[part]
    right = np.flatnonzero(drive.clocks[part] >= 0)
    jumps = np.diff(right) > 1
    if jumps.any():
        wrong = int(np.ptp(right)) + 1 - len(right)
        doubts.append(f"poses left out because of wrong stamps: {wrong}")
        # Where they are, the clock may have been set back a little.
        lost_ns = np.diff(log_ns[right]) - np.diff(stamps_ns[right])
        uncertainty_s += seconds(int(lost_ns[jumps].clip(0).sum()))
    logged_s = seconds(int(np.ptp(log_ns)))
    stamped_s = float(periods_s.sum())
    error_s = abs(logged_s - stamped_s)
    # A simulator's clock may be slower than the log's.
    if spec.system.kind == "robot" and error_s > max(
        gap_s, _CLOCK_TOLERANCE * logged_s
    ):
        doubts.append(
            f"stamps of poses span {stamped_s:.2f} s, the log {logged_s:.2f} s"
        )
        uncertainty_s += error_s

    driven_m = float(side_lengths(trajectory.truth).sum())
    twist_m = float(np.abs(trajectory.velocity[1:, 0]) @ periods_s)
    error_m = abs(twist_m - driven_m)
    if max(driven_m, twist_m) > _SHORTEST_M and error_m > _TWIST_TOLERANCE * driven_m:
        doubts.append(
            f"positions move {driven_m:.2f} m, but the twist says {twist_m:.2f} m:"
            " stamps may not be the robot's, or a unit is wrong"
        )
        # A robot that stands and turns its wheels tells nothing about its clock.
        uncertainty_s += stamped_s * error_m / max(driven_m, _SHORTEST_M)
    return doubts, uncertainty_s


def _find_contacts(
    segment: Segment,
    readings: Mapping[int, Odometry],
    operator_contacts_s: Sequence[float] | None,
) -> set[int]:
    """Return indices of poses with a contact since the one before, by operator or bag.

    Args:
        segment: The segment.
        readings: Its readings by index.
        operator_contacts_s: Times of contacts from the start; None takes the bag's.
    """
    drive = segment.drive
    indices = np.array(list(readings), np.int64)
    if operator_contacts_s is None:
        touched = [
            drive.index_at(contact.log_ns)
            for contact in drive.contacts
            if contact.content
        ]
        # A pose that was left out gives its contacts to the next one.
        positions = np.searchsorted(indices, [k for k in touched if k >= segment.first])
    else:
        stamps = np.array([reading.stamp_ns for reading in readings.values()])
        times_ns = stamps[0] + np.array(operator_contacts_s) * NANOSECONDS_PER_SECOND
        positions = np.searchsorted(stamps, times_ns)
    return set(indices[positions[positions < len(indices)]].tolist())


def _scan_clearances(
    drive: ObservedDrive, spec: TrialSpec, indices: Sequence[int]
) -> tuple[Floats, list[str]]:
    """Return (distance (n,) in m from the robot to what its last scan hit, remarks).

    NaN where there is no scan, or one that sees less than half of what is around.

    Args:
        drive: The drive.
        spec: The trial, for the robot's outline and lidar.
        indices: Indices of its poses.
    """
    lidar = spec.simulator.lidar
    mounts = {}
    remarks = []
    for frame in sorted({logged.frame for logged in drive.scans}):
        mount = find_mount(drive.mounts, frame)
        mounts[frame] = mount or Pose2D(
            lidar.mount_x_m, lidar.mount_y_m, lidar.mount_yaw_rad
        )
        if mount is None:
            remarks.append(
                f"/tf_static lacks {frame or 'the lidar'}, so a"
                f" {spec.simulator.chassis.name}'s lidar is assumed"
            )
    gaps = np.full(len(drive.poses), np.nan)
    for logged in drive.scans:
        scan = logged.content
        angles = scan.angles()
        is_hit = (scan.ranges >= scan.range_min) & (scan.ranges <= scan.range_max)
        if not is_hit.any() or abs(angles[-1] - angles[0]) < _NARROWEST_SCAN_RAD:
            continue
        ranges = scan.ranges[is_hit].astype(np.float64)
        points = ranges[:, None] * unit_vectors(angles[is_hit])
        x, y = mounts[logged.frame].transform(points).T
        index = drive.index_at(logged.log_ns)
        distances_m = spec.outline.distances(x, y)
        # A lidar may see parts of its own robot.
        outside_m = distances_m[distances_m > -_DEEPEST_M]
        if index >= 0 and len(outside_m):
            gaps[index] = np.fmin(gaps[index], outside_m.min())
    # Between two scans, the last one holds.
    sources = np.where(np.isfinite(gaps), np.arange(len(gaps)), 0)
    held: Floats = gaps[np.maximum.accumulate(sources)]
    return held[list(indices)], remarks
