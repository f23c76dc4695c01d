"""What a bag tells of a trial, as arrays on one time line."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from barn_eval.bags import BAGS
from barn_eval.bags.bagfile import BagFile, RawMessage
from barn_eval.bags.decode import (
    ORIGIN,
    RECOVERING,
    TOPICS,
    chassis_of,
    frame_and_content,
    map_frame,
    metadata,
    specified,
)
from barn_eval.bags.messages import MOVED_M
from barn_eval.bags.movers import RecordedMotions
from barn_eval.trials.trajectory import clearances
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import BagError, BarnError, one_line
from barn_worlds.base.types import NANOSECONDS, OccupancyMap, Odometry, Pose2D, Velocity2D
from barn_worlds.geometry.bodies import Bodies
from barn_worlds.geometry.footprint import Footprint, contact_of
from barn_worlds.messages import topics
from barn_worlds.messages.topics import FRAMES, Topic
from barn_worlds.robots.files import STANDARD
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.scene import TrialScene

MAP, ODOM = FRAMES.map, FRAMES.odom
_ONCE = {topics.MOVING.path}  # of which the first message tells all that is wanted


class Shown(NamedTuple):
    """Something shown from a time on, in seconds from the first reading, in a frame of the bag."""

    time_s: float
    frame: str
    content: Any


@dataclass(frozen=True, eq=False)
class Recorded:
    """A trial as its bag has it; times in seconds from the first pose, poses in the frame `frame`.

    name, folder: of the bag, and of the results that it belongs to.

    times_s (n,); poses (n, 3) m, rad; speeds (n, 2) m/s, rad/s; commands (n, 2), NaN where there was none by then;
    contact (n,); odometry (n, 3) poses in the odom frame at the same times. scans: `Shown` scans; plans, local_plans:
    points (k, 2); bands: (k, 3) x, y, radius; candidates: lists of (k, 2); costmaps: OccupancyMap; scores: the
    challenge metric so far; outcomes: "running", then the outcome. chassis: of the robot; outline: of what of it can
    touch. lidar: where it is mounted. map_frame: where the frame of the planner's map and plan lies in that
    of the poses; `map` has been moved there. scene: what truly stands there, None where nothing tells; pushed_m:
    centres (k, 2) at the end of its cylinders that have been pushed. moving: obstacles that move, None without any.
    recoveries_s: when the planner began to recover. notes: what is missing or was cut off, in words.
    """

    name: str
    folder: str
    frame: str
    times_s: Floats
    poses: Floats
    speeds: Floats
    commands: Floats
    contact: npt.NDArray[np.bool_]
    odometry: Floats
    outline: Footprint
    lidar: Pose2D
    scans: list[Shown] = field(metadata={"topic": topics.SCAN})
    plans: list[Shown] = field(metadata={"topic": topics.PLAN})
    local_plans: list[Shown] = field(metadata={"topic": topics.LOCAL_PLAN})
    bands: list[Shown] = field(metadata={"topic": topics.BAND})
    candidates: list[Shown] = field(metadata={"topic": topics.CANDIDATES})
    costmaps: list[Shown] = field(metadata={"topic": topics.COSTMAP})
    scores: list[Shown] = field(metadata={"topic": topics.SCORE})
    outcomes: list[Shown] = field(metadata={"topic": topics.OUTCOME})
    chassis: Chassis = STANDARD.chassis
    map_frame: Pose2D = ORIGIN
    map: OccupancyMap | None = None
    goal: Shown | None = None
    scene: TrialScene | None = None
    pushed_m: Floats = field(default_factory=lambda: np.empty((0, 2)))
    moving: RecordedMotions | None = None
    recoveries_s: tuple[float, ...] = ()
    trial: dict[str, Any] = field(default_factory=dict)
    result: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def index_at(self, time_s: float) -> int:
        """Return the number of the last pose at or before a time."""
        return max(0, int(np.searchsorted(self.times_s, time_s + 1e-9, side="right")) - 1)

    def to_frame(self, shown: Shown) -> Pose2D:
        """Return the transform from the frame of something shown to that of the poses, at the time it was shown."""
        if shown.frame == self.frame:
            return self.map_frame if shown.frame == MAP else ORIGIN
        if shown.frame not in (MAP, ODOM) or not np.isfinite(self.odometry).all():
            return ORIGIN
        index = self.index_at(shown.time_s)
        true, believed = (Pose2D(*row[index].tolist()) for row in (self.poses, self.odometry))
        odom_in_frame = true @ believed.inverse()
        return odom_in_frame if shown.frame == ODOM else odom_in_frame.inverse()

    @cached_property
    def clearance_m(self) -> Floats:
        """Distance (n,) from the robot's outline to the nearest obstacle, NaN if unknown.

        Cylinders are as they stood at the start, what moves is where it was at the time.
        """
        found = np.full(len(self.times_s), np.nan)
        if self.scene is not None and len(self.scene.cylinders_m):
            found = clearances(self.poses, self.scene.cylinders_m, self.scene.radius_m, self.outline)
        if self.moving is not None:
            found = np.fmin(found, self.moving.gaps(self.times_s, self.poses, self.outline))
        return found

    def goal_pose(self) -> Pose2D | None:
        """Return the goal among the poses, where it is judged: as it was first given, when all frames agreed best."""
        if self.scene is not None and self.scene.goal is not None:
            return self.scene.goal
        if self.goal is None:
            return None
        goal: Pose2D = self.goal.content
        return goal if self.goal.frame == self.frame else self.to_frame(self.goal._replace(time_s=0.0)) @ goal


def read_recorded(path: Path) -> Recorded:
    """Return what a bag tells of a trial; of one that is cut off or damaged, what comes before that."""
    bag = BagFile(path)
    messages = _Messages()
    for message in bag.messages(TOPICS):
        messages.take(message)
    return messages.recorded(bag)


class _Row(NamedTuple):
    stamp_ns: int
    frame: str
    content: Any


class _Messages:
    def __init__(self) -> None:
        self._rows: dict[str, list[_Row]] = {path: [] for path in TOPICS}
        self._unreadable: dict[str, str] = {}

    def take(self, message: RawMessage) -> None:
        """Decode a message of a type that its topic should have."""
        if message.type_name not in TOPICS[message.topic]:
            known = message.type_name or "unknown"
            self._unreadable.setdefault(message.topic, f"{message.topic} is left out: its type is {known}")
        if message.topic in self._unreadable or (message.topic in _ONCE and self._rows[message.topic]):
            return
        try:
            frame, content = frame_and_content(message.topic, message.type_name, message.data)
        except BarnError as error:  # only its topic is lost
            self._unreadable[message.topic] = f"{message.topic} cannot be decoded ({one_line(error)})"
            return
        self._rows[message.topic].append(_Row(message.stamp_ns, frame, content))

    def recorded(self, bag: BagFile) -> Recorded:
        """Put the messages on one time line."""
        true = bool(self._rows[topics.GROUND_TRUTH.path])
        poses = self._all(topics.GROUND_TRUTH if true else topics.ODOM)
        if not poses:
            there = bag.problem or "; ".join(self._unreadable.values()) or "it is another robot's, or no trial"
            raise BagError(f"{bag.path}: no poses of a robot on /ground_truth/odom or /odom ({there})")
        stamps = np.array([row.stamp_ns for row in poses], np.int64)
        start_ns = int(stamps[0])

        def timed(topic: Topic) -> list[Shown]:
            return [Shown((row.stamp_ns - start_ns) / NANOSECONDS, row.frame, row.content) for row in self._all(topic)]

        shown: dict[str, Any] = {one.name: timed(one.metadata["topic"]) for one in fields(Recorded) if one.metadata}
        maps, goals = timed(topics.MAP), timed(topics.GOAL_POSE)
        result = metadata(bag, "barn.result", "result")
        trial = metadata(bag, "barn.trial", "specification")
        off = map_frame(trial) if true and maps else ORIGIN
        scene, pushed_m = self._scene() if true else (None, np.empty((0, 2)))
        shapes, places = self._all(topics.MOVING), timed(topics.MOVING_POSES)
        moving, moving_note = _motions(shapes[0].content if shapes else None, places) if true else (None, "")
        lidar, lidar_note = self._lidar(trial)
        chassis, robot_note = chassis_of(trial)
        notes = [bag.problem, *self._unreadable.values(), moving_note, lidar_note, robot_note]
        notes.append("" if true else "no /ground_truth/odom: positions are those of the odometry")
        if off != ORIGIN:
            far = f"{math.hypot(off.x, off.y):.2f} m"
            notes.append(f"map and plan are drawn where the obstacles stand; the planner's map has them {far} away")
        notes.append("" if result else "the bag holds no result: its trial was not finished, or it is another's")
        return Recorded(
            name=bag.path.name,
            folder=_folder(bag.path.resolve().parent),
            frame=MAP if true else ODOM,
            times_s=(stamps - start_ns) / NANOSECONDS,
            poses=np.array([_pose(row.content) for row in poses], np.float64),
            speeds=np.array([_speeds(row.content.velocity) for row in poses], np.float64),
            commands=self._held(topics.CMD_VEL, _speeds, stamps, (np.nan, np.nan)),
            contact=self._held(topics.COLLISION, lambda touched: (touched,), stamps, (0.0,))[:, 0] > 0.0,
            odometry=self._held(topics.ODOM, _pose, stamps, (np.nan, np.nan, np.nan)),
            outline=contact_of(chassis),
            chassis=chassis,
            lidar=lidar,
            map_frame=off,
            map=_moved(maps[-1].content, off) if maps else None,
            goal=goals[-1] if goals else None,
            scene=scene,
            pushed_m=pushed_m,
            moving=moving,
            recoveries_s=_recoveries(timed(topics.DIAGNOSTICS)),
            trial=trial,
            result=result,
            notes=tuple(filter(None, notes)),
            **shown,
        )

    def _all(self, topic: Topic) -> list[_Row]:
        return sorted(self._rows[topic.path], key=lambda row: row.stamp_ns)

    def _held(
        self,
        topic: Topic,
        values_of: Callable[[Any], tuple[float, ...]],
        stamps: npt.NDArray[np.int64],
        before: tuple[float, ...],
    ) -> Floats:
        """Return the last values of a topic by each time, (n, k); `before` the first message those given."""
        rows = self._all(topic)
        values = np.array([before, *(values_of(row.content) for row in rows)], np.float64)
        times = np.array([row.stamp_ns for row in rows], np.int64)
        return values[np.searchsorted(times, stamps, side="right")]

    def _scene(self) -> tuple[TrialScene | None, Floats]:
        """Return the scene at the start, and where cylinders stand at the end that have been pushed."""
        scenes: list[TrialScene] = [row.content for row in self._all(topics.WORLD)]
        first = scenes[0] if scenes else None
        if not scenes or len(scenes[-1].cylinders_m) != len(scenes[0].cylinders_m):
            return first, np.empty((0, 2))
        at_end = scenes[-1].cylinders_m
        return first, at_end[np.hypot(*(at_end - scenes[0].cylinders_m).T) > MOVED_M]

    def _lidar(self, trial: dict[str, Any]) -> tuple[Pose2D, str]:
        """Return where the lidar is in base_link, by the static transforms or else by the trial's specification."""
        frames = {row.frame for row in self._all(topics.SCAN)}
        for row in self._all(topics.TF_STATIC):
            for frame in frames & set(row.content):
                mount: Pose2D = row.content[frame]
                return mount, ""
        mounted = specified(trial, "lidar", "mount_x_m")
        if mounted is not None:
            return Pose2D(mounted[0], 0.0, 0.0), ""
        return ORIGIN, "no /tf_static with the lidar: it is drawn at base_link" if frames else ""


def _pose(odometry: Odometry) -> tuple[float, float, float]:
    return odometry.pose.x, odometry.pose.y, odometry.pose.yaw


def _speeds(velocity: Velocity2D) -> tuple[float, float]:
    return velocity.linear, velocity.angular


def _recoveries(reports: list[Shown]) -> tuple[float, ...]:
    """Return when a recovery began, by the planner's own reports; those of others are empty."""
    said = [one for one in reports if one.content]
    before = ["", *(one.content for one in said)]
    return tuple(one.time_s for one, last in zip(said, before, strict=False) if one.content == RECOVERING != last)


def _moved(grid: OccupancyMap, by: Pose2D) -> OccupancyMap:
    return replace(grid, origin_x=grid.origin_x + by.x, origin_y=grid.origin_y + by.y)


def _folder(parent: Path) -> str:
    return parent.parent.name if parent.name == BAGS else parent.name


def _motions(shapes: tuple[Bodies, Bodies] | None, rows: list[Shown]) -> tuple[RecordedMotions | None, str]:
    """Return the obstacles of shapes (theirs and those of walls) at the places of rows, or why they cannot be told."""
    if not rows:
        return None, ""
    if shapes is None:
        return None, f"moving obstacles are not drawn: {topics.MOVING.path} with their shapes is missing"
    places = {row.time_s: row.content for row in rows}
    if {len(row.content) for row in rows} != {len(shapes[0].poses)}:
        more = f"{topics.MOVING_POSES.path} has more or fewer of them than {topics.MOVING.path}"
        return None, f"moving obstacles are not drawn: {more}"
    return RecordedMotions(np.array(list(places)), np.array(list(places.values())), *shapes), ""
