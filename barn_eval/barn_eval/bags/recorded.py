"""What a bag tells of a trial, as arrays on one time line."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from barn_eval.bags import decode
from barn_eval.bags.bagfile import BagFile, RawMessage, one_line
from barn_eval.bags.messages import deserialise
from barn_sim.model import jackal
from barn_worlds.errors import BagError
from barn_worlds.types import NANOSECONDS, OccupancyMap, Pose2D

Floats = npt.NDArray[np.float64]

MAP, ODOM = "map", "odom"
ORIGIN = Pose2D(0.0, 0.0, 0.0)
_ODOMETRY = ("nav_msgs/msg/Odometry",)
_PATH = ("nav_msgs/msg/Path",)
_GRID = ("nav_msgs/msg/OccupancyGrid",)
_MARKERS = ("visualization_msgs/msg/MarkerArray",)
# What is read, and the types that it may have.
TOPICS: dict[str, tuple[str, ...]] = {
    "/ground_truth/odom": _ODOMETRY,
    "/odom": _ODOMETRY,
    "/scan": ("sensor_msgs/msg/LaserScan",),
    "/cmd_vel": ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    "/collision": ("std_msgs/msg/Bool",),
    "/map": _GRID,
    "/goal_pose": ("geometry_msgs/msg/PoseStamped",),
    "/plan": _PATH,
    "/local_plan": _PATH,
    "/local_costmap/costmap": _GRID,
    "/band": _MARKERS,
    "/candidates": _MARKERS,
    "/score": ("std_msgs/msg/Float64",),
    "/outcome": ("std_msgs/msg/String",),
    "/tf_static": ("tf2_msgs/msg/TFMessage",),
}


class Shown(NamedTuple):
    """Something shown from a time on, in seconds from the first reading, in a frame of the bag."""

    time_s: float
    frame: str
    content: Any


@dataclass(frozen=True, eq=False)
class Recorded:
    """A trial as its bag has it; times in seconds from the first pose, poses in the frame `frame`.

    times_s (n,); poses (n, 3) m, rad; speeds (n, 2) m/s, rad/s; commands (n, 2), NaN where there was none by then;
    contact (n,); odometry (n, 3) poses in the odom frame at the same times. scans: `Shown` scans; plans, local_plans:
    points (k, 2); bands: (k, 3) x, y, radius; candidates: lists of (k, 2); costmaps: OccupancyMap; scores: the
    challenge metric so far; outcomes: "running", then the outcome. extent: x_min, y_min, x_max, y_max of the robot in
    base_link, metres. lidar: where it is mounted. map_frame: where the frame of the planner's map and plan lies in that
    of the poses; `map` has been moved there. notes: what is missing or was cut off, in words.
    """

    name: str
    frame: str
    times_s: Floats
    poses: Floats
    speeds: Floats
    commands: Floats
    contact: npt.NDArray[np.bool_]
    odometry: Floats
    extent: Floats
    lidar: Pose2D
    map_frame: Pose2D = ORIGIN
    map: OccupancyMap | None = None
    goal: Shown | None = None
    scans: list[Shown] = field(default_factory=list)
    plans: list[Shown] = field(default_factory=list)
    local_plans: list[Shown] = field(default_factory=list)
    bands: list[Shown] = field(default_factory=list)
    candidates: list[Shown] = field(default_factory=list)
    costmaps: list[Shown] = field(default_factory=list)
    scores: list[Shown] = field(default_factory=list)
    outcomes: list[Shown] = field(default_factory=list)
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

    def goal_pose(self) -> Pose2D | None:
        """Return the goal among the poses, where it is judged: as it was first given, when all frames agreed best."""
        if self.goal is None:
            return None
        goal: Pose2D = self.goal.content
        return goal if self.goal.frame == self.frame else self.to_frame(self.goal._replace(time_s=0.0)) @ goal


def read_recorded(path: Path) -> Recorded:
    """Return what a bag tells of a trial; of one that is cut off or damaged, what comes before that.

    Raises BagError in one line for what is no bag, or has no poses of a robot in it.
    """
    bag = BagFile(path)
    heap = _Heap()
    for message in bag.messages(TOPICS):
        heap.take(message)
    return heap.recorded(bag)


class _Heap:
    """Messages of a bag, decoded and sorted by topic."""

    def __init__(self) -> None:
        self.rows: dict[str, list[Shown]] = {topic: [] for topic in TOPICS}
        self.unreadable: dict[str, str] = {}

    def take(self, message: RawMessage) -> None:
        """Decode a message of a type that its topic should have."""
        if message.type_name not in TOPICS[message.topic]:
            known = message.type_name or "unknown"
            self.unreadable.setdefault(message.topic, f"{message.topic} is left out: its type is {known}")
        if message.topic in self.unreadable:
            return
        try:
            frame, content = decode.DECODERS[message.type_name](deserialise(message.data, message.type_name))
        except Exception as error:  # whatever a foreign message does to the decoder, only its topic is lost
            self.unreadable[message.topic] = f"{message.topic} cannot be decoded ({one_line(error)})"
            return
        self.rows[message.topic].append(Shown(message.stamp_ns / NANOSECONDS, frame, (message.stamp_ns, content)))

    def recorded(self, bag: BagFile) -> Recorded:
        """Put the messages on one time line."""
        source = next((topic for topic in ("/ground_truth/odom", "/odom") if self.rows[topic]), "")
        if not source:
            there = bag.problem or "; ".join(self.unreadable.values()) or "it is another robot's, or no trial"
            raise BagError(f"{bag.path}: no poses of a robot on /ground_truth/odom or /odom ({there})")
        poses = self._all(source)
        stamps = np.array([stamp for stamp, _, _ in poses], np.int64)
        start_ns = int(stamps[0])
        timed = {
            topic: [
                Shown((stamp - start_ns) / NANOSECONDS, frame, content) for stamp, frame, content in self._all(topic)
            ]
            for topic in TOPICS
        }
        result = _metadata(bag, "barn.result", "result")
        trial = _metadata(bag, "barn.trial", "specification")
        map_frame = _map_frame(trial) if source == "/ground_truth/odom" and timed["/map"] else ORIGIN
        lidar, lidar_note = self._lidar(trial)
        notes = [bag.problem, *self.unreadable.values(), lidar_note]
        notes.append("" if source != "/odom" else "no /ground_truth/odom: positions are those of the odometry")
        if map_frame != ORIGIN:
            far = f"{math.hypot(map_frame.x, map_frame.y):.2f} m"
            notes.append(f"map and plan are drawn where the obstacles stand; the planner's map has them {far} away")
        notes.append("" if result else "the bag holds no result: its trial was not finished, or it is another's")
        return Recorded(
            name=bag.path.name,
            frame=MAP if source == "/ground_truth/odom" else ODOM,
            times_s=(stamps - start_ns) / NANOSECONDS,
            poses=np.array([content.pose for _, _, content in poses], np.float64),
            speeds=np.array([content.twist for _, _, content in poses], np.float64),
            commands=_held(stamps, self._all("/cmd_vel"), np.nan, 2),
            contact=_held(stamps, self._all("/collision"), 0.0, 1)[:, 0] > 0.0,
            odometry=_held(stamps, [(s, f, c.pose) for s, f, c in self._all("/odom")], np.nan, 3),
            extent=jackal().extent(),
            lidar=lidar,
            map_frame=map_frame,
            map=_moved(timed["/map"][-1].content, map_frame) if timed["/map"] else None,
            goal=timed["/goal_pose"][-1] if timed["/goal_pose"] else None,
            scans=timed["/scan"],
            plans=timed["/plan"],
            local_plans=timed["/local_plan"],
            bands=timed["/band"],
            candidates=timed["/candidates"],
            costmaps=timed["/local_costmap/costmap"],
            scores=timed["/score"],
            outcomes=timed["/outcome"],
            trial=trial,
            result=result,
            notes=tuple(note for note in notes if note),
        )

    def _all(self, topic: str) -> list[tuple[int, str, Any]]:
        rows = [(shown.content[0], shown.frame, shown.content[1]) for shown in self.rows[topic]]
        return sorted(rows, key=lambda row: row[0])

    def _lidar(self, trial: dict[str, Any]) -> tuple[Pose2D, str]:
        """Return where the lidar is in base_link, by the static transforms or else by the trial's specification."""
        frames = {frame for _, frame, _ in self._all("/scan")}
        for _, _, transforms in self._all("/tf_static"):
            for frame in frames & set(transforms):
                mount: Pose2D = transforms[frame]
                return mount, ""
        specified = _specified(trial, "lidar", "mount_x_m")
        if specified is not None:
            return Pose2D(specified[0], 0.0, 0.0), ""
        return ORIGIN, "no /tf_static with the lidar: it is drawn at base_link" if frames else ""


def _held(stamps: npt.NDArray[np.int64], rows: list[tuple[int, str, Any]], empty: float, width: int) -> Floats:
    """Return the last of the values by each time, (n, width)."""
    values = np.array([[empty] * width, *(content for _, _, content in rows)], np.float64)
    times = np.array([stamp for stamp, _, _ in rows], np.int64)
    return values[np.searchsorted(times, stamps, side="right")]


def _moved(grid: OccupancyMap, by: Pose2D) -> OccupancyMap:
    return replace(grid, origin_x=grid.origin_x + by.x, origin_y=grid.origin_y + by.y)


def _map_frame(trial: dict[str, Any]) -> Pose2D:
    """Return where the planner's map frame lies among the true poses: localisation is off with the map by as much."""
    off = _specified(trial, "localisation", "offset_x_m", "offset_y_m")
    return ORIGIN if off is None else Pose2D(0.0 - off[0], 0.0 - off[1], 0.0)


def _specified(trial: dict[str, Any], part: str, *names: str) -> list[float] | None:
    """Return fields of a part of the simulator's configuration, None where they are not there as finite numbers."""
    try:
        values = [float(trial["simulator"][part][name]) for name in names]
    except (KeyError, TypeError, ValueError):
        return None
    return values if all(map(math.isfinite, values)) else None


def _metadata(bag: BagFile, name: str, key: str) -> dict[str, Any]:
    try:
        content = json.loads(bag.metadata.get(name, {}).get(key, "{}"))
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}
