"""Decode a bag's messages by type, and read the trial that its metadata describe."""

import math
from collections.abc import Callable, Iterable
from typing import Any

from barn_eval.results.bags.bagfile import BagFile
from barn_planners.interface import PlannerStatus
from barn_sim.config import chassis_in
from barn_worlds.base.errors import ConfigError, MessageError
from barn_worlds.base.files import as_mapping, parse_json
from barn_worlds.base.types import ORIGIN, OccupancyMap, Odometry, Pose2D, Scan
from barn_worlds.messages import decode, topics
from barn_worlds.messages.scenes import decode_moving, decode_moving_poses, decode_scene
from barn_worlds.messages.topics import Topic
from barn_worlds.robots.files import STANDARD_ROBOT
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.cells import STANDARD_CELL_M

RECOVERING = PlannerStatus.RECOVERING.value
_MAX_CELLS = 1 << 24
_MAX_BEAMS = 100_000
_MAX_LETTERS = 60
_BASES = ("base_link", "base_footprint")  # of a robot, maybe with a prefix


def _odometry(data: bytes) -> Odometry:
    """Return the content of an Odometry message; MessageError if it is not finite."""
    odometry = decode.odometry(data)
    _require_finite(*odometry.velocity.numbers, *odometry.pose.numbers)
    return odometry


def _goal(data: bytes) -> Pose2D:
    """Return the pose in a PoseStamped message; MessageError if it is not finite."""
    goal = decode.pose(data)
    _require_finite(*goal.numbers)
    return goal


def _number(data: bytes) -> float:
    """Return the number of a Float64 message; MessageError if it is not finite."""
    number = decode.number(data)
    _require_finite(number)
    return number


def _scan(data: bytes) -> Scan:
    """Return a LaserScan; MessageError for 0 or too many beams, or infinite angles."""
    scan = decode.scan(data)
    if not 0 < len(scan.ranges) <= _MAX_BEAMS:
        raise MessageError(f"a scan of {len(scan.ranges)} beams")
    # Ranges may be infinite or NaN (REP-117), but no other number of a scan.
    _require_finite(scan.angle_min, scan.angle_increment, scan.range_min)
    return scan


def _grid(data: bytes) -> OccupancyMap:
    """Return an OccupancyGrid's map; MessageError if empty, too large or not finite."""
    grid = decode.occupancy_map(data)
    if not 0 < grid.data.size <= _MAX_CELLS or grid.resolution <= 0.0:
        raise MessageError(f"a grid of {grid.data.size} cells of {grid.resolution} m")
    _require_finite(grid.resolution, *grid.origin)
    return grid


Links = dict[str, tuple[str, Pose2D]]  # parent frame and pose in it, by frame


def read_links(data: bytes) -> Links:
    """Return the finite transforms of a TFMessage as links; MessageError if malformed."""
    links = {}
    for transform in decode.transforms(data):
        if all(map(math.isfinite, transform.pose.numbers)):
            # In ROS 1, names of frames began with a slash.
            link = (transform.parent.lstrip("/"), transform.pose)
            links[transform.child.lstrip("/")] = link
    return links


def find_mount(items: Iterable[Any], frame: str) -> Pose2D | None:
    """Return a frame's pose in base_link, None if no chain of links leads there.

    Args:
        items: Messages on /tf_static; the `content` of each is its links.
        frame: Frame of a sensor.
    """
    links: Links = {}
    for item in items:
        links |= item.content
    pose = ORIGIN
    frame = frame.lstrip("/")
    while frame.rpartition("/")[2] not in _BASES:
        if frame not in links:
            return None
        # Each link counts once: frames in a circle lead nowhere.
        frame, mount = links.pop(frame)
        pose = mount @ pose
    return pose


def _outcome(data: bytes) -> str:
    """Return the text of a String message, cut to 60 characters."""
    return decode.text(data)[:_MAX_LETTERS]


def _require_finite(*values: float) -> None:
    """Raise MessageError unless all values are finite."""
    if not all(map(math.isfinite, values)):
        raise MessageError(f"values that are not finite: {values}")


def decode_planner_status(data: bytes) -> str:
    """Return the planner's status in a DiagnosticArray, "" if none or unreadable."""
    try:
        # Any node may report here, so an unreadable message is no error.
        for values in decode.diagnostics(data):
            if "status" in values:
                return values["status"]
    except MessageError:
        pass
    return ""


READERS: tuple[tuple[Topic, Callable[[bytes], Any]], ...] = (
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
    (topics.OUTCOME, _outcome),
    (topics.TF_STATIC, read_links),
    (topics.WORLD, decode_scene),
    (topics.MOVING, decode_moving),
    (topics.MOVING_POSES, decode_moving_poses),
    (topics.DIAGNOSTICS, decode_planner_status),
)

# Reader of each topic by type: a topic may have several.
TOPICS: dict[str, dict[str, Callable[[bytes], Any]]] = {}
for _topic, _reader in READERS:
    TOPICS.setdefault(_topic.path, {})[_topic.type_name] = _reader

# Types whose content is in the frame of their header.
_FRAME_TYPES = {
    topic.type_name
    for topic in (topics.ODOM, topics.SCAN, topics.MAP, topics.GOAL_POSE, topics.PLAN)
}


def frame_and_content(topic: str, type_name: str, data: bytes) -> tuple[str, Any]:
    """Return (frame or "", content) of a CDR message; MessageError if implausible.

    Args:
        topic: One of `TOPICS`.
        type_name: One of the types that the topic may have.
        data: The message as recorded.

    Raises:
        MessageError: If the content is not plausible.
    """
    content = TOPICS[topic][type_name](data)
    if isinstance(content, decode.Markers):
        return content.frame, content
    if type_name in _FRAME_TYPES:
        return decode.header(data).frame, content
    return "", content


def map_frame(trial: dict[str, Any]) -> Pose2D:
    """Return the planner's map frame in the true one, the identity if unspecified.

    Map and localization of a trial may be shifted by this offset.
    """
    offset = read_specification(trial, "localisation", "offset_x_m", "offset_y_m")
    if offset is None:
        return ORIGIN
    # A pose that particles match to the map has no fixed offset, but the map is off by
    # one cell.
    is_matched = trial["simulator"]["localisation"].get("historical_map") is True
    map_y = STANDARD_CELL_M if is_matched else 0.0
    # A minus sign alone would turn 0.0 into -0.0.
    return Pose2D(0.0 - offset[0], map_y - offset[1], 0.0)


def read_specification(
    trial: dict[str, Any], part: str, *names: str
) -> list[float] | None:
    """Return values in a trial's simulator configuration; None unless all are finite.

    Args:
        trial: Specification of the trial, as its bag has it.
        part: Part of the configuration, such as "lidar".
        *names: Fields of that part.
    """
    try:
        values = [float(trial["simulator"][part][name]) for name in names]
    except (KeyError, TypeError, ValueError):
        return None
    return values if all(map(math.isfinite, values)) else None


def chassis_of(trial: dict[str, Any]) -> tuple[Chassis, str]:
    """Return (body of a trial's robot, ""), or (standard body, note) if unreadable.

    A trial that names no robot has the standard one.
    """
    try:
        return chassis_in(trial.get("simulator")), ""
    except ConfigError as error:
        name = STANDARD_ROBOT.name
        note = f"drawn as a {name}, because its robot cannot be read: {error}"
        return STANDARD_ROBOT.chassis, note


def metadata(bag: BagFile, name: str, key: str) -> dict[str, Any]:
    """Return a mapping from JSON text in a bag's metadata, {} if missing or invalid.

    Args:
        bag: The bag, read far enough to have its metadata.
        name: Name of the metadata.
        key: Key in the metadata.
    """
    try:
        return as_mapping(parse_json(bag.metadata[name][key], name))
    except (KeyError, ConfigError):
        return {}
