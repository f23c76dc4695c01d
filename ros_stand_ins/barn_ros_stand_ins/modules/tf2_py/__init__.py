"""Transforms between frames over time, as tf2_py offers them."""

import bisect
import math
import threading
from dataclasses import dataclass

from builtin_interfaces.msg import Time as TimeMessage
from geometry_msgs.msg import TransformStamped
from rclpy.duration import Duration
from rclpy.logging import get_logger
from rclpy.time import Time

_CACHE_S = 10.0
_NORM_TOLERANCE = 1e-2
_LONGEST_CHAIN = 1000


class TransformException(Exception):
    """A transform that cannot be given."""


class ConnectivityException(TransformException):
    """Two frames are in different trees."""


class LookupException(TransformException):
    """A frame does not exist, or the tree has a loop."""


class ExtrapolationException(TransformException):
    """There is no data for the time."""


class InvalidArgumentException(TransformException):
    """A name is no name of a frame."""


class TimeoutException(TransformException):
    """A transform has not come in time."""


@dataclass(frozen=True)
class _Pose:
    """A frame in another: translation and quaternion x, y, z, w."""

    translation: tuple = (0.0, 0.0, 0.0)
    rotation: tuple = (0.0, 0.0, 0.0, 1.0)

    def __matmul__(self, inner):
        """Return a pose relative to this one in the frame of this one."""
        moved = rotate(self.rotation, inner.translation)
        translation = tuple(a + b for a, b in zip(self.translation, moved, strict=True))
        return _Pose(translation, multiply(self.rotation, inner.rotation))

    def inverse(self):
        """Return this pose's frame as seen the other way."""
        x, y, z, w = self.rotation
        rotation = (-x, -y, -z, w)
        moved = rotate(rotation, self.translation)
        return _Pose(tuple(-value for value in moved), rotation)


def multiply(a, b):
    """Return the product of two quaternions x, y, z, w."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2],
        a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


def rotate(rotation, vector):
    """Return a vector turned by a unit quaternion x, y, z, w."""
    x, y, z, w = rotation
    turned = multiply(multiply(rotation, (*vector, 0.0)), (-x, -y, -z, w))
    return turned[:3]


def slerp(a, b, ratio):
    """Return the quaternion at a ratio of the shorter way from a to b."""
    product = sum(p * q for p, q in zip(a, b, strict=True))
    if product < 0.0:
        b = tuple(-value for value in b)
    angle = math.acos(min(1.0, abs(product)))
    if angle < 1e-9:
        return a
    first = math.sin((1.0 - ratio) * angle) / math.sin(angle)
    second = math.sin(ratio * angle) / math.sin(angle)
    return tuple(first * p + second * q for p, q in zip(a, b, strict=True))


class _History:
    """Parents and poses of a frame by time, oldest first."""

    def __init__(self, length_ns):
        self._length_ns = length_ns
        self._stamps = []
        self._entries = []

    def add(self, stamp_ns, parent, pose):
        """Add an entry; return False if it is older than what is kept."""
        if self._stamps and stamp_ns < self._stamps[-1] - self._length_ns:
            return False
        place = bisect.bisect_right(self._stamps, stamp_ns)
        # What is published again replaces what came before with its stamp.
        if place and self._stamps[place - 1] == stamp_ns:
            self._entries[place - 1] = (parent, pose)
        else:
            self._stamps.insert(place, stamp_ns)
            self._entries.insert(place, (parent, pose))
        oldest = bisect.bisect_left(self._stamps, self._stamps[-1] - self._length_ns)
        del self._stamps[:oldest]
        del self._entries[:oldest]
        return True

    def latest(self):
        """Return the latest stamp and parent, or None."""
        if not self._stamps:
            return None
        return self._stamps[-1], self._entries[-1][0]

    def at(self, stamp_ns):
        """Return parent and pose at a time, 0 for the latest.

        Raises:
            ExtrapolationException: If the time is before or after what is kept.
        """
        stamps = self._stamps
        if stamps and stamp_ns == 0:
            return self._entries[-1]
        place = bisect.bisect_left(stamps, stamp_ns)
        if place < len(stamps) and stamps[place] == stamp_ns:
            return self._entries[place]
        if len(stamps) < 2:
            only = stamps[0] if stamps else 0
            raise ExtrapolationException(
                f"Lookup would require extrapolation at time {_seconds(stamp_ns)}, but"
                f" only time {_seconds(only)} is in the buffer"
            )
        for is_outside, where, kind, stamp in (
            (place == len(stamps), "future", "latest", stamps[-1]),
            (place == 0, "past", "earliest", stamps[0]),
        ):
            if is_outside:
                raise ExtrapolationException(
                    f"Lookup would require extrapolation into the {where}.  Requested"
                    f" time {_seconds(stamp_ns)} but the {kind} data is at time"
                    f" {_seconds(stamp)}"
                )
        parent, before = self._entries[place - 1]
        next_parent, after = self._entries[place]
        if parent != next_parent:
            return parent, before
        ratio = (stamp_ns - stamps[place - 1]) / (stamps[place] - stamps[place - 1])
        translation = tuple(
            a + ratio * (b - a)
            for a, b in zip(before.translation, after.translation, strict=True)
        )
        return parent, _Pose(translation, slerp(before.rotation, after.rotation, ratio))


class _Fixed:
    """Parent and pose of a frame that are the same at all times."""

    def add(self, _, parent, pose):
        """Replace the entry."""
        self._entry = (parent, pose)
        return True

    def latest(self):
        """Return the stamp 0, which stands for all times, and the parent."""
        return 0, self._entry[0]

    def at(self, _):
        """Return parent and pose."""
        return self._entry


class BufferCore:
    """The tree of frames, as far as it has been told."""

    def __init__(self, cache_time=None):
        """Keep transforms for a Duration, by default 10 s."""
        cache_time = cache_time or Duration(seconds=_CACHE_S)
        self._length_ns = cache_time.nanoseconds
        self._lock = threading.RLock()
        self._frames = set()
        self._caches = {}

    def clear(self):
        """Forget all transforms but the static ones."""
        with self._lock:
            for frame, cache in self._caches.items():
                if isinstance(cache, _History):
                    self._caches[frame] = _History(self._length_ns)

    def set_transform(self, transform, authority):
        """Add a TransformStamped; one that is invalid is logged and ignored."""
        self._set(transform, authority, is_static=False)

    def set_transform_static(self, transform, authority):
        """Add a TransformStamped that holds at all times."""
        self._set(transform, authority, is_static=True)

    def _set(self, transform, authority, is_static):
        parent = transform.header.frame_id.lstrip("/")
        child = transform.child_frame_id.lstrip("/")
        shift = transform.transform.translation
        turn = transform.transform.rotation
        pose = _Pose((shift.x, shift.y, shift.z), (turn.x, turn.y, turn.z, turn.w))
        norm = sum(value * value for value in pose.rotation)
        problem = ""
        if child == parent:
            problem = "TF_SELF_TRANSFORM: frame_id and child_frame_id are the same"
        elif not child:
            problem = "TF_NO_CHILD_FRAME_ID: child_frame_id is not set"
        elif not parent:
            problem = "TF_NO_FRAME_ID: frame_id is not set"
        elif any(map(math.isnan, pose.translation + pose.rotation)):
            problem = "TF_NAN_INPUT: a value is NaN"
        elif abs(norm - 1.0) >= _NORM_TOLERANCE:
            problem = "TF_DENORMALIZED_QUATERNION: the quaternion is no rotation"
        if not problem:
            with self._lock:
                self._frames |= {parent, child}
                kind = _Fixed if is_static else _History
                if not isinstance(self._caches.get(child), kind):
                    self._caches[child] = (
                        _Fixed() if is_static else _History(self._length_ns)
                    )
                stamp_ns = _nanoseconds(transform.header.stamp)
                if self._caches[child].add(stamp_ns, parent, pose):
                    return
            problem = "TF_OLD_DATA: it is older than what is kept"
        get_logger("tf2").error(
            f"{problem}: ignoring the transform of {child!r} from {authority!r}"
        )

    def lookup_transform_core(self, target_frame, source_frame, time):
        """Return the transform that takes data of the source frame to the target frame.

        Args:
            target_frame: Frame in which the data are wanted.
            source_frame: Frame in which they are.
            time: When; 0 for the latest time that all frames between have in common.

        Raises:
            TransformException: If it is not known.
        """
        with self._lock:
            self._require(target_frame, "lookupTransform argument target_frame")
            self._require(source_frame, "lookupTransform argument source_frame")
            stamp_ns = _nanoseconds(time)
            if target_frame == source_frame and stamp_ns == 0:
                cache = self._caches.get(source_frame)
                stamp_ns = ((cache and cache.latest()) or (0, ""))[0]
            elif stamp_ns == 0:
                stamp_ns = self._latest_common_ns(target_frame, source_frame)
            pose = self._pose(target_frame, source_frame, stamp_ns)
        return _message(target_frame, source_frame, stamp_ns, pose)

    def lookup_transform_full_core(
        self, target_frame, target_time, source_frame, source_time, fixed_frame
    ):
        """Return a transform between two times, by a frame that stands still between.

        Args:
            target_frame: Frame in which the data are wanted.
            target_time: When they are wanted there.
            source_frame: Frame in which they are.
            source_time: When they were there.
            fixed_frame: Frame that does not move between.
        """
        first = self.lookup_transform_core(fixed_frame, source_frame, source_time)
        second = self.lookup_transform_core(target_frame, fixed_frame, target_time)
        pose = _pose_of(second) @ _pose_of(first)
        stamp_ns = _nanoseconds(second.header.stamp)
        return _message(target_frame, source_frame, stamp_ns, pose)

    def can_transform_core(self, target_frame, source_frame, time):
        """Return whether a transform is known, and why not."""
        return _attempt(self.lookup_transform_core, target_frame, source_frame, time)

    def can_transform_full_core(
        self, target_frame, target_time, source_frame, source_time, fixed_frame
    ):
        """Return whether a transform between two times is known, and why not."""
        lookup = self.lookup_transform_full_core
        return _attempt(
            lookup, target_frame, target_time, source_frame, source_time, fixed_frame
        )

    def get_latest_common_time(self, target_frame, source_frame):
        """Return the latest Time for which the transform is known."""
        with self._lock:
            self._require(target_frame, "get_latest_common_time")
            self._require(source_frame, "get_latest_common_time")
            stamp_ns = self._latest_common_ns(target_frame, source_frame)
        return Time(nanoseconds=stamp_ns)

    def all_frames_as_yaml(self):
        """Return the frames with their parents as YAML."""
        lines = []
        for frame, cache in sorted(self._caches.items()):
            latest = cache.latest()
            if latest:
                lines.append(f"{frame}:\n  parent: '{latest[1]}'\n")
        return "".join(lines) or "{}"

    def all_frames_as_string(self):
        """Return the frames with their parents in sentences."""
        lines = []
        for frame, cache in sorted(self._caches.items()):
            latest = cache.latest()
            if latest:
                lines.append(f"Frame {frame} exists with parent {latest[1]}.\n")
        return "".join(lines)

    def _frameExists(self, frame):
        return frame in self._frames

    def _getFrameStrings(self):
        return sorted(self._frames)

    def _require(self, frame, what):
        """Raise InvalidArgumentException or LookupException unless it is a frame."""
        if not frame or frame.startswith("/"):
            rule = "start with a '/'" if frame else "be empty"
            raise InvalidArgumentException(
                f'Invalid argument "{frame}" passed to {what} - in tf2 frame_ids cannot'
                f" {rule}"
            )
        if frame not in self._frames:
            raise LookupException(f'"{frame}" passed to {what} does not exist. ')

    def _ancestors(self, frame):
        """Return the latest stamp and the parent of a frame, of its parent and so on."""
        chain = []
        while frame in self._caches and self._caches[frame].latest():
            chain.append(self._caches[frame].latest())
            frame = chain[-1][1]
            if len(chain) > _LONGEST_CHAIN:
                raise LookupException(
                    "The tf tree is invalid because it contains a loop."
                )
        return chain

    def _latest_common_ns(self, target, source):
        """Return the latest time of all frames between two, 0 if all are static."""
        source_chain = [(0, source), *self._ancestors(source)]
        target_chain = [(0, target), *self._ancestors(target)]
        source_frames = [frame for _, frame in source_chain]
        for end, (_, frame) in enumerate(target_chain, 1):
            if frame in source_frames:
                links = (
                    source_chain[: source_frames.index(frame) + 1] + target_chain[:end]
                )
                return min((stamp for stamp, _ in links if stamp), default=0)
        raise ConnectivityException(_unconnected(target, source))

    def _pose(self, target, source, stamp_ns):
        """Return the pose of the source frame in the target frame at a time."""
        source_poses, problem = self._climb(source, target, stamp_ns)
        target_poses, other_problem = self._climb(target, source, stamp_ns)
        for frame, pose in target_poses.items():
            if frame in source_poses:
                return pose.inverse() @ source_poses[frame]
        problem = other_problem or problem
        if problem is None:
            raise ConnectivityException(_unconnected(target, source))
        raise ExtrapolationException(
            f"{problem}, when looking up transform from frame [{source}] to frame"
            f" [{target}]"
        )

    def _climb(self, frame, end, stamp_ns):
        """Return the pose of a frame in each frame above it, and what ends that."""
        poses = {frame: _Pose()}
        pose = _Pose()
        while frame != end and frame in self._caches:
            try:
                frame, step = self._caches[frame].at(stamp_ns)
            except ExtrapolationException as error:
                return poses, error
            if frame in poses:
                raise LookupException(
                    "The tf tree is invalid because it contains a loop."
                )
            pose = step @ pose
            poses[frame] = pose
        return poses, None


def _attempt(lookup, *arguments):
    try:
        lookup(*arguments)
    except TransformException as error:
        return False, str(error)
    return True, ""


def _unconnected(target, source):
    return (
        f"Could not find a connection between '{target}' and '{source}' because they are"
        " not part of the same tree.Tf has two or more unconnected trees."
    )


def _nanoseconds(time):
    """Return nanoseconds of an rclpy Time or Duration, or of a message."""
    if isinstance(time, TimeMessage):
        return time.sec * 1_000_000_000 + time.nanosec
    return time.nanoseconds


def _seconds(nanoseconds):
    return f"{nanoseconds * 1e-9:.6f}"


def _pose_of(message):
    shift = message.transform.translation
    turn = message.transform.rotation
    return _Pose((shift.x, shift.y, shift.z), (turn.x, turn.y, turn.z, turn.w))


def _message(target, source, stamp_ns, pose):
    message = TransformStamped()
    message.header.frame_id = target
    message.header.stamp = Time(nanoseconds=stamp_ns).to_msg()
    message.child_frame_id = source
    shift = message.transform.translation
    shift.x, shift.y, shift.z = pose.translation
    turn = message.transform.rotation
    turn.x, turn.y, turn.z, turn.w = pose.rotation
    return message
