"""What a bag tells of a trial, as arrays on one time line."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from barn_eval.results.bags import BAGS, decode
from barn_eval.results.bags.bagfile import BagFile
from barn_eval.results.bags.decode import ORIGIN, TOPICS, metadata
from barn_eval.results.bags.messages import PUSHED_M
from barn_eval.results.bags.movers import RecordedMotions
from barn_eval.trials.trajectory import compute_clearances
from barn_worlds.base.arrays import Bools, Floats
from barn_worlds.base.errors import BagError, BarnError, format_error
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    OccupancyMap,
    Odometry,
    Pose2D,
    Velocity2D,
)
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.messages import topics
from barn_worlds.messages.topics import FRAMES
from barn_worlds.robots.contact import contact_footprint
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.scene import TrialScene

MAP, ODOM = FRAMES.map, FRAMES.odom
_ONCE = {topics.MOVING.path}  # of which the first message tells all that is wanted


class TimedItem(NamedTuple):
    """Something shown from a time on, in seconds from the first reading, in a frame of the bag."""

    time_s: float
    frame: str
    content: Any


@dataclass(frozen=True, eq=False)
class RecordedTrial:
    """A trial as its bag has it; times in seconds from the first pose, poses in the frame `frame`."""

    name: str  # of the bag
    folder: str  # of the results that it belongs to
    frame: str
    times_s: Floats  # (n,)
    poses: Floats  # (n, 3) m, rad
    speeds: Floats  # (n, 2) m/s, rad/s
    commands: Floats  # (n, 2), NaN where there was none by then
    contact: Bools  # (n,)
    odometry: Floats  # (n, 3) poses in the odom frame at the same times
    outline: Footprint  # of what of the robot can touch
    lidar: Pose2D  # where it is mounted
    scans: list[TimedItem] = field(metadata={"topic": topics.SCAN})
    plans: list[TimedItem] = field(metadata={"topic": topics.PLAN})  # points (k, 2)
    local_plans: list[TimedItem] = field(metadata={"topic": topics.LOCAL_PLAN})
    bands: list[TimedItem] = field(
        metadata={"topic": topics.BAND}
    )  # (k, 3) x, y, radius
    candidates: list[TimedItem] = field(
        metadata={"topic": topics.CANDIDATES}
    )  # lists of (k, 2)
    costmaps: list[TimedItem] = field(
        metadata={"topic": topics.COSTMAP}
    )  # OccupancyMap
    scores: list[TimedItem] = field(
        metadata={"topic": topics.SCORE}
    )  # the challenge metric so far
    outcomes: list[TimedItem] = field(
        metadata={"topic": topics.OUTCOME}
    )  # "running", then the outcome
    chassis: Chassis = STANDARD_ROBOT.chassis
    map_frame: Pose2D = ORIGIN  # where the frame of the planner's map and plan lies in that of the poses
    map: OccupancyMap | None = None  # moved there
    goal: TimedItem | None = None
    scene: TrialScene | None = None  # what truly stands there, None where nothing tells
    pushed_m: Floats = field(
        default_factory=lambda: np.empty((0, 2))
    )  # (k, 2) at the end, of pushed cylinders
    moving: RecordedMotions | None = None
    recoveries_s: tuple[float, ...] = ()  # when the planner began to recover
    trial: dict[str, Any] = field(default_factory=dict)
    result: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # what is missing or was cut off, in words

    def index_at(self, time_s: float) -> int:
        """Return the number of the last pose at or before a time."""
        return max(
            0, int(np.searchsorted(self.times_s, time_s + 1e-9, side="right")) - 1
        )

    def to_frame(self, shown: TimedItem) -> Pose2D:
        """Return the transform from the frame of something shown to that of the poses, at the time it was shown."""
        if shown.frame == self.frame:
            return self.map_frame if shown.frame == MAP else ORIGIN
        if shown.frame not in (MAP, ODOM) or not np.isfinite(self.odometry).all():
            return ORIGIN
        index = self.index_at(shown.time_s)
        true, believed = (
            Pose2D(*row[index].tolist()) for row in (self.poses, self.odometry)
        )
        odom_in_frame = true @ believed.inverse()
        return odom_in_frame if shown.frame == ODOM else odom_in_frame.inverse()

    @cached_property
    def clearance_m(self) -> Floats:
        """Distance (n,) from the robot's outline to the nearest obstacle, NaN if unknown.

        Cylinders are as they stood at the start, what moves is where it was at the time.
        """
        found = np.full(len(self.times_s), np.nan)
        if self.scene is not None and len(self.scene.cylinders_m):
            found = compute_clearances(
                self.poses, self.scene.cylinders_m, self.scene.radius_m, self.outline
            )
        if self.moving is not None:
            found = np.fmin(
                found, self.moving.gaps(self.times_s, self.poses, self.outline)
            )
        return found

    def goal_pose(self) -> Pose2D | None:
        """Return the goal among the poses, where it is judged: as it was first given, when all frames agreed best."""
        if self.scene is not None and self.scene.goal is not None:
            return self.scene.goal
        if self.goal is None:
            return None
        goal: Pose2D = self.goal.content
        return (
            goal
            if self.goal.frame == self.frame
            else self.to_frame(self.goal._replace(time_s=0.0)) @ goal
        )


def read_recorded_trial(path: Path) -> RecordedTrial:
    """Return what a bag tells of a trial; of one that is cut off or damaged, what comes before that."""
    bag = BagFile(path)
    unreadable: dict[str, str] = {}
    rows = _rows(bag, unreadable)
    true = bool(rows[topics.GROUND_TRUTH.path])
    poses = rows[(topics.GROUND_TRUTH if true else topics.ODOM).path]
    if not poses:
        there = (
            bag.problem
            or "; ".join(unreadable.values())
            or "it is another robot's, or no trial"
        )
        raise BagError(
            f"{path}: no poses of a robot on /ground_truth/odom or /odom ({there})"
        )
    times_s = np.array([row.time_s for row in poses])
    trial, result = (
        metadata(bag, "barn.trial", "specification"),
        metadata(bag, "barn.result", "result"),
    )
    maps, goals = rows[topics.MAP.path], rows[topics.GOAL_POSE.path]
    off = decode.map_frame(trial) if true and maps else ORIGIN
    scene, pushed_m = _scene(
        [row.content for row in rows[topics.WORLD.path]] if true else []
    )
    moving, moving_note = (
        _motions(rows[topics.MOVING.path], rows[topics.MOVING_POSES.path])
        if true
        else (None, "")
    )
    lidar, lidar_note = _lidar(rows, trial)
    chassis, robot_note = decode.chassis_of(trial)
    notes = [bag.problem, *unreadable.values(), moving_note, lidar_note, robot_note]
    notes.append(
        "" if true else "no /ground_truth/odom: positions are those of the odometry"
    )
    if off != ORIGIN:
        far = f"{math.hypot(off.x, off.y):.2f} m"
        notes.append(
            f"map and plan are drawn where the obstacles stand; the planner's map has them {far} away"
        )
    notes.append(
        ""
        if result
        else "the bag holds no result: its trial was not finished, or it is another's"
    )
    parent = bag.path.resolve().parent
    return RecordedTrial(
        name=bag.path.name,
        folder=parent.parent.name if parent.name == BAGS else parent.name,
        frame=MAP if true else ODOM,
        times_s=times_s,
        poses=np.array([_pose(row.content) for row in poses], np.float64),
        speeds=np.array([_speeds(row.content.velocity) for row in poses], np.float64),
        commands=_held(rows[topics.CMD_VEL.path], _speeds, times_s, (np.nan, np.nan)),
        contact=_held(
            rows[topics.COLLISION.path], lambda touched: (touched,), times_s, (0.0,)
        )[:, 0]
        > 0.0,
        odometry=_held(
            rows[topics.ODOM.path], _pose, times_s, (np.nan, np.nan, np.nan)
        ),
        outline=contact_footprint(chassis),
        chassis=chassis,
        lidar=lidar,
        map_frame=off,
        map=_moved(maps[-1].content, off) if maps else None,
        goal=goals[-1] if goals else None,
        scene=scene,
        pushed_m=pushed_m,
        moving=moving,
        recoveries_s=_recoveries(rows[topics.DIAGNOSTICS.path]),
        trial=trial,
        result=result,
        notes=tuple(filter(None, notes)),
        **{
            one.name: rows[one.metadata["topic"].path]
            for one in fields(RecordedTrial)
            if one.metadata
        },
    )


def _rows(bag: BagFile, unreadable: dict[str, str]) -> dict[str, list[TimedItem]]:
    """Return what topics show, in order of time from the first pose on, and note why topics show nothing."""
    found: dict[str, list[tuple[int, str, Any]]] = {path: [] for path in TOPICS}
    for message in bag.messages(TOPICS):
        topic = message.topic
        if message.type_name not in TOPICS[topic]:
            unreadable.setdefault(
                topic,
                f"{topic} is left out: its type is {message.type_name or 'unknown'}",
            )
        if topic in unreadable or (topic in _ONCE and found[topic]):
            continue
        try:
            said = decode.frame_and_content(topic, message.type_name, message.data)
        except BarnError as error:  # only its topic is lost
            unreadable[topic] = f"{topic} cannot be decoded ({format_error(error)})"
            continue
        found[topic].append((message.stamp_ns, *said))
    for rows in found.values():
        rows.sort(key=itemgetter(0))
    poses = found[topics.GROUND_TRUTH.path] or found[topics.ODOM.path]
    start_ns = poses[0][0] if poses else 0
    return {
        topic: [
            TimedItem((stamp_ns - start_ns) / NANOSECONDS_PER_SECOND, *said)
            for stamp_ns, *said in rows
        ]
        for topic, rows in found.items()
    }


def _held(
    rows: list[TimedItem],
    values_of: Callable[[Any], tuple[float, ...]],
    times_s: Floats,
    before: tuple[float, ...],
) -> Floats:
    """Return the last values of rows by each time, (n, k); `before` the first row those given."""
    values = np.array([before, *(values_of(row.content) for row in rows)], np.float64)
    return values[np.searchsorted([row.time_s for row in rows], times_s, side="right")]


def _scene(scenes: list[TrialScene]) -> tuple[TrialScene | None, Floats]:
    """Return the scene at the start, and where cylinders stand at the end that have been pushed."""
    if not scenes or len(scenes[-1].cylinders_m) != len(scenes[0].cylinders_m):
        return scenes[0] if scenes else None, np.empty((0, 2))
    at_end = scenes[-1].cylinders_m
    return scenes[0], at_end[np.hypot(*(at_end - scenes[0].cylinders_m).T) > PUSHED_M]


def _lidar(
    rows: Mapping[str, list[TimedItem]], trial: dict[str, Any]
) -> tuple[Pose2D, str]:
    """Return where the lidar is in base_link, by the static transforms or else by the trial's specification."""
    frames = {row.frame for row in rows[topics.SCAN.path]}
    mounts = (
        row.content[frame]
        for row in rows[topics.TF_STATIC.path]
        for frame in frames & set(row.content)
    )
    if (mount := next(mounts, None)) is not None:
        return mount, ""
    if (mounted := decode.read_specification(trial, "lidar", "mount_x_m")) is not None:
        return Pose2D(mounted[0], 0.0, 0.0), ""
    return (
        ORIGIN,
        "no /tf_static with the lidar: it is drawn at base_link" if frames else "",
    )


def _pose(odometry: Odometry) -> tuple[float, float, float]:
    return odometry.pose.x, odometry.pose.y, odometry.pose.yaw


def _speeds(velocity: Velocity2D) -> tuple[float, float]:
    return velocity.linear, velocity.angular


def _recoveries(reports: list[TimedItem]) -> tuple[float, ...]:
    """Return when a recovery began, by the planner's own reports; those of others are empty."""
    said = [one for one in reports if one.content]
    before = ["", *(one.content for one in said)]
    told = zip(said, before, strict=False)
    return tuple(
        one.time_s for one, last in told if one.content == decode.RECOVERING != last
    )


def _moved(grid: OccupancyMap, by: Pose2D) -> OccupancyMap:
    return replace(grid, origin_x=grid.origin_x + by.x, origin_y=grid.origin_y + by.y)


def _motions(
    shapes: list[TimedItem], rows: list[TimedItem]
) -> tuple[RecordedMotions | None, str]:
    """Return the obstacles of the first shapes (theirs and those of walls) at the places of rows, or why not."""
    places = {row.time_s: row.content for row in rows}
    if not places:
        return None, ""
    if not shapes:
        return (
            None,
            f"moving obstacles are not drawn: {topics.MOVING.path} with their shapes is missing",
        )
    bodies, walls = shapes[0].content
    if {len(row.content) for row in rows} != {len(bodies.poses)}:
        more = f"{topics.MOVING_POSES.path} has more or fewer of them than {topics.MOVING.path}"
        return None, f"moving obstacles are not drawn: {more}"
    return RecordedMotions(
        np.array(list(places)), np.array(list(places.values())), bodies, walls
    ), ""
