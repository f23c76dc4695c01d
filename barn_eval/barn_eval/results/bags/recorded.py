"""Read a trial from a bag into arrays on one time line."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from barn_eval.results.bags import BAGS, decode
from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.bags.decode import TOPICS, metadata
from barn_eval.results.bags.messages import PUSHED_M
from barn_eval.results.bags.movers import ROUNDING_S, RecordedMotions, compute_gaps
from barn_eval.results.bags.sources import NO_SOURCES, PoseReader, Sources, TopicChoice
from barn_eval.trials.stamps import number_clocks
from barn_eval.trials.trajectory import compute_clearances
from barn_worlds.base.arrays import Bools, Floats
from barn_worlds.base.errors import BagError, BarnError, format_error
from barn_worlds.base.types import ORIGIN, OccupancyMap, Pose2D, seconds
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.messages import topics
from barn_worlds.messages.topics import FRAMES
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.scene import TrialScene, scene_of_map

MAP = FRAMES.map
ODOM = FRAMES.odom


class TimedItem(NamedTuple):
    """Content that applies from a time on."""

    time_s: float  # from the first pose
    frame: str  # of the bag
    content: Any


# Log time in ns, frame and content of messages.
_Rows = list[tuple[int, str, Any]]
ItemsByTopic = dict[topics.Topic, list[TimedItem]]


@dataclass(frozen=True, eq=False)
class RecordedTrial:
    """A trial, read from a bag.

    Times are in seconds from the first pose; poses are in the frame `frame`.
    """

    name: str  # of the bag
    folder: str  # of the results that it belongs to
    frame: str
    times_s: Floats  # (n,)
    poses: Floats  # (n, 3) m, rad
    speeds: Floats  # (n, 2) m/s, rad/s
    commands: Floats  # (n, 2), NaN where there was none by then
    contact: Bools  # (n,)
    odometry: Floats  # (n, 3) poses in the odom frame at the same times
    outline: Footprint  # of the robot's parts that can touch obstacles
    lidar: Pose2D  # where it is mounted

    # Content by topic, such as scans, points (k, 2) of plans, and the score.
    items: ItemsByTopic

    chassis: Chassis
    # Pose of the planner's map frame in the frame of the poses.
    map_frame: Pose2D
    map: OccupancyMap | None  # shifted by `map_frame`
    scene: TrialScene | None  # true obstacles, if the bag has them
    # Final places (k, 2) of cylinders that were pushed.
    pushed_m: Floats
    moving: RecordedMotions | None
    recoveries_s: tuple[float, ...]  # times at which the planner began to recover
    trial: dict[str, Any]
    result: dict[str, Any]
    problems: tuple[str, ...]  # texts on what makes poses and scans doubtful
    notes: tuple[str, ...]  # these, and texts on what else is missing

    def index_at(self, time_s: float) -> int:
        """Return the index of the last pose at or before `time_s`, 0 if none is."""
        after = np.searchsorted(self.times_s, time_s + ROUNDING_S, side="right")
        return max(0, int(after) - 1)

    def pose(self, index: int) -> Pose2D:
        """Return the pose of an index in `poses`."""
        return Pose2D(*self.poses[index].tolist())

    def to_frame(self, item: TimedItem) -> Pose2D:
        """Return the pose of an item's frame in the trial's, identity if unknown."""
        if item.frame == self.frame:
            return self.map_frame if item.frame == MAP else ORIGIN
        if item.frame not in (MAP, ODOM) or not np.isfinite(self.odometry).all():
            return ORIGIN
        index = self.index_at(item.time_s)
        true_pose = self.pose(index)
        # Odometry drifts, so its frame lies elsewhere at each time.
        odom_in_frame = true_pose @ Pose2D(*self.odometry[index].tolist()).inverse()
        return odom_in_frame if item.frame == ODOM else odom_in_frame.inverse()

    @cached_property
    def clearance_m(self) -> Floats:
        """Distances (n,) in m from the robot to the nearest obstacle, NaN if unknown.

        Cylinders count where they stood at the start, moving obstacles where they were.
        """
        clearance = np.full(len(self.times_s), np.nan)
        scene = self.scene
        if scene is not None and len(scene.cylinders_m):
            clearance = compute_clearances(
                self.poses, scene.cylinders_m, scene.radius_m, self.outline
            )
        moving = self.moving
        if moving is not None:
            places = moving.at(self.times_s)
            gaps = compute_gaps(
                moving.bodies, moving.walls, places, self.poses, self.outline
            )
            # If one of the two is NaN, the other counts.
            clearance = np.fmin(clearance, gaps)
        return clearance

    def goal_pose(self) -> Pose2D | None:
        """Return the goal in the frame of `poses`: true, else the bag's, else None.

        Frames are taken at the start, when they agree best.
        """
        if self.scene is not None and self.scene.goal is not None:
            return self.scene.goal
        goals = self.items[topics.GOAL_POSE]
        if not goals:
            return None
        goal = goals[-1]
        pose: Pose2D = goal.content
        if goal.frame == self.frame:
            return pose
        return self.to_frame(goal._replace(time_s=0.0)) @ pose


_pose_row = attrgetter("pose.x", "pose.y", "pose.yaw")  # of an odometry
_twist_row = attrgetter("linear", "angular")  # of a velocity


def read_recorded_trial(path: Path, sources: Sources = NO_SOURCES) -> RecordedTrial:
    """Read a bag into arrays, up to damage that `notes` name; BagError without poses.

    Args:
        path: The bag, in any format that `BagFile` reads.
        sources: Topics that replace the suite's. A named source of poses also replaces
            the true poses.

    Raises:
        BagError: If there is no bag, or it has no poses of a robot.
    """
    bag = BagFile(path)
    choice = TopicChoice(bag, sources)
    unreadable: dict[str, str] = {}
    items = _read_items(bag, choice, unreadable)
    truth = items[topics.GROUND_TRUTH]
    odometry = items[topics.ODOM]
    poses = truth or odometry
    if not poses:
        reason = bag.problem or "; ".join(unreadable.values())
        reason = reason or "the bag may be of another robot, or of no trial"
        raise BagError(
            f"{path}: no poses of a robot on /ground_truth/odom or /odom ({reason})"
            f"{choice.list_topics()}"
        )

    trial = metadata(bag, "barn.trial", "specification")
    result = metadata(bag, "barn.result", "result")
    lidar, lidar_note = _find_lidar(items, trial)
    chassis, robot_note = decode.chassis_of(trial)

    # Odometry drifts relative to the obstacles, so these are only drawn with true poses.
    pose_note = ""
    if not truth:
        pose_note = "no /ground_truth/odom: positions are from the odometry"
        items |= {topics.WORLD: [], topics.MOVING_POSES: []}
    scene, pushed_m = _read_scene(items[topics.WORLD])
    moving, moving_note = _read_motions(items)

    # Map and plan are shifted to where the obstacles stand.
    frame = MAP if truth else poses[0].frame or ODOM
    grid: OccupancyMap | None = None
    map_frame = ORIGIN
    maps = items[topics.MAP]
    if maps:
        grid = maps[-1].content
        if truth:
            map_frame = decode.map_frame(trial)
            grid = replace(
                grid,
                origin_x=grid.origin_x + map_frame.x,
                origin_y=grid.origin_y + map_frame.y,
            )

        elif scene is None and maps[-1].frame == frame:
            scene = scene_of_map(grid)
            unreadable["scene"] = "obstacles are the occupied cells of the bag's map"

    problems = tuple(filter(None, (bag.problem, *unreadable.values(), lidar_note)))
    notes = [*problems, moving_note, robot_note, pose_note]
    if map_frame != ORIGIN:
        notes.append(
            "map and plan are drawn where the obstacles stand, which is"
            f" {math.hypot(*map_frame.position):.2f} m off in the planner's map"
        )
    if not result:
        notes.append(
            "the bag holds no result: its trial was not finished, or not the suite's"
        )
    contacts = items[topics.COLLISION]
    if not contacts:
        notes.append("contacts are unknown: the bag has no topic that reports them")

    times_s = np.array([item.time_s for item in poses])
    no_pose = (np.nan, np.nan, np.nan)
    touched = _hold(contacts, lambda contact: (contact,), times_s, (0.0,))

    folder = bag.path.resolve().parent
    # In the results of a run, bags are in a subfolder.
    if folder.name == BAGS:
        folder = folder.parent

    return RecordedTrial(
        name=bag.path.name,
        folder=folder.name,
        frame=frame,
        times_s=times_s,
        poses=np.array([_pose_row(item.content) for item in poses], np.float64),
        speeds=np.array([_twist_row(item.content.velocity) for item in poses]),
        commands=_hold(items[topics.CMD_VEL], _twist_row, times_s, no_pose[:2]),
        contact=touched[:, 0] > 0.0,
        odometry=_hold(odometry, _pose_row, times_s, no_pose),
        outline=contact_footprint(chassis),
        chassis=chassis,
        lidar=lidar,
        items=items,
        map_frame=map_frame,
        map=grid,
        scene=scene,
        pushed_m=pushed_m,
        moving=moving,
        recoveries_s=_find_recoveries(items[topics.DIAGNOSTICS]),
        trial=trial,
        result=result,
        problems=problems,
        notes=tuple(filter(None, notes)),
    )


def _read_items(
    bag: BagFile, choice: TopicChoice, unreadable: dict[str, str]
) -> ItemsByTopic:
    """Return decoded items by topic, 0 s at the first pose; `unreadable` gets reasons.

    Args:
        bag: The bag.
        choice: Meaning of its topics.
        unreadable: Receives a text for each topic that cannot be shown whole.
    """
    messages: dict[str, _Rows] = {path: [] for path in TOPICS}
    for message in bag.messages(choice.paths):
        topic = choice.paths.get(message.topic, "")
        type_name = message.type_name
        if topic not in TOPICS:
            continue
        if type_name not in TOPICS[topic]:
            text = f"{topic} is left out because its type is {type_name or 'unknown'}"
            unreadable.setdefault(topic, text)
            continue
        # Its first message has all there is to know.
        if topic == topics.MOVING.path and messages[topic]:
            continue
        try:
            frame, content = decode.frame_and_content(topic, type_name, message.data)
        except BarnError as error:  # only this message is lost
            text = (
                f"{topic} has messages that cannot be decoded ({format_error(error)})"
            )
            unreadable.setdefault(topic, text)
            continue
        messages[topic].append((message.stamp_ns, frame, content))

    if choice.sources.pose:
        messages[topics.GROUND_TRUTH.path] = []
        messages[topics.ODOM.path] = _read_poses(bag, choice.pose_reader())
    for rows in messages.values():
        # Messages with equal times keep their order.
        rows.sort(key=itemgetter(0))
    poses = messages[topics.GROUND_TRUTH.path] or messages[topics.ODOM.path]
    # In bags of the suite, log times are the robot's times.
    if "barn.trial" not in bag.metadata:
        _restamp(messages, poses, unreadable)
    start_ns = poses[0][0] if poses else 0
    items: ItemsByTopic = {}
    for key, _ in decode.READERS:
        items[key] = [
            TimedItem(seconds(stamp_ns - start_ns), frame, content)
            for stamp_ns, frame, content in messages[key.path]
        ]
    return items


def _read_poses(bag: BagFile, reader: PoseReader) -> _Rows:
    """Return rows of time, frame and odometry from a bag; BagError if there are none."""
    rows = [
        (message.stamp_ns, reader.frame, odometry)
        for message in bag.messages(reader.topics)
        for odometry in reader.read(message)
    ]
    if not rows:
        raise reader.missing_error()
    return rows


def _restamp(
    messages: dict[str, _Rows],
    poses: _Rows,
    unreadable: dict[str, str],
) -> None:
    """Replace log times by the robot's, unless poses have none or their clock was set.

    Args:
        messages: Rows of time, frame and content by topic, in order; changed in place.
        poses: The rows of the poses.
        unreadable: Receives a text if the clock was set and log times are kept.
    """
    stamps_ns = np.array([pose.stamp_ns for _, _, pose in poses], np.int64)
    if not stamps_ns.any():
        return
    log_ns = np.array([row[0] for row in poses])
    clocks = number_clocks(stamps_ns, log_ns)
    if (clocks > 0).any():
        unreadable["stamps"] = "stamps of poses jump, so times are from the log"
        return
    stamps_ns = stamps_ns[clocks == 0]
    log_ns = log_ns[clocks == 0]
    for rows in messages.values():
        # Other messages may have no stamp, so poses give their times.
        offsets = [row[0] - log_ns[0] for row in rows]
        places = np.interp(offsets, log_ns - log_ns[0], stamps_ns - stamps_ns[0])
        rows[:] = [
            (int(stamps_ns[0]) + round(place), *row[1:])
            for place, row in zip(places.tolist(), rows, strict=True)
        ]


def _hold(
    items: list[TimedItem],
    row_of: Callable[[Any], tuple[Any, ...]],
    times_s: Floats,
    before: tuple[float, ...],
) -> Floats:
    """Return the row of the latest item at each time (n, k), `before` ahead of all."""
    # The first row is for the time before any item.
    rows = np.array([before, *(row_of(item.content) for item in items)], np.float64)
    item_times_s = [item.time_s for item in items]
    return rows[np.searchsorted(item_times_s, times_s, side="right")]


def _read_scene(items: list[TimedItem]) -> tuple[TrialScene | None, Floats]:
    """Return (first scene or None, final places of pushed cylinders (k, 2) [m])."""
    no_cylinders = np.empty((0, 2))
    if not items:
        return None, no_cylinders
    scene: TrialScene = items[0].content
    at_end = items[-1].content.cylinders_m
    if len(at_end) != len(scene.cylinders_m):
        return scene, no_cylinders
    dx, dy = (at_end - scene.cylinders_m).T
    return scene, at_end[np.hypot(dx, dy) > PUSHED_M]


def _find_lidar(items: ItemsByTopic, trial: dict[str, Any]) -> tuple[Pose2D, str]:
    """Return (lidar's pose in base_link, ""), or (origin, note) if it is unknown.

    The pose is from static transforms, or else from the trial's specification.
    """
    frames = {item.frame for item in items[topics.SCAN]}
    for frame in sorted(frames):
        lidar = decode.find_mount(items[topics.TF_STATIC], frame)
        if lidar is not None:
            return lidar, ""
    mount = decode.read_specification(trial, "lidar", "mount_x_m")
    if mount is not None:
        return Pose2D(mount[0], 0.0, 0.0), ""
    note = "no /tf_static with the lidar: it is assumed at base_link" if frames else ""
    return ORIGIN, note


def _find_recoveries(reports: list[TimedItem]) -> tuple[float, ...]:
    """Return times [s] at which the reported status changed to recovering.

    Empty reports are from other nodes and are skipped.
    """
    times_s = []
    status = ""
    for report in reports:
        if report.content == decode.RECOVERING and status != decode.RECOVERING:
            times_s.append(report.time_s)
        status = report.content or status
    return tuple(times_s)


def _read_motions(items: ItemsByTopic) -> tuple[RecordedMotions | None, str]:
    """Return (moving obstacles or None, why they cannot be drawn or "")."""
    places = {item.time_s: item.content for item in items[topics.MOVING_POSES]}
    if not places:
        return None, ""
    note = "moving obstacles are not drawn: "
    shapes = topics.MOVING.path
    if not items[topics.MOVING]:
        return None, f"{note}{shapes} with their shapes is missing"
    bodies, walls = items[topics.MOVING][0].content
    if {len(row) for row in places.values()} != {len(bodies.poses)}:
        poses = topics.MOVING_POSES.path
        return None, f"{note}{poses} and {shapes} differ in their number"
    times_s = np.array(list(places))
    return RecordedMotions(times_s, np.array(list(places.values())), bodies, walls), ""
