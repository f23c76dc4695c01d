"""Encodes the suite's types as serialized messages.

An encoder keeps the bytes of its last message and writes only what changes.
"""

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Generic, TypeVar

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    OccupancyMap,
    Odometry,
    Pose2D,
    Scan,
    Velocity2D,
    quaternion_from_yaw,
)
from barn_worlds.messages.cdr import (
    Layout,
    Message,
    Slot,
    Template,
    find_slots,
    make_message,
    serialize,
)

STAMP_FIELDS = ("header.stamp.sec", "header.stamp.nanosec")
FINE, WARNING, ERROR = range(3)  # levels of diagnostic_msgs/DiagnosticStatus
# Types and actions of visualization_msgs/Marker.
CUBE = 1
SPHERE = 2
CYLINDER = 3
LINE_STRIP = 4
LINE_LIST = 5
TEXT_VIEW_FACING = 9
ADD = 0
DELETE_ALL = 3
# Encapsulation of every message. Those without texts and lengths are packed at once.
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_POSE_BYTES = 56  # x, y, z of the position, x, y, z, w of the orientation
CLOCK_LAYOUT = Layout(_LITTLE_ENDIAN + bytes(8), [Slot(4, "i"), Slot(8, "I")])
BOOL_LAYOUT = Layout(_LITTLE_ENDIAN + bytes(1), [Slot(4, "?")])
T = TypeVar("T")


class Encoder(Generic[T]):
    """Encodes messages of one type with a header; texts and lengths never vary."""

    def __init__(
        self,
        type_name: str,
        frame: str,
        fields: Iterable[str],
        values: Callable[[T], Iterable[Any]],
        **constants: object,
    ):
        """Serialize a message once; `encode` writes stamp and `fields` into its bytes.

        Args:
            type_name: Type, such as "nav_msgs/msg/Odometry".
            frame: Frame of the header.
            fields: Dotted names of what varies beside the stamp.
            values: Returns the values of these fields for a content.
            constants: Values of further fields, which never vary.
        """
        message = make_message(type_name, header=make_header(frame), **constants)
        self.type_name = type_name
        self.layout = Template(message, [*STAMP_FIELDS, *fields])
        self._values = values

    def encode(self, content: T, stamp_ns: int) -> bytes:
        """Return the serialized message with the values of a content and a stamp.

        Args:
            content: Content of the message. A stamp in it is not used.
            stamp_ns: Stamp of the header.
        """
        return self.layout.fill(*self.row(content, stamp_ns))

    def row(self, content: T, stamp_ns: int) -> tuple[Any, ...]:
        """Return stamp (s, ns) and a content's values, in the order of `layout`."""
        return (*divmod(stamp_ns, NANOSECONDS_PER_SECOND), *self._values(content))


class OdometryEncoder(Encoder[Odometry]):
    """Encodes nav_msgs/Odometry."""

    def __init__(self, frame: str, child_frame: str):
        """Set the constant frames of pose (frame) and velocity (child frame)."""
        fields = _pose_fields("pose.pose")
        fields += ["twist.twist.linear.x", "twist.twist.angular.z"]
        super().__init__(
            "nav_msgs/msg/Odometry",
            frame,
            fields,
            lambda content: (*_pose_values(content.pose), *content.velocity.numbers),
            child_frame_id=child_frame,
        )


class PoseWithCovarianceEncoder(Encoder[Pose2D]):
    """Encodes geometry_msgs/PoseWithCovarianceStamped.

    Its variances of x, y (m2) and yaw (rad2) are fixed.
    """

    def __init__(self, frame: str, variances: Sequence[float] = (0.0, 0.0, 0.0)):
        """Set the constant frame, and variances of x, y (m2), yaw (rad2)."""
        pose = make_message("geometry_msgs/msg/PoseWithCovariance")
        # The diagonal of the 6 x 6 matrix of x, y, z, roll, pitch, yaw.
        pose.covariance[[0, 7, 35]] = variances
        super().__init__(
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            frame,
            _pose_fields("pose.pose"),
            _pose_values,
            pose=pose,
        )


class PoseStampedEncoder(Encoder[Pose2D]):
    """Encodes geometry_msgs/PoseStamped."""

    def __init__(self, frame: str):
        """Set the constant frame of the header."""
        fields = _pose_fields("pose")
        super().__init__("geometry_msgs/msg/PoseStamped", frame, fields, _pose_values)


class ScanEncoder(Encoder[Scan]):
    """Encodes sensor_msgs/LaserScan with the beams and limits of a first scan."""

    def __init__(self, first: Scan, frame: str, period_s: float):
        """Set constants: frame, scan time, and angles and limits of a first scan."""
        beams = len(first.ranges)
        super().__init__(
            "sensor_msgs/msg/LaserScan",
            frame,
            ["ranges"],
            lambda scan: (scan.ranges.tobytes(),),
            angle_min=first.angle_min,
            angle_max=first.angle_min + first.angle_increment * (beams - 1),
            angle_increment=first.angle_increment,
            scan_time=period_s,
            range_min=first.range_min,
            range_max=first.range_max,
            ranges=np.zeros(beams, np.float32),
        )


class TwistStampedEncoder(Encoder[Velocity2D]):
    """Encodes geometry_msgs/TwistStamped."""

    def __init__(self, frame: str):
        """Set the constant frame of the header."""
        super().__init__(
            "geometry_msgs/msg/TwistStamped",
            frame,
            ["twist.linear.x", "twist.angular.z"],
            lambda twist: twist.numbers,
        )


class JointEncoder(Encoder[tuple[Sequence[float], Sequence[float]]]):
    """Encodes sensor_msgs/JointState of a fixed list of joints.

    The content is positions (rad) and velocities (rad/s) in the order of the list.
    """

    def __init__(self, names: Sequence[str]):
        """Set the constant names of the joints; the header has no frame."""
        # Efforts stay empty: nobody measures them.
        zeros = np.zeros(len(names))
        pack = struct.Struct(f"<{len(names)}d").pack
        super().__init__(
            "sensor_msgs/msg/JointState",
            "",
            ["position", "velocity"],
            lambda columns: [pack(*column) for column in columns],
            name=list(names),
            position=zeros,
            velocity=zeros,
        )


class TransformEncoder:
    """Encodes tf2_msgs/TFMessage with a planar transform for each pair of frames."""

    type_name = "tf2_msgs/msg/TFMessage"

    def __init__(self, frames: Sequence[tuple[str, str]]):
        """Serialize a message once for fixed pairs of frames.

        Args:
            frames: Pairs of a frame and its child frame.
        """
        transforms = [_make_transform(frame, child) for frame, child in frames]
        varying = (
            *STAMP_FIELDS,
            "transform.translation.x",
            "transform.translation.y",
            "transform.rotation.z",
            "transform.rotation.w",
        )
        fields = []
        for index in range(len(frames)):
            fields += [f"transforms.{index}.{name}" for name in varying]
        message = make_message(self.type_name, transforms=transforms)
        self.layout = Template(message, fields)

    def encode(self, poses: Sequence[Pose2D], stamp_ns: int) -> bytes:
        """Return the serialized message with one planar pose per pair of frames.

        Args:
            poses: Pose of each child frame in its frame, in the order of the pairs.
            stamp_ns: Stamp of all transforms.
        """
        return self.layout.fill(*self.row(poses, stamp_ns))

    def row(self, poses: Sequence[Pose2D], stamp_ns: int) -> list[float]:
        """Return stamp (s, ns), x, y and quaternion z, w for each pose, one list."""
        stamp = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
        values: list[float] = []
        for pose in poses:
            values += stamp
            values += _pose_values(pose)
        return values


class PathEncoder:
    """Encodes nav_msgs/Path of any number of poses.

    Between the numbers of one pose and the next, all poses of a message have the same
    bytes. So the encoder repeats one row of bytes and writes the numbers into it.
    """

    type_name = "nav_msgs/msg/Path"

    def __init__(self, frame: str):
        """Prepare the bytes of a path and of one pose, both in the same frame."""
        pose = make_message("geometry_msgs/msg/PoseStamped", header=make_header(frame))
        pose.pose.orientation.w = 1.0
        empty = make_message(self.type_name, header=make_header(frame))
        sample = make_message(
            self.type_name, header=make_header(frame), poses=[pose, pose]
        )
        slots = find_slots(sample)
        data = serialize(sample)
        first = slots["poses.0.pose.position.x"].offset
        second = slots["poses.1.pose.position.x"].offset

        # An empty message ends with the number of poses.
        self._empty_bytes = len(serialize(empty))
        # The head ends before the numbers of the first pose. A row is these numbers
        # and the header of the next pose.
        self._head = bytearray(data[:first])
        self._row = bytearray(data[first:second])
        self._head_stamps = (
            slots["header.stamp.sec"].offset,
            slots["poses.0.header.stamp.sec"].offset,
        )
        self._row_stamp = slots["poses.1.header.stamp.sec"].offset - first

    def encode(self, points: Floats, stamp_ns: int) -> bytes:
        """Return the serialized path; points (n, 2) are not rotated, (n, 3) have yaw.

        Args:
            points: Positions (n, 2) in meters, or (n, 3) with yaw in radians.
            stamp_ns: Stamp of the path and of all poses.
        """
        count = len(points)
        stamp = struct.pack("<iI", *divmod(stamp_ns, NANOSECONDS_PER_SECOND))
        for offset in self._head_stamps:
            self._head[offset : offset + 8] = stamp
        struct.pack_into("<I", self._head, self._empty_bytes - 4, count)
        if not count:
            return bytes(self._head[: self._empty_bytes])

        self._row[self._row_stamp : self._row_stamp + 8] = stamp
        rows = np.tile(np.frombuffer(self._row, np.uint8), (count, 1))
        rows[:, :16] = np.ascontiguousarray(points[:, :2], np.float64).view(np.uint8)
        if points.shape[1] > 2:
            # z and w are the last two of the seven numbers of a pose.
            turns = np.array(list(map(quaternion_from_yaw, points[:, 2].tolist())))
            rows[:, 40:_POSE_BYTES] = turns.view(np.uint8)
        # No header follows the last pose.
        body = rows.tobytes()[: rows.size - len(self._row) + _POSE_BYTES]
        return bytes(self._head) + body


def encode_map(grid: OccupancyMap, stamp_ns: int, frame: str) -> bytes:
    """Return serialized nav_msgs/OccupancyGrid of a map or costmap.

    Args:
        grid: A map or a costmap.
        stamp_ns: Stamp of the header and of the map.
        frame: Frame of the origin of the grid.
    """
    cells = np.ascontiguousarray(grid.data, np.int8)
    stamp = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    layout = _grid_layout(*cells.shape, grid.resolution, frame)
    return layout.fill(*stamp, *stamp, *grid.origin, cells.tobytes())


# A planner's costmap keeps its size.
@lru_cache(maxsize=4)
def _grid_layout(rows: int, columns: int, resolution: float, frame: str) -> Template:
    """Return the template for grids of one size, resolution and frame; cached."""
    message = make_message(
        "nav_msgs/msg/OccupancyGrid",
        header=make_header(frame),
        data=np.zeros(rows * columns, np.int8),
    )
    info = message.info
    info.resolution = resolution
    info.height = rows
    info.width = columns
    info.origin.orientation.w = 1.0
    times = [f"info.map_load_time.{part}" for part in ("sec", "nanosec")]
    origin = [f"info.origin.position.{axis}" for axis in "xy"]
    return Template(message, [*STAMP_FIELDS, *times, *origin, "data"])


def encode_fixed_transforms(
    parent: str,
    children: Mapping[str, tuple[float, float, float]],
    yaws: Mapping[str, float],
) -> bytes:
    """Return serialized tf2_msgs/TFMessage of fixed frames, with stamp 0.

    Args:
        parent: Frame that the others are fixed in.
        children: Positions x, y, z in meters by name of the fixed frame.
        yaws: Rotations about z in radians of the frames that are turned, by name.
    """
    transforms = []
    for child, (x, y, z) in children.items():
        message = _make_transform(parent, child)
        position = make_message("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
        message.transform.translation = position
        _turn(message.transform.rotation, yaws.get(child, 0.0))
        transforms.append(message)
    return serialize(make_message(TransformEncoder.type_name, transforms=transforms))


def encode_diagnostics(
    stamp_ns: int,
    level: int,
    name: str,
    message: str,
    values: Mapping[str, str],
    hardware_id: str = "",
) -> bytes:
    """Return serialized diagnostic_msgs/DiagnosticArray with one status.

    Args:
        stamp_ns: Stamp of the header.
        level: `FINE`, `WARNING` or `ERROR`.
        name: Component that the status is about.
        message: State of the component in words.
        values: Further facts, by key.
        hardware_id: Identifier of a device, for hardware.
    """
    status = make_message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=name,
        message=message,
        hardware_id=hardware_id,
        values=[
            make_message("diagnostic_msgs/msg/KeyValue", key=key, value=value)
            for key, value in values.items()
        ],
    )
    diagnostics = make_message(
        "diagnostic_msgs/msg/DiagnosticArray",
        header=make_header("", stamp_ns),
        status=[status],
    )
    return serialize(diagnostics)


def encode_clock(stamp_ns: int) -> bytes:
    """Return serialized rosgraph_msgs/Clock of a time in ns."""
    return CLOCK_LAYOUT.fill(*divmod(stamp_ns, NANOSECONDS_PER_SECOND))


def encode_twist(velocity: Velocity2D) -> bytes:
    """Return serialized geometry_msgs/Twist of a velocity, without a header."""
    # x of the linear and z of the angular velocity; the four between them are zero.
    return _LITTLE_ENDIAN + struct.pack("<d32xd", *velocity.numbers)


def encode_bool(value: bool) -> bytes:
    """Return serialized std_msgs/Bool."""
    return BOOL_LAYOUT.fill(value)


def encode_text(text: str) -> bytes:
    """Return serialized std_msgs/String."""
    data = text.encode()
    return _LITTLE_ENDIAN + struct.pack("<I", len(data) + 1) + data + b"\0"


def encode_number(value: float) -> bytes:
    """Return serialized std_msgs/Float64."""
    return _LITTLE_ENDIAN + struct.pack("<d", value)


def make_header(frame: str, stamp_ns: int = 0) -> Message:
    """Return a std_msgs/Header object with a frame and a stamp in ns.

    Args:
        frame: Frame that the message refers to.
        stamp_ns: Time that it refers to.
    """
    message = make_message("std_msgs/msg/Header", frame_id=frame)
    set_stamp(message, stamp_ns)
    return message


def set_stamp(header: Message, stamp_ns: int) -> None:
    """Set the stamp of a std_msgs/Header object, in place, to a time in ns."""
    stamp = header.stamp
    stamp.sec, stamp.nanosec = divmod(stamp_ns, NANOSECONDS_PER_SECOND)


def make_marker(
    frame: str,
    namespace: str,
    kind: int = 0,
    *,
    index: int = 0,
    action: int = ADD,
    color: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    stamp_ns: int = 0,
) -> Message:
    """Return a visualization_msgs/Marker object at the origin; its scale is still zero.

    Args:
        frame: Frame of its pose and points.
        namespace: Group of markers that it belongs to.
        kind: Shape, such as `CYLINDER`.
        index: Number in its namespace. A later marker with it takes its place.
        action: `ADD` or `DELETE_ALL`.
        color: Red, green, blue and opacity, from 0 to 1.
        stamp_ns: Stamp of the header.
    """
    message = make_message(
        "visualization_msgs/msg/Marker",
        header=make_header(frame, stamp_ns),
        ns=namespace,
        id=index,
        type=kind,
        action=action,
        color=make_message(
            "std_msgs/msg/ColorRGBA", **dict(zip("rgba", color, strict=True))
        ),
    )
    message.pose.orientation.w = 1.0
    return message


def place(pose: Message, x: float, y: float, yaw: float) -> None:
    """Set x, y and yaw of a geometry_msgs/Pose object in place; its z stays.

    Args:
        pose: Message that is changed.
        x: Position in meters.
        y: Position in meters.
        yaw: Rotation about z in radians.
    """
    pose.position.x = x
    pose.position.y = y
    _turn(pose.orientation, yaw)


def _turn(quaternion: Message, yaw: float) -> None:
    """Set z and w of a quaternion object, in place, to a rotation about z in rad."""
    quaternion.z, quaternion.w = quaternion_from_yaw(yaw)


def _make_transform(frame: str, child_frame: str) -> Message:
    """Return a TransformStamped object between two frames, its numbers still zero."""
    return make_message(
        "geometry_msgs/msg/TransformStamped",
        header=make_header(frame),
        child_frame_id=child_frame,
    )


def _pose_fields(pose: str) -> list[str]:
    """Return dotted names of x, y and quaternion z, w in message field `pose`."""
    parts = ("position.x", "position.y", "orientation.z", "orientation.w")
    return [f"{pose}.{part}" for part in parts]


def _pose_values(pose: Pose2D) -> tuple[float, float, float, float]:
    """Return x, y and z, w of the quaternion of a pose, ordered as `_pose_fields`."""
    return (*pose.position, *quaternion_from_yaw(pose.yaw))
