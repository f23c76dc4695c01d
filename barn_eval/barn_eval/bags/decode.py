"""What is taken from each type of message: (frame, content). Raises ValueError for content that makes no sense."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from barn_worlds.types import OccupancyMap, Pose2D, Scan, yaw_from_quaternion

_MOST_CELLS = 1 << 24
_MOST_BEAMS = 100_000
_MOST_LETTERS = 60
_LINE_STRIP, _LINE_LIST, _CYLINDER, _SPHERE = 4, 5, 3, 2


class PoseTwist(NamedTuple):
    """A pose (x, y m, yaw rad) and the velocity (m/s, rad/s) of an odometry message."""

    pose: tuple[float, float, float]
    twist: tuple[float, float]


class Markers(NamedTuple):
    """The discs (k, 3) x, y, radius and the lines, each (n, 2), of a marker array."""

    discs: Any
    lines: list[Any]


def _odometry(message: Any) -> tuple[str, Any]:
    twist = message.twist.twist
    return message.header.frame_id, PoseTwist(
        _finite(*_pose(message.pose.pose)), _finite(twist.linear.x, twist.angular.z)
    )


def _goal(message: Any) -> tuple[str, Any]:
    return message.header.frame_id, Pose2D(*_finite(*_pose(message.pose)))


def _twist(message: Any) -> tuple[str, Any]:
    return "", (message.linear.x, message.angular.z)


def _twist_stamped(message: Any) -> tuple[str, Any]:
    return _twist(message.twist)


def _bool(message: Any) -> tuple[str, Any]:
    return "", (float(message.data),)


def _number(message: Any) -> tuple[str, Any]:
    return "", _finite(message.data)[0]


def _word(message: Any) -> tuple[str, Any]:
    return "", message.data[:_MOST_LETTERS]


def _scan(message: Any) -> tuple[str, Any]:
    if not 0 < len(message.ranges) <= _MOST_BEAMS:
        raise ValueError(f"a scan of {len(message.ranges)} beams")
    first, step, nearest = _finite(message.angle_min, message.angle_increment, message.range_min)
    return message.header.frame_id, Scan(
        0, np.asarray(message.ranges, np.float32), first, step, nearest, message.range_max
    )


def _grid(message: Any) -> tuple[str, Any]:
    info = message.info
    if not 0 < info.width * info.height <= _MOST_CELLS or len(message.data) != info.width * info.height:
        raise ValueError(f"a grid of {info.width} x {info.height} cells with {len(message.data)} values")
    origin = info.origin
    if abs(_pose(origin)[2]) > 1e-6:
        raise ValueError("a grid that is turned")
    data = np.asarray(message.data, np.int8).reshape(info.height, info.width)
    resolution, x, y = _finite(info.resolution, origin.position.x, origin.position.y)
    if not resolution > 0.0:
        raise ValueError(f"a grid with cells of {resolution} m")
    return message.header.frame_id, OccupancyMap(data, resolution, x, y)


def _path(message: Any) -> tuple[str, Any]:
    points = [(item.pose.position.x, item.pose.position.y) for item in message.poses]
    return message.header.frame_id, np.array(points, np.float64).reshape(-1, 2)


def _markers(message: Any) -> tuple[str, Any]:
    discs, lines, frame = [], [], ""
    for marker in message.markers:
        frame = frame or marker.header.frame_id
        where = Pose2D(*_pose(marker.pose))
        if marker.type in (_CYLINDER, _SPHERE) and marker.action == 0:
            discs.append((where.x, where.y, 0.5 * marker.scale.x))
        elif marker.type in (_LINE_STRIP, _LINE_LIST) and marker.action == 0 and marker.points:
            points = where.transform(np.array([(point.x, point.y) for point in marker.points], np.float64))
            lines += [points] if marker.type == _LINE_STRIP else list(points[: len(points) // 2 * 2].reshape(-1, 2, 2))
    return frame, Markers(np.array(discs, np.float64).reshape(-1, 3), lines)


def _transforms(message: Any) -> tuple[str, Any]:
    found = {}
    for item in message.transforms:
        if item.header.frame_id.lstrip("/") == "base_link":
            move = item.transform
            yaw = yaw_from_quaternion(move.rotation.x, move.rotation.y, move.rotation.z, move.rotation.w)
            found[item.child_frame_id] = Pose2D(*_finite(move.translation.x, move.translation.y, yaw))
    return "", found


def _pose(pose: Any) -> tuple[float, float, float]:
    turn = pose.orientation
    return pose.position.x, pose.position.y, yaw_from_quaternion(turn.x, turn.y, turn.z, turn.w)


def _finite(*values: float) -> Any:
    if not all(math.isfinite(value) for value in values):
        raise ValueError(f"numbers that are none: {values}")
    return values


DECODERS: Mapping[str, Callable[[Any], tuple[str, Any]]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _goal,
    "geometry_msgs/msg/Twist": _twist,
    "geometry_msgs/msg/TwistStamped": _twist_stamped,
    "std_msgs/msg/Bool": _bool,
    "std_msgs/msg/Float64": _number,
    "std_msgs/msg/String": _word,
    "sensor_msgs/msg/LaserScan": _scan,
    "nav_msgs/msg/OccupancyGrid": _grid,
    "nav_msgs/msg/Path": _path,
    "visualization_msgs/msg/MarkerArray": _markers,
    "tf2_msgs/msg/TFMessage": _transforms,
}
