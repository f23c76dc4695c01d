"""What is read from a bag: the content of each type of message, and what the bag says of its trial."""

import math
from collections.abc import Callable
from typing import Any

from barn_eval.results.bags.bagfile import BagFile
from barn_planners.interface import PlannerStatus
from barn_sim.config import chassis_in
from barn_worlds.base.errors import ConfigError, MessageError
from barn_worlds.base.text_files import parse_json
from barn_worlds.base.types import OccupancyMap, Odometry, Pose2D, Scan
from barn_worlds.messages import decode, topics
from barn_worlds.messages.scenes import decode_moving, decode_moving_poses, decode_scene
from barn_worlds.messages.topics import Topic
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.cells import STANDARD_CELL_M

_MOST_CELLS = 1 << 24
_MOST_BEAMS = 100_000
_MOST_LETTERS = 60
RECOVERING = PlannerStatus.RECOVERING.value


def _odometry(data: bytes) -> Odometry:
    found = decode.odometry(data)
    _require_finite(
        found.velocity.linear, found.velocity.angular, *_numbers(found.pose)
    )
    return found


def _goal(data: bytes) -> Pose2D:
    found = decode.pose(data)
    _require_finite(*_numbers(found))
    return found


def _number(data: bytes) -> float:
    found = decode.number(data)
    _require_finite(found)
    return found


def _scan(data: bytes) -> Scan:
    found = decode.scan(data)
    if not 0 < len(found.ranges) <= _MOST_BEAMS:
        raise MessageError(f"a scan of {len(found.ranges)} beams")
    _require_finite(found.angle_min, found.angle_increment, found.range_min)
    return found


def _grid(data: bytes) -> OccupancyMap:
    found = decode.occupancy_map(data)
    if not 0 < found.data.size <= _MOST_CELLS or found.resolution <= 0.0:
        raise MessageError(f"a grid of {found.data.size} cells of {found.resolution} m")
    _require_finite(found.resolution, found.origin_x, found.origin_y)
    return found


def _mounts(data: bytes) -> dict[str, Pose2D]:
    found = {
        one.child: one.pose
        for one in decode.transforms(data)
        if one.parent.lstrip("/") == "base_link"
    }
    _require_finite(*(number for pose in found.values() for number in _numbers(pose)))
    return found


def _numbers(pose: Pose2D) -> tuple[float, float, float]:
    return pose.x, pose.y, pose.yaw


def _require_finite(*values: float) -> None:
    if not all(map(math.isfinite, values)):
        raise MessageError(f"values that are not finite: {values}")


def decode_planner_status(data: bytes) -> str:
    """Return the status that one of the suite's planners reports, an empty text for any other report."""
    try:
        return next(
            (
                values["status"]
                for values in decode.diagnostics(data)
                if "status" in values
            ),
            "",
        )
    except MessageError:
        return ""


Read = Callable[[bytes], Any]
_READ: tuple[tuple[Topic, Read], ...] = (
    (topics.GROUND_TRUTH, _odometry),
    (topics.ODOM, _odometry),
    (topics.SCAN, _scan),
    (topics.CMD_VEL, decode.twist),
    (topics.CMD_VEL_STAMPED, decode.twist_stamped),
    (topics.COLLISION, decode.boolean),
    (topics.MAP, _grid),
    (topics.GOAL_POSE, _goal),
    (topics.PLAN, decode.path),
    (topics.LOCAL_PLAN, decode.path),
    (topics.COSTMAP, _grid),
    (topics.BAND, decode.markers),
    (topics.CANDIDATES, decode.markers),
    (topics.SCORE, _number),
    (topics.OUTCOME, lambda data: decode.text(data)[:_MOST_LETTERS]),
    (topics.TF_STATIC, _mounts),
    (topics.WORLD, decode_scene),
    (topics.MOVING, decode_moving),
    (topics.MOVING_POSES, decode_moving_poses),
    (topics.DIAGNOSTICS, decode_planner_status),
)
# What is read of each topic, by the types that it may have.
TOPICS = {
    topic.path: {one.type_name: read for one, read in _READ if one.path == topic.path}
    for topic, _ in _READ
}
_IN_FRAME = {
    one.type_name
    for one in (topics.ODOM, topics.SCAN, topics.MAP, topics.GOAL_POSE, topics.PLAN)
}


def frame_and_content(topic: str, type_name: str, data: bytes) -> tuple[str, Any]:
    """Return what a message says, and in which frame, if it is of one; MessageError for what makes no sense."""
    content = TOPICS[topic][type_name](data)
    if isinstance(content, decode.Markers):
        return content.frame, content
    return decode.header(data).frame if type_name in _IN_FRAME else "", content


ORIGIN = Pose2D(0.0, 0.0, 0.0)


def map_frame(trial: dict[str, Any]) -> Pose2D:
    """Return where the planner's map frame lies among the true poses: localisation is off with the map by as much.

    A pose that is matched to the map by particles has no fixed offset; there the map is off by its one cell.
    """
    off = read_specification(trial, "localisation", "offset_x_m", "offset_y_m")
    if off is None:
        return ORIGIN
    matched = trial["simulator"]["localisation"].get("historical_map") is True
    return Pose2D(0.0 - off[0], (STANDARD_CELL_M if matched else 0.0) - off[1], 0.0)


def read_specification(
    trial: dict[str, Any], part: str, *names: str
) -> list[float] | None:
    """Return fields of a part of the simulator's configuration, None where they are not there as finite numbers."""
    try:
        values = [float(trial["simulator"][part][name]) for name in names]
    except (KeyError, TypeError, ValueError):
        return None
    return values if all(map(math.isfinite, values)) else None


def chassis_of(trial: dict[str, Any]) -> tuple[Chassis, str]:
    """Return the robot of a trial, the Jackal where none is named, and a note where it cannot be read."""
    try:
        return chassis_in(trial.get("simulator")), ""
    except ConfigError as error:
        return (
            STANDARD_ROBOT.chassis,
            f"drawn as a {STANDARD_ROBOT.name}, for its robot cannot be read: {error}",
        )


def metadata(bag: BagFile, name: str, key: str) -> dict[str, Any]:
    """Return a mapping that a bag has as JSON under a name and key; empty where it has none."""
    try:
        content = parse_json(bag.metadata.get(name, {}).get(key, "{}"), name)
    except ConfigError:
        return {}
    return content if isinstance(content, dict) else {}
