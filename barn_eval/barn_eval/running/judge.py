"""Trials that somebody else ran, judged from their bags by the referee of the suite."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from barn_eval.results.bags.observed import Logged, ObservedDrive, read_observed_drive
from barn_eval.results.bags.sources import FIXED_FRAMES, Sources
from barn_eval.results.folder import ResultsFolder
from barn_eval.results.run_file import WORLDS
from barn_eval.results.store import TrialRecord
from barn_eval.results.tracks import track_line
from barn_eval.running.request import RunRequest
from barn_eval.running.segments import UNKNOWN_PLANNER, Segment, judge_segment
from barn_eval.trials.protocol import Protocol, load_protocol
from barn_eval.trials.result import Rows
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.spec import simulator_config
from barn_eval.trials.system import OPERATOR, System
from barn_sim.config import robot_of
from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import (
    BagError,
    BarnError,
    ConfigError,
    note,
    parse_number,
)
from barn_worlds.base.types import Pose2D
from barn_worlds.datasets.dataset import dataset_files
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import LARGEST_SIDE, World

T = TypeVar("T")

# Command of a planner that somebody else has started.
RECORDED = "recorded"

_TRIAL_ID = re.compile(r"(.+)_w(\d{4,})_r(\d\d)")
_BACK_M = 0.5  # from where a trial began, for another one to begin
_CELL_M = 10.0  # of a world of which nothing is known but start and goal


@dataclass(frozen=True)
class JudgeOptions(Checked):
    """What bags are judged by, and what is said about them."""

    world: str = quantity(
        "",
        "number of the world, one for all bags or one for each, such as 0,30,60; by"
        " default read from a bag of the suite or the bag's name, otherwise unknown",
    )
    dataset: str = quantity(
        "",
        "data set of the worlds; by default the data set in the bag, otherwise barn300",
    )
    protocol: str = quantity("challenge", "protocol: a name or a YAML file")
    robot: str = quantity("jackal", "robot: a name or a YAML file")
    system: str = quantity("unnamed", "name that you choose for the simulator or robot")
    kind: str = quantity("robot", "kind of system", choices=("simulator", "robot"))
    planner: str = quantity("", "name of the planner that drove")
    max_speed: float = quantity(
        0.0, "highest speed that the planner commands, 0 if unknown", "m/s", 0.0, 100.0
    )
    pose: str = quantity(
        "",
        "topic of poses, or frames of tf, such as /tf:odom.base_link; by default found by name or type",
    )
    frame: str = quantity(
        "auto",
        "frame of the poses: world, odom (with an arbitrary origin), or auto (selected by the frame's name)",
        choices=("auto", "world", "odom"),
    )
    goal: str = quantity("", "topic of goals; by default goal_pose")
    contact: str = quantity(
        "",
        "topic of contacts (Bool), operator or none; by default collision if the bag has that topic",
    )
    contact_at: str = quantity(
        "",
        "with contact operator: time from the start to each contact in s, such as 3.5,12",
    )
    namespace: str = quantity("", "namespace of the topics")

    def check_rules(self) -> None:
        """Raise ConfigError for a value that is not allowed."""
        are_whole = all(number.is_integer() for number in self.numbers("world"))
        self.require(are_whole, "world", "must be whole numbers, such as 0,30")
        self.numbers("contact_at")
        is_operator = self.contact == OPERATOR
        self.require(
            is_operator or not self.contact_at, "contact_at", "needs contact operator"
        )

    def numbers(self, name: str) -> list[float]:
        """Return the numbers in an option; ConfigError if one is below 0 or no number."""
        text = getattr(self, name)
        numbers = [parse_number(word) for word in text.split(",") if word]
        is_valid = all(0.0 <= number < math.inf for number in numbers)
        self.require(is_valid, name, "must be numbers of 0 or more, such as 0,30")
        return numbers


def judge(
    bags: Sequence[Path],
    out: Path,
    options: JudgeOptions | None = None,
    course: Sequence[float] = (),
    *,
    overwrite: bool = False,
) -> tuple[RunRequest, Rows]:
    """Judge one system's bags, write a run's folder, return run and rows; or raise.

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
            f"world: {len(worlds)} numbers for {len(bags)} bags; give one, or one for each"
        )
    is_operator = options.contact == OPERATOR
    contact = "" if is_operator else options.contact
    sources = Sources(options.pose, options.goal, contact, options.namespace)
    drives = [read_observed_drive(path, sources) for path in bags]
    systems = {_system_of(drive, options): drive.path for drive in drives}
    system = min(systems, key=str)
    if len(systems) > 1:
        examples = "; ".join(f"{path} of {of.label}" for of, path in systems.items())
        raise BagError(f"{examples}: judge each system into its own folder")
    segments: list[Segment] = []
    for number, drive in enumerate(drives):
        for segment in _split_by_goals(drive):
            world = worlds[number % len(worlds)] if worlds else None
            segments.append(_identify(segment, world, options, segments))

    run = _make_request(out, options, course, system, segments)
    specs = {spec.trial_id: spec for spec in run.trials()}
    contacts_s = options.numbers("contact_at") if is_operator else None
    finished = _collect(
        [segment for segment in segments if segment.trial_id in specs],
        lambda segment: judge_segment(segment, specs[segment.trial_id], contacts_s),
    )
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
    """Return the system of a drive, from options and its bag."""
    contact = drive.contact_source
    if options.contact == OPERATOR:
        contact = OPERATOR
    frame = options.frame
    if frame == "auto":
        frame = "world" if drive.frame in FIXED_FRAMES else "odom"
    return System(
        options.system, options.kind, drive.pose_source, frame, drive.clock, contact
    )


def _split_by_goals(drive: ObservedDrive) -> Iterator[Segment]:
    """Yield a drive's segments, one per goal, or the whole.

    A segment ends before the next goal. The same goal may be sent again and again: it
    begins a segment if the robot is back where the last one began.
    """
    count = len(drive.poses)
    if not drive.goals:
        yield Segment(drive, 0, count, None)
    poses = [logged.content.pose for logged in drive.poses]
    positions_m = np.array([pose.position for pose in poses])
    goals: dict[int, Logged] = {}  # by index of their first pose
    last = 0
    for goal in drive.goals:
        first = min(drive.index_at(goal.log_ns - 1) + 1, count - 1)
        # The same pose in the same frame, whenever it was sent.
        if goals and goals[last][1:] == goal[1:]:
            away_m = np.hypot(*(positions_m[last : first + 1] - positions_m[last]).T)
            if away_m.max(initial=0.0) < 2.0 * _BACK_M or away_m[-1] > _BACK_M:
                continue
        last = first
        goals[first] = goal
    for (first, goal), end in zip(goals.items(), [*goals, count][1:], strict=True):
        pose = goal.content if goal.frame == drive.frame else None
        yield Segment(drive, first, end, pose, goal.frame, poses[min(goals)])


def _identify(
    segment: Segment,
    world: float | None,
    options: JudgeOptions,
    earlier: Sequence[Segment],
) -> Segment:
    """Return a segment with data set, world, planner and an unused repetition set.

    Args:
        segment: The segment.
        world: Number of its world, if somebody names it.
        options: What is said about it.
        earlier: Segments identified before, whose trial IDs are taken.
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


def _collect(segments: Sequence[Segment], make: Callable[[Segment], T]) -> dict[str, T]:
    """Return by trial ID what is made of each segment; note those that are refused.

    Args:
        segments: The segments, by bag.
        make: Makes something of a segment, or raises BarnError to refuse it.

    Raises:
        BarnError: All segments of a bag are refused.
    """
    results: dict[str, T] = {}
    refused: list[tuple[Segment, BarnError]] = []
    for segment in segments:
        try:
            results[segment.trial_id] = make(segment)
        except BarnError as error:
            refused.append((segment, error))
    paths = {other.drive.path for other in segments if other.trial_id in results}
    for segment, reason in refused:
        if segment.drive.path not in paths:
            raise reason
        note(f"{segment.trial_id} is not judged: {reason}")
    return results


def _make_request(
    out: Path,
    options: JudgeOptions,
    course: Sequence[float],
    system: System,
    segments: Sequence[Segment],
) -> RunRequest:
    """Return the run of the segments; ConfigError if they are of several data sets."""
    datasets = sorted({segment.dataset for segment in segments})
    if len(datasets) > 1:
        raise ConfigError(
            f"bags are of several data sets, {', '.join(datasets)}: judge each into its own folder"
        )
    worlds = None
    protocol = load_protocol(options.protocol)
    simulator = simulator_config(protocol, robot=load_robot(options.robot))
    if datasets[0] == WORLDS:
        robot = robot_of(simulator)
        known = _collect(
            segments, lambda item: _unknown_world(item, course, protocol, robot)
        )
        segments = [segment for segment in segments if segment.trial_id in known]
        worlds = {segment.world: known[segment.trial_id] for segment in segments}
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


def _unknown_world(
    segment: Segment, course: Sequence[float], protocol: Protocol, robot: Robot
) -> World:
    """Return a world of start and goal alone, in the poses' frame; BagError if no goal.

    Args:
        segment: The segment, which begins at the start.
        course: Start x, y, yaw and goal x, y, in place of the bag's goal.
        protocol: The protocol, which the course must fit.
        robot: The robot.

    Raises:
        BagError: Neither says where the goal is.
        ConfigError: The goal counts as reached at the start.
    """
    path = segment.drive.path
    start = segment.start
    goal = segment.goal
    if course:
        x, y, yaw, goal_x, goal_y = course[:5]
        # From where the robot stood, whatever its poses began at.
        goal = start @ Pose2D(x, y, yaw).inverse() @ Pose2D(goal_x, goal_y, 0.0)
    if goal is None:
        reason = segment.goal_problem or (
            "has no goal on /goal_pose (topics that may have one:"
            f" {segment.drive.other_goals or 'none'})"
        )
        raise BagError(f"{path}: {reason}; name a goal by --goal, --world or --course")
    ends = np.array([start.position, goal.position])
    corner_x, corner_y = (ends.min(axis=0) - _CELL_M).tolist()
    # The world refuses more cells than that.
    sides = np.minimum(np.ptp(ends, axis=0) // _CELL_M + 3, LARGEST_SIDE + 1)
    world = World(
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
    protocol.scaled_to(world, robot.chassis).course(world)
    return world
