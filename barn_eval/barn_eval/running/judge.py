"""Trials that somebody else ran, judged from their bags by the referee of the suite."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from barn_eval.results.bags.observed import ObservedDrive, read_observed_drive
from barn_eval.results.bags.sources import Sources
from barn_eval.results.folder import ResultsFolder
from barn_eval.results.run_file import WORLDS
from barn_eval.results.store import TrialRecord
from barn_eval.results.tracks import track_line
from barn_eval.running.request import RunRequest
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.result import TrialResult, format_trial_id
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_eval.trials.system import OPERATOR, ObservedTrial, System
from barn_eval.trials.trial import FinishedTrial, RunningTrial, finish_trial
from barn_sim.config import robot_of
from barn_worlds.base.arrays import Floats
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import BagError, ConfigError
from barn_worlds.base.text_files import as_mapping
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    Odometry,
    Pose2D,
    Velocity2D,
    seconds,
)
from barn_worlds.datasets.dataset import dataset_files
from barn_worlds.messages.topics import FRAMES
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import LARGEST_SIDE, World

# Command of a planner that somebody else has started.
RECORDED = "recorded"
UNKNOWN_PLANNER = "unknown"

_TRIAL_ID = re.compile(r"(.+)_w(\d{4,})_r(\d\d)")
_FIXED_FRAMES = (FRAMES.map, "world")
_ORIGIN = Pose2D(0.0, 0.0, 0.0)
_CELL_M = 10.0  # of a world of which nothing is known but start and goal
_FARTHEST_START_M = 1.0  # from the world's start, in the world's frame
_FARTHEST_GOAL_M = 0.1  # from the world's goal, before it is said
# Scans of fewer degrees see too little of what is near the robot.
_NARROWEST_SCAN_RAD = math.pi
_GAP_PERIODS = 3.0  # without a pose, before it is said
_TWIST_TOLERANCE = 0.1  # of positions against the twist, before it is said
_SHORTEST_M = 0.5  # of a drive for which they are compared


@dataclass(frozen=True)
class JudgeOptions(Checked):
    """What bags are judged by, and what is said about them."""

    world: str = quantity(
        "",
        "number of the world of all bags, or of each, such as 0,30,60; by default that"
        " of the bag of the suite or of its name, else none is known",
    )
    dataset: str = quantity("", "data set of the worlds; by default the bag's, barn300")
    protocol: str = quantity("challenge", "rules: a name or a YAML file")
    robot: str = quantity("jackal", "a name or a YAML file")
    system: str = quantity("unnamed", "name of the simulator or robot, as you like")
    kind: str = quantity("robot", "what it is", choices=("simulator", "robot"))
    planner: str = quantity("", "who drove")
    max_speed: float = quantity(
        0.0, "highest speed that the planner commands, 0 if unknown", "m/s", 0.0, 100.0
    )
    pose: str = quantity(
        "",
        "topic of poses, or frames of tf, such as /tf:odom.base_link; by default the"
        " odometry",
    )
    frame: str = quantity(
        "auto",
        "frame of the poses: the world's, one that begins anywhere, or as it is named",
        choices=("auto", "world", "odom"),
    )
    goal: str = quantity("", "topic of goals; by default goal_pose")
    contact: str = quantity(
        "", "topic of contacts (Bool), operator or none; by default collision, if any"
    )
    contact_at: str = quantity(
        "", "with contact operator: seconds from the start to each, such as 3.5,12"
    )
    namespace: str = quantity("", "in front of the names of topics")

    def __post_init__(self) -> None:
        """Raise ConfigError for a value that is not allowed."""
        super().__post_init__()
        worlds = self.numbers("world")
        are_whole = all(number.is_integer() for number in worlds)
        self.require(are_whole, "world", "must be whole numbers, such as 0,30")
        self.numbers("contact_at")
        is_operator = self.contact == OPERATOR
        self.require(
            is_operator or not self.contact_at, "contact_at", "needs contact operator"
        )

    def numbers(self, name: str) -> list[float]:
        """Return the numbers in a text; ConfigError unless all are of 0 or more."""
        text = getattr(self, name)
        try:
            numbers = [float(word) for word in text.split(",") if word]
        except ValueError:
            numbers = [-1.0]
        is_valid = all(0.0 <= number < math.inf for number in numbers)
        self.require(is_valid, name, "must be numbers of 0 or more, such as 0,30")
        return numbers

    @property
    def sources(self) -> Sources:
        """Which topics of a bag are named."""
        contact = "" if self.contact == OPERATOR else self.contact
        return Sources(self.pose, self.goal, contact, self.namespace)


@dataclass(frozen=True, eq=False)
class _Segment:
    """The part of a drive that is one trial."""

    drive: ObservedDrive
    first: int  # index of its first pose
    end: int  # index behind its last pose
    goal: Pose2D | None  # in the frame of the poses
    # World, planner and repetition as a bag of the suite, or its name, has them.
    dataset: str = ""
    world: int = 0
    planner: str = UNKNOWN_PLANNER
    repetition: int = 0

    @property
    def is_known(self) -> bool:
        """Whether more is known of its world than start and goal."""
        return self.dataset != WORLDS

    @property
    def start(self) -> Pose2D:
        """Its first pose."""
        pose: Pose2D = self.drive.poses[self.first].content.pose
        return pose

    @property
    def trial_id(self) -> str:
        """Name of the trial."""
        return format_trial_id(self.planner, self.world, self.repetition)


def judge(
    bags: Sequence[Path],
    out: Path,
    options: JudgeOptions | None = None,
    course: Sequence[float] = (),
    *,
    overwrite: bool = False,
) -> tuple[RunRequest, list[TrialResult]]:
    """Judge the trials of bags, and write rows and tracks as a run does.

    Args:
        bags: The bags, of one system.
        out: Folder of the results.
        options: Rules and what is said about the bags.
        course: Start x, y, yaw and goal x, y in m and rad, in place of others.
        overwrite: Delete the results of another run in the folder.

    Returns:
        The run that the folder then holds, and its rows.

    Raises:
        BagError: A bag cannot be read, or does not say what is needed.
        ConfigError: The request is invalid, or the folder holds another run.
    """
    options = options or JudgeOptions()
    worlds = options.numbers("world")
    if len(worlds) not in (0, 1, len(bags)):
        raise ConfigError(
            f"world: {len(worlds)} for {len(bags)} bags; name one of all, or one of each"
        )
    drives = [read_observed_drive(path, options.sources) for path in bags]
    systems = {_system_of(drive, options): drive.path for drive in drives}
    system = min(systems, key=str)
    if len(systems) > 1:
        examples = "; ".join(f"{path} of {of.label}" for of, path in systems.items())
        raise BagError(f"{examples}: judge them into folders of their own")
    segments: list[_Segment] = []
    for number, drive in enumerate(drives):
        for segment in _split(drive):
            world = worlds[number % len(worlds)] if worlds else None
            segments.append(_identify(segment, world, options, segments))

    run = _plan(out, options, course, system, segments)
    specs = {spec.trial_id: spec for spec in run.trials()}
    finished = {}
    for segment in segments:
        spec = specs[segment.trial_id]
        finished[spec.trial_id] = _judge_segment(segment, spec, options)
    # Only now, so that a bag that cannot be judged leaves no folder.
    with ResultsFolder.open(
        run.out,
        run.config,
        run.execution,
        [spec for spec in specs.values() if spec.trial_id in finished],
        run.worlds,
        overwrite=overwrite,
    ) as folder:
        for spec in folder.remaining:
            trial = finished[spec.trial_id]
            folder.append(TrialRecord(trial.result, track_line(trial)))
        return run, folder.complete()


def _system_of(drive: ObservedDrive, options: JudgeOptions) -> System:
    """Return the system that a drive is of."""
    contact = drive.contact_source
    if options.contact == OPERATOR:
        contact = OPERATOR
    frame = options.frame
    if frame == "auto":
        frame = "world" if drive.frame in _FIXED_FRAMES else "odom"
    return System(
        options.system, options.kind, drive.pose_source, frame, drive.clock, contact
    )


def _split(drive: ObservedDrive) -> Iterator[_Segment]:
    """Yield the trials of a drive: one to each goal, from its first pose on.

    Without goals, one of the whole drive.
    """
    count = len(drive.poses)
    if not drive.goals:
        yield _Segment(drive, 0, count, None)
        return
    goal_times = [goal.log_ns for goal in drive.goals]
    firsts = np.searchsorted(drive.log_times_ns, goal_times).tolist()
    for goal, first, end in zip(drive.goals, firsts, [*firsts[1:], count], strict=True):
        if end - first < 2:
            raise BagError(
                f"{drive.path}: has no poses for its goal {goal.content.pose}"
            )
        pose = goal.content.pose if goal.content.frame == drive.frame else None
        yield _Segment(drive, first, end, pose)


def _identify(
    segment: _Segment,
    world: float | None,
    options: JudgeOptions,
    earlier: Sequence[_Segment],
) -> _Segment:
    """Return a segment with data set, world, planner and repetition.

    Args:
        segment: The segment.
        world: Number of its world, if somebody names it.
        options: What is said about it.
        earlier: Segments that have theirs, which no other gets.
    """
    drive = segment.drive
    # A bag may name any file; only those of the suite are opened.
    dataset = options.dataset or str(drive.trial.get("dataset"))
    if not options.dataset and dataset not in dataset_files():
        dataset = "barn300"
    name = str(drive.trial.get("trial_id", drive.path.name.partition(".")[0]))
    match = _TRIAL_ID.fullmatch(name)
    planner = UNKNOWN_PLANNER
    repetition = 0
    if match:
        planner = match[1]
        repetition = int(match[3])
        if world is None:
            world = int(match[2])
    if world is None:
        dataset = WORLDS
        world = len(earlier)
    segment = replace(
        segment,
        dataset=dataset,
        world=int(world),
        planner=options.planner or planner,
        repetition=repetition,
    )
    taken = {other.trial_id for other in earlier}
    while segment.trial_id in taken:
        segment = replace(segment, repetition=segment.repetition + 1)
    return segment


def _plan(
    out: Path,
    options: JudgeOptions,
    course: Sequence[float],
    system: System,
    segments: Sequence[_Segment],
) -> RunRequest:
    """Return the run that the segments are the trials of, with worlds that it keeps."""
    datasets = sorted({segment.dataset for segment in segments})
    if len(datasets) > 1:
        raise ConfigError(
            f"bags are of several data sets, {', '.join(datasets)}: judge them into"
            " folders of their own"
        )
    worlds = None
    protocol = load_protocol(options.protocol)
    simulator = simulator_config(protocol, robot=load_robot(options.robot))
    if datasets[0] == WORLDS:
        worlds = {}
        for segment in segments:
            worlds[segment.world] = _unknown_world(segment, course, robot_of(simulator))
        course = ()
    planners = dict.fromkeys(segment.planner for segment in segments)
    numbers = sorted({segment.world for segment in segments})
    config = RunConfig(
        dataset=datasets[0],
        worlds=",".join(map(str, numbers)),
        planners=tuple(
            PlannerChoice(planner, command=RECORDED, max_speed_mps=options.max_speed)
            for planner in planners
        ),
        repetitions=1 + max(segment.repetition for segment in segments),
        protocol=protocol,
        simulator=simulator,
        mode="ros",
        # Nobody waited for the planner.
        ros=RosConfig(lockstep=False),
        course=tuple(course),
        system=system,
    )
    return RunRequest(config, ExecutionConfig(), out, worlds).in_folder(out)


def _unknown_world(segment: _Segment, course: Sequence[float], robot: Robot) -> World:
    """Return a world of which nothing is known but start and goal, in the poses' frame.

    Args:
        segment: The segment, which begins at the start.
        course: Start x, y, yaw and goal x, y, in place of the bag's goal.
        robot: The robot.

    Raises:
        BagError: Neither says where the goal is.
    """
    path = segment.drive.path
    start = segment.start
    goal = segment.goal
    if course:
        x, y, yaw, goal_x, goal_y = course[:5]
        # From where the robot stood, whatever its poses began at.
        goal = start @ Pose2D(x, y, yaw).inverse() @ Pose2D(goal_x, goal_y, 0.0)
    if goal is None:
        goals = [goal.content.frame for goal in segment.drive.goals]
        reason = "has no goal (a topic of geometry_msgs/msg/PoseStamped)"
        if goals:
            reason = (
                f"its goal is in frame {goals[0]}, its poses in {segment.drive.frame}"
            )
        raise BagError(f"{path}: {reason}; name one by --goal, --world or --course")
    ends = np.array([(start.x, start.y), (goal.x, goal.y)])
    corner_x, corner_y = (ends.min(axis=0) - _CELL_M).tolist()
    # The world refuses more cells than that.
    sides = np.minimum(np.ptp(ends, axis=0) // _CELL_M + 3, LARGEST_SIDE + 1)
    return World(
        name=path.name,
        grid=np.zeros(sides.astype(int), np.bool_),
        # A path of one cell is none: no length follows from it.
        path=np.zeros((1, 2), np.int64),
        resolution_m=_CELL_M,
        footprint_cells=robot.footprint_cells(_CELL_M),
        corner_m=(corner_x, corner_y),
        start=start,
        goal=goal,
    )


def _judge_segment(
    segment: _Segment, spec: TrialSpec, options: JudgeOptions
) -> FinishedTrial:
    """Give the readings of a segment to the referee; return the finished trial.

    Raises:
        BagError: The poses are not those of the world.
    """
    drive = segment.drive
    origin, remarks = _place_poses(segment, spec)
    readings, back_ns = _take_readings(segment, origin)
    doubts, uncertainty_s = _list_doubts(list(readings.values()), back_ns)
    remarks += doubts
    if not spec.system.reports_contacts:
        remarks.append("contacts are unknown, as nobody reported them")
    if drive.problem:
        remarks.append(drive.problem)

    trial = RunningTrial(spec)
    _replay(trial, segment, readings, options)
    verdict = trial.verdict
    if verdict is None:
        left_m = trial.referee.standing.goal_distance_m
        verdict = trial.referee.fail(
            Outcome.ENVIRONMENT_FAILED,
            f"the bag ends {left_m:.2f} m from the goal, before a verdict",
        )

    trajectory = trial.log.trajectory()
    clearance_by = "world"
    if not segment.is_known or spec.system.frame != "world":
        used = list(readings)[: len(trajectory.stamps_ns)]
        clearance_m = _scan_clearances(drive, spec, used)
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


def _place_poses(segment: _Segment, spec: TrialSpec) -> tuple[Pose2D, list[str]]:
    """Return the frame of a segment's poses in the world's, and what is doubtful.

    Raises:
        BagError: The poses are not those of the world.
    """
    if not segment.is_known:
        return _ORIGIN, []
    drive = segment.drive
    course = spec.course
    checksum = as_mapping(drive.trial.get("world")).get("checksum", spec.world.checksum)
    if checksum != spec.world.checksum:
        raise BagError(
            f"{drive.path}: was not recorded in world {segment.world} of"
            f" {segment.dataset}; name its data set by --dataset"
        )
    origin = _ORIGIN
    away_m = segment.start.distance(course.start)
    if spec.system.frame == "odom":
        origin = course.start @ segment.start.inverse()
    elif away_m > _FARTHEST_START_M:
        raise BagError(
            f"{drive.path}: its poses in frame {drive.frame} begin {away_m:.1f} m from"
            f" the start of world {segment.world}; if they are in a frame of their own,"
            " add --frame odom"
        )
    if segment.goal is None:
        return origin, []
    goal_away_m = (origin @ segment.goal).distance(course.goal)
    if goal_away_m <= _FARTHEST_GOAL_M:
        return origin, []
    return origin, [f"the goal in the bag is {goal_away_m:.2f} m from the world's"]


def _replay(
    trial: RunningTrial,
    segment: _Segment,
    readings: Mapping[int, Odometry],
    options: JudgeOptions,
) -> None:
    """Give a trial its readings and the commands after each, up to its verdict."""
    contacts = _find_contacts(segment, readings, options)
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


def _take_readings(
    segment: _Segment, origin: Pose2D
) -> tuple[dict[int, Odometry], int]:
    """Return true poses by index of the pose, and by how many ns stamps go back.

    Poses whose stamps do not increase are left out. A twist that is not known follows
    from the pose before.

    Args:
        segment: The segment.
        origin: The frame of its poses in the frame of the world.
    """
    readings: dict[int, Odometry] = {}
    last: Odometry | None = None
    back_ns = 0
    for index in range(segment.first, segment.end):
        logged = segment.drive.poses[index]
        odometry: Odometry = logged.content
        stamp_ns = odometry.stamp_ns
        if segment.drive.clock == "log":
            stamp_ns = logged.log_ns
        if last is not None and stamp_ns <= last.stamp_ns:
            back_ns = max(back_ns, last.stamp_ns - stamp_ns)
            continue
        pose = odometry.pose
        if origin != _ORIGIN:
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
    return readings, back_ns


def _list_doubts(
    readings: Sequence[Odometry], back_ns: int
) -> tuple[list[str], float | None]:
    """Return sentences on what is doubtful in the times, and how far these may be off.

    Args:
        readings: The readings.
        back_ns: By how much stamps have gone back.
    """
    if len(readings) < 2:
        return [], None
    stamps_ns = np.array([reading.stamp_ns for reading in readings])
    periods_s = np.diff(stamps_ns) / NANOSECONDS_PER_SECOND
    period_s = float(np.median(periods_s))
    gap_s = float(periods_s.max())
    doubts = []
    if gap_s > _GAP_PERIODS * period_s:
        doubts.append(f"no pose for {gap_s:.2f} s")
    # The clock starts at a reading and stops at one, each up to a period late.
    uncertainty_s = max(2.0 * period_s, gap_s)
    if back_ns:
        doubts.append(f"stamps of poses go back by up to {seconds(back_ns):.2f} s")
        uncertainty_s += seconds(back_ns)

    positions = np.array([(reading.pose.x, reading.pose.y) for reading in readings])
    speeds = np.array([reading.velocity.linear for reading in readings])
    driven_m = float(np.hypot(*np.diff(positions, axis=0).T).sum())
    twist_m = float(np.abs(speeds[1:]) @ periods_s)
    if driven_m > _SHORTEST_M and abs(twist_m - driven_m) > _TWIST_TOLERANCE * driven_m:
        doubts.append(
            f"positions move {driven_m:.2f} m where the twist says {twist_m:.2f} m:"
            " stamps may not be those of the robot"
        )
        uncertainty_s += float(periods_s.sum()) * abs(twist_m / driven_m - 1.0)
    return doubts, uncertainty_s


def _find_contacts(
    segment: _Segment,
    readings: Mapping[int, Odometry],
    options: JudgeOptions,
) -> set[int]:
    """Return the indices of poses with a contact since the one before.

    Args:
        segment: The segment.
        readings: Its readings by index.
        options: Whether an operator says when contacts were, in place of a topic.
    """
    drive = segment.drive
    indices = np.array(list(readings), np.int64)
    if options.contact != OPERATOR:
        touched = [
            drive.index_at(contact.log_ns)
            for contact in drive.contacts
            if contact.content
        ]
        # A pose that was left out gives its contacts to the next one.
        positions = np.searchsorted(indices, [k for k in touched if k >= segment.first])
    else:
        stamps = np.array([reading.stamp_ns for reading in readings.values()])
        times_ns = (
            stamps[0] + np.array(options.numbers("contact_at")) * NANOSECONDS_PER_SECOND
        )
        positions = np.searchsorted(stamps, times_ns)
    return set(indices[positions[positions < len(indices)]].tolist())


def _scan_clearances(
    drive: ObservedDrive, spec: TrialSpec, indices: Sequence[int]
) -> Floats:
    """Return the distance (n,) in m from the robot's outline to what its last scan hit.

    NaN where there is no scan, or one that sees less than half of what is around.

    Args:
        drive: The drive.
        spec: The trial, for the robot's outline and lidar.
        indices: Indices of its poses.
    """
    lidar = spec.simulator.lidar
    built_in = Pose2D(lidar.mount_x_m, lidar.mount_y_m, lidar.mount_yaw_rad)
    mount = drive.mounts.get(drive.scan_frame, built_in)
    gaps = np.full(len(drive.poses), np.nan)
    for logged in drive.scans:
        scan = logged.content
        angles = scan.angles()
        is_hit = (scan.ranges >= scan.range_min) & (scan.ranges <= scan.range_max)
        if not is_hit.any() or abs(angles[-1] - angles[0]) < _NARROWEST_SCAN_RAD:
            continue
        ranges = scan.ranges[is_hit].astype(np.float64)
        bearings = angles[is_hit]
        points = np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])
        x, y = mount.transform(points).T
        index = drive.index_at(logged.log_ns)
        if index >= 0:
            gap_m = spec.outline.distances(x, y).min()
            gaps[index] = np.fmin(gaps[index], gap_m)
    # Between two scans, the last one holds.
    sources = np.where(np.isfinite(gaps), np.arange(len(gaps)), 0)
    held: Floats = gaps[np.maximum.accumulate(sources)]
    return held[list(indices)]
