"""What a replay takes from each type of message: (frame, content). Raises BarnError for content that makes no sense."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from barn_planners.interface import PlannerStatus
from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import OccupancyMap, Odometry, Pose2D, Scan
from barn_worlds.messages import decode, topics
from barn_worlds.messages.moving import decode_moving, decode_moving_poses
from barn_worlds.messages.scene import decode_scene

_MOST_CELLS = 1 << 24
_MOST_BEAMS = 100_000
_MOST_LETTERS = 60
RECOVERING = PlannerStatus.RECOVERING.value


def _odometry(data: bytes) -> Odometry:
    odometry = decode.odometry(data)
    _finite(odometry.velocity.linear, odometry.velocity.angular, *_numbers(odometry.pose))
    return odometry


def _goal(data: bytes) -> Pose2D:
    goal = decode.pose(data)
    _finite(*_numbers(goal))
    return goal


def _number(data: bytes) -> float:
    value = decode.number(data)
    _finite(value)
    return value


def _scan(data: bytes) -> Scan:
    scan = decode.scan(data)
    if not 0 < len(scan.ranges) <= _MOST_BEAMS:
        raise MessageError(f"a scan of {len(scan.ranges)} beams")
    _finite(scan.angle_min, scan.angle_increment, scan.range_min)
    return scan


def _grid(data: bytes) -> OccupancyMap:
    grid = decode.occupancy_map(data)
    if not 0 < grid.data.size <= _MOST_CELLS:
        raise MessageError(f"a grid of {grid.data.size} cells")
    _finite(grid.resolution, grid.origin_x, grid.origin_y)
    if not grid.resolution > 0.0:
        raise MessageError(f"a grid with cells of {grid.resolution} m")
    return grid


def _mounts(data: bytes) -> dict[str, Pose2D]:
    mounts = {one.child: one.pose for one in decode.transforms(data) if one.parent.lstrip("/") == "base_link"}
    for mount in mounts.values():
        _finite(*_numbers(mount))
    return mounts


def _numbers(pose: Pose2D) -> tuple[float, float, float]:
    return pose.x, pose.y, pose.yaw


def _finite(*values: float) -> None:
    if not all(math.isfinite(value) for value in values):
        raise MessageError(f"values that are not finite: {values}")


def _in_frame(read: Callable[[bytes], Any]) -> Callable[[bytes], tuple[str, Any]]:
    return lambda data: (decode.header(data).frame, read(data))


def _plain(read: Callable[[bytes], Any]) -> Callable[[bytes], tuple[str, Any]]:
    return lambda data: ("", read(data))


def planner_status(data: bytes) -> str:
    """Return the status that one of the suite's planners reports, an empty text for any other report."""
    try:
        return next((values["status"] for values in decode.diagnostics(data) if "status" in values), "")
    except MessageError:
        return ""


def _markers(data: bytes) -> tuple[str, decode.Markers]:
    markers = decode.markers(data)
    return markers.frame, markers


DECODERS: Mapping[str, Callable[[bytes], tuple[str, Any]]] = {
    "nav_msgs/msg/Odometry": _in_frame(_odometry),
    "geometry_msgs/msg/PoseStamped": _in_frame(_goal),
    "geometry_msgs/msg/Twist": _plain(decode.twist),
    "geometry_msgs/msg/TwistStamped": _plain(decode.twist_stamped),
    "std_msgs/msg/Bool": _plain(decode.boolean),
    "std_msgs/msg/Float64": _plain(_number),
    "std_msgs/msg/String": _plain(lambda data: decode.text(data)[:_MOST_LETTERS]),
    "sensor_msgs/msg/LaserScan": _in_frame(_scan),
    "nav_msgs/msg/OccupancyGrid": _in_frame(_grid),
    "nav_msgs/msg/Path": _in_frame(decode.path),
    "visualization_msgs/msg/MarkerArray": _markers,
    "tf2_msgs/msg/TFMessage": _plain(_mounts),
    "diagnostic_msgs/msg/DiagnosticArray": _plain(planner_status),
}
# Topics whose messages are read otherwise than others of their type.
TOPIC_DECODERS: Mapping[str, Callable[[bytes], tuple[str, Any]]] = {
    topics.WORLD.path: lambda data: (topics.FRAMES.map, decode_scene(data)),
    topics.MOVING.path: lambda data: (topics.FRAMES.map, decode_moving(data)),
    topics.MOVING_POSES.path: lambda data: (topics.FRAMES.map, decode_moving_poses(data)),
}
