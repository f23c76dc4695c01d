"""Find the topics of any bag that have poses, scans, commands and goals."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

from barn_eval.results.bags.bagfile import BagFile, RawMessage
from barn_eval.trials.system import NO_CONTACT
from barn_worlds.base.errors import (
    BagError,
    ConfigError,
    MessageError,
    format_error,
    format_value,
)
from barn_worlds.base.types import ORIGIN, Odometry, Pose2D, Velocity2D
from barn_worlds.messages import decode, topics

NO_TWIST = Velocity2D(math.nan, math.nan)
_TF = "/tf:"
_ODOMETRY = topics.ODOM.type_name
_POSE = topics.GOAL_POSE.type_name
# Frames that are the world's.
FIXED_FRAMES = (topics.FRAMES.map, "world")
_POSE_TYPES = (_ODOMETRY, topics.AMCL_POSE.type_name, _POSE)
_TRUTH = topics.GROUND_TRUTH.path

# Topics that may have any name if they are the only ones of their type.
_BY_TYPE = (topics.ODOM, topics.SCAN, topics.CMD_VEL, topics.CMD_VEL_STAMPED)


@dataclass(frozen=True)
class Sources:
    """Topics of a bag that stand for the suite's, as named by a user; "" if not named."""

    pose: str = ""  # topic, or frames of tf such as "/tf:odom.base_link"
    goal: str = ""
    contact: str = ""
    namespace: str = ""  # in front of all names

    def __post_init__(self) -> None:
        """Raise ConfigError unless frames of tf, if named, are a chain of names."""
        if self.pose.startswith(_TF) and not all(self.frames[1:]):
            raise ConfigError(
                f"pose {format_value(self.pose)}: must be a topic, or frames of tf, such"
                f" as {_TF}odom.base_link"
            )

    @property
    def frames(self) -> list[str]:
        """Frames of tf from the fixed one to the robot's, [] for poses from a topic."""
        if not self.pose.startswith(_TF):
            return []
        frames = self.pose.removeprefix(_TF).split(".")
        return frames if len(frames) > 1 else [*frames, ""]


NO_SOURCES = Sources()


class TopicChoice:
    """Which of the suite's topics each topic of a bag stands for.

    Attributes:
        sources: Topics named by the user, with the namespace that was found.
        paths: Path of the suite's topic by the bag's topic.
        other_goals: Other topics that may have goals, as text.
    """

    def __init__(self, bag: BagFile, sources: Sources):
        """Choose topics by the user's names, the suite's, or type; BagError if missing.

        Args:
            bag: The bag, which is read to its end.
            sources: Topics named by the user.

        Raises:
            BagError: If what is named is missing, or several namespaces have odometry.
        """
        self._bag = bag
        namespace = sources.namespace.rstrip("/") or self._find_namespace()
        self.sources = replace(sources, namespace=namespace)
        self.paths: dict[str, str] = {}

        self._add_named()
        for topic in vars(topics).values():
            if isinstance(topic, topics.Topic):
                self._add(topic, f"{namespace}{topic.path}")
                self._add(topic, topic.path)
        for topic in _BY_TYPE:
            self._add(topic, *self._of_type(topic.type_name))
        goals = [name for name in self._of_type(_POSE) if "goal" in name]
        self._add(topics.GOAL_POSE, *(name for name in goals if name.endswith("goal")))
        others = [name for name in goals if name not in self.paths]
        self.other_goals = ", ".join(others)

    def _add_named(self) -> None:
        """Let topics that the user names stand for the suite's; BagError if missing."""
        bag = self._bag
        sources = self.sources
        namespace = sources.namespace
        is_inside = [topic.startswith(f"{namespace}/") for topic in bag.types]
        if namespace and not any(is_inside):
            raise BagError(
                f"{bag.path}: no topic in namespace {namespace}{self.list_topics()}"
            )
        named = {topics.GOAL_POSE: sources.goal}
        if not sources.frames:
            named[topics.ODOM] = sources.pose
        if sources.contact != NO_CONTACT:
            named[topics.COLLISION] = sources.contact
        for topic, name in named.items():
            if name:
                found = self._require(name)
                self._add(topic, found)
                # The reader of poses takes several types, and says so.
                if topic != topics.ODOM and bag.types[found] != topic.type_name:
                    raise BagError(f"{bag.path}: {name}: must be a {topic.type_name}")

    def _add(self, topic: topics.Topic, *names: str) -> None:
        """Let a bag's topic stand for a suite's; ignore missing or taken names."""
        is_known = topic.path in self.paths.values()
        if len(names) == 1 and names[0] in self._bag.types and not is_known:
            self.paths.setdefault(names[0], topic.path)

    def _of_type(self, type_name: str) -> list[str]:
        """Return the bag's topics of a type, sorted."""
        types = self._bag.types
        return sorted(name for name in types if types[name] == type_name)

    def _find_namespace(self) -> str:
        """Return the namespace of odometry or true poses, "" if none; BagError if several."""
        names = (_TRUTH, topics.ODOM.path)
        if not self._bag.types.keys().isdisjoint(names):
            return ""
        namespaces = set()
        for topic in self._of_type(_ODOMETRY):
            for name in names:
                if topic.endswith(name):
                    namespaces.add(topic.removesuffix(name))
                    break
        if len(namespaces) > 1:
            raise BagError(
                f"{self._bag.path}: has odometry in several namespaces,"
                f" {', '.join(sorted(namespaces))}; choose one, such as --namespace"
                f" {min(namespaces)}"
            )
        return "".join(namespaces)

    def _require(self, name: str) -> str:
        """Return a topic by name, within the namespace or as it is; BagError if missing."""
        for topic in (f"{self.sources.namespace}{name}", name):
            if topic in self._bag.types:
                return topic
        raise BagError(f"{self._bag.path}: no topic {name}{self.list_topics()}")

    def list_topics(self) -> str:
        """Return "; it has ..." with the bag's topics, for the end of a message."""
        types = self._bag.types.items()
        names = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(types))
        # A bag that is cut off may lack topics.
        if not names and self._bag.problem:
            return f"; {self._bag.problem}"
        return f"; it has {names or 'no messages'}"

    def pose_reader(self) -> "PoseReader":
        """Return a reader of the robot's poses; BagError with the topics if there is none."""
        sources = self.sources
        if sources.frames:
            static = f"{sources.namespace}{topics.TF_STATIC.path}"
            reading = {self._require(topics.TF.path), static, topics.TF_STATIC.path}
            return PoseReader(self._bag, sources.pose, reading, sources.frames)
        for name, topic in self.paths.items():
            if topic == topics.ODOM.path and self._bag.types[name] in _POSE_TYPES:
                name_inside = name.removeprefix(sources.namespace)
                return PoseReader(self._bag, name_inside, {name}, [])
        candidates = [
            name
            for kind in _POSE_TYPES
            for name in self._of_type(kind)
            if "goal" not in name and not name.endswith("/initialpose")
        ]
        if self._of_type(topics.TF.type_name):
            candidates.append(f"{_TF}odom.base_link")
        advice = f"; name them, such as --pose {candidates[0]}" if candidates else ""
        raise BagError(
            f"{self._bag.path}: no poses of a robot on {sources.pose or topics.ODOM.path}"
            f" or on one topic of {', '.join(_POSE_TYPES)}{advice}{self.list_topics()}"
        )


class PoseReader:
    """Reads poses of a robot from one topic, or from frames of tf.

    Attributes:
        name: The source without namespace, such as "/odom" or "/tf:odom.base_link".
        topics: The topics whose messages `read` accepts.
        frame: Frame of the poses; empty before the first one.
    """

    def __init__(self, bag: BagFile, name: str, names: set[str], frames: list[str]):
        """Prepare to read a bag's poses from one topic or, if given, `frames` of tf."""
        self.name = name
        self.topics = names
        self.frame = ""
        self._bag = bag
        # Last poses of tf frames in their parents, by (parent, child).
        self._links: dict[tuple[str, str], Pose2D] = {}
        self._static: set[tuple[str, str]] = set()
        self._frames = frames
        self._chain = list(pairwise(frames))

    def read(self, message: RawMessage) -> Iterator[Odometry]:
        """Yield a message's finite poses, NaN velocity if missing; BagError if malformed.

        Raises:
            BagError: If the message is malformed.
        """
        try:
            for odometry in self._read_poses(message):
                pose = odometry.pose
                # Poses that are left out are a gap.
                if math.isfinite(pose.x + pose.y + pose.yaw):
                    yield odometry
        except MessageError as error:
            text = f"{self._bag.path}: {message.topic}: {format_error(error)}"
            raise BagError(text) from None

    def _read_poses(self, message: RawMessage) -> Iterator[Odometry]:
        """Yield a message's poses, NaN velocity if missing; MessageError if malformed."""
        if self._chain:
            yield from self._read_transforms(message)
            return
        header = decode.header(message.data)
        frame = header.frame.lstrip("/")
        if self.frame not in ("", frame):
            raise MessageError(f"has poses in the frames {self.frame!r} and {frame!r}")
        self.frame = frame
        if message.type_name == _ODOMETRY:
            yield decode.odometry(message.data)
        else:
            is_plain = message.type_name == _POSE
            read = decode.pose if is_plain else decode.pose_with_covariance
            yield Odometry(header.stamp_ns, read(message.data), NO_TWIST)

    def missing_error(self) -> BagError:
        """Return the error of a bag that has been read and has none of these poses."""
        bag = self._bag
        reason = bag.problem or self._explain_missing()
        return BagError(f"{bag.path}: no poses of a robot on {self.name} ({reason})")

    def _explain_missing(self) -> str:
        """Return why no poses could be read from the topic, or the frames of tf."""
        if not self._frames:
            return "none was sent, or none is finite"
        chain = self._find_chain()
        if chain:
            return f"other frames are between: --pose {_TF}{'.'.join(chain)}"
        links = sorted(f"{parent} to {child}" for parent, child in self._links)
        return f"tf has {', '.join(links) or 'no frames'}"

    def _find_chain(self) -> list[str]:
        """Return the chain of tf frames from the first frame to the last, [] if none."""
        parents = {child: parent for parent, child in self._links}
        chain = [self._frames[-1]]
        # Each link counts once: frames in a circle lead nowhere.
        while chain[0] in parents:
            chain.insert(0, parents.pop(chain[0]))
        if self._frames[0] not in chain:
            return []
        return chain[chain.index(self._frames[0]) :]

    def _read_transforms(self, message: RawMessage) -> Iterator[Odometry]:
        """Yield the robot's pose at each transform of the chain's last moving link.

        Nothing is yielded before all links are known. The last moving link is sent most
        often.
        """
        is_static = message.topic.endswith(topics.TF_STATIC.path)
        for transform in decode.transforms(message.data):
            # In ROS 1, names of frames began with a slash.
            link = (transform.parent.lstrip("/"), transform.child.lstrip("/"))
            self._links[link] = transform.pose
            if is_static:
                self._static.add(link)
            moving = [link for link in self._chain if link not in self._static]
            is_known = self._links.keys() >= set(self._chain)
            if is_known and moving and link == moving[-1]:
                self.frame = self._chain[0][0]
                pose = ORIGIN
                for other in self._chain:
                    pose = pose @ self._links[other]
                yield Odometry(transform.stamp_ns, pose, NO_TWIST)
