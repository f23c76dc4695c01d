"""The bag of a trial over ROS: the messages as they were sent, at the simulated time at which they were sent."""

import importlib.util
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import TypesysError, get_types_from_msg

from barn_eval.results.bags.messages import TOPICS, TRUE_TOPICS
from barn_eval.results.bags.recorder import Recorder
from barn_eval.ros.sequencer import Message
from barn_eval.ros.subscriber import Subscriber
from barn_worlds.messages import topics
from barn_worlds.messages.cdr import jazzy_types
from barn_worlds.messages.topics import LATCHED, RELIABLE, OutgoingMessage, Qos, Topic
from barn_worlds.ros.topics import create_optional_publisher


class Recording:
    """Finds out what there is to record, subscribes to it and writes it to the bag of the trial in progress.

    needed: topics that are subscribed to even where nothing is recorded.
    """

    def __init__(
        self,
        node: Node,
        subscriber: Subscriber,
        exclude: Collection[str],
        needed: Collection[str],
    ) -> None:
        self._node, self._subscriber, self._needed = node, subscriber, needed
        self._unwanted = set(exclude)
        # The bag gets these from `show` and not over DDS: what is found out belongs to a tick that is over by then.
        self._exclude = {*exclude, *(topic.path for topic in (*TRUE_TOPICS, *TOPICS))}
        # What goes by another name here is read by the suite's, and what has that name here is not.
        own = {
            node.resolve_topic_name(one.name): one.path
            for one in vars(topics).values()
            if isinstance(one, Topic)
        }
        self._known_as = {
            path: f"{path}_of_others" for path in own.values() if path not in own
        }
        self._known_as |= {name: path for name, path in own.items() if name != path}
        self._publishers = {
            topic: create_optional_publisher(node, topic) for topic in TOPICS
        }
        self._profiles: dict[str, Qos] = {}
        self._refused: set[str] = set()
        self._written: set[tuple[str, int]] = set()

    def discover(self, *, everything: bool) -> None:
        """Subscribe to what somebody publishes and is not subscribed to: all of it, or only what is needed."""
        done = self._refused | self._subscriber.topics().keys()
        for topic, types in self._node.get_topic_names_and_types():
            infos = self._node.get_publishers_info_by_topic(topic)
            wanted = (
                everything and topic not in self._exclude
            ) or topic in self._needed
            if not infos or len(types) != 1 or not wanted:
                continue
            profile = self._profiles.setdefault(topic, offered(infos))
            if topic in done:
                continue
            obstacle = learn(types[0])
            if not obstacle and not self._subscriber.subscribe(
                topic, types[0], profile, judged=topic in self._needed
            ):
                obstacle = f"{types[0]} is not installed"
            if obstacle:
                self._refused.add(topic)
                self._node.get_logger().warning(
                    f"{topic} is not recorded: its type {obstacle}"
                )

    def begin(self, recorder: Recorder, stamp_ns: int) -> None:
        """Write the latched messages, which were sent before the trial but belong to it."""
        self._written = set()
        self.write(recorder, latched := self._subscriber.latched(), stamp_ns)
        self._written = {(message.topic, message.sent_ns) for message in latched}

    def write(
        self, recorder: Recorder, messages: Iterable[Message], stamp_ns: int
    ) -> None:
        """Write the messages of a tick."""
        types = self._subscriber.topics()
        for message in messages:
            wanted = message.topic in types and message.topic not in self._exclude
            if wanted and (message.topic, message.sent_ns) not in self._written:
                name, profile = message.topic, self._profiles.get(message.topic, Qos())
                recorder.add_topic(
                    name, types[name], profile, self._known_as.get(name, "")
                )
                recorder.write(message.topic, message.data, stamp_ns)

    def show(
        self, shown: Iterable[OutgoingMessage], stamp_ns: int, recorder: Recorder | None
    ) -> None:
        """Publish what tells how a trial stands where somebody listens, and write it to the bag, if there is one."""
        for topic, data in shown:
            sender = self._publishers.get(
                topic
            )  # none of what is only recorded, or of a type not installed
            if sender is not None and sender.get_subscription_count():
                sender.publish(data)
            if recorder is not None and topic.path not in self._unwanted:
                latched = topic.qos.durability == LATCHED.durability
                recorder.add_topic(
                    topic.path, topic.type_name, LATCHED if latched else RELIABLE
                )
                recorder.write(topic.path, data, stamp_ns)


def learn(type_name: str) -> str:
    """Add a message type, with all that it consists of, to the known ones as its installed package defines it.

    Returns what is in the way of that, as an end to "its type ...", and an empty text if nothing is.
    """
    known, wanted = jazzy_types(), [type_name]
    found: Typesdict = {}
    while wanted:
        name = wanted.pop()
        if name in known.fielddefs or name in found:
            continue
        package, kind, last = name.split("/")
        if kind != "msg":
            return f"{name} is not a message of its own, but a part of a service or an action"
        spec, share = (
            importlib.util.find_spec(package),
            Path("share", package, kind, f"{last}.msg"),
        )
        places = [
            place
            for one in (spec and spec.submodule_search_locations) or ()
            for place in Path(one).parents
        ]
        file = next(
            (place / share for place in places if (place / share).is_file()), None
        )
        if file is None:
            return f"{name} is not installed"
        try:
            found |= get_types_from_msg(file.read_text("utf-8"), name)
        except (TypesysError, OSError) as error:
            return f"{name} cannot be read from {file}: {error}"
        for _, field in found[name][1]:
            part: Any = (
                field[1][0]
                if field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE)
                else field
            )
            wanted += [part[1]] if part[0] == Nodetype.NAME else []
    known.register(found)
    return ""


def offered(infos: Collection[TopicEndpointInfo]) -> Qos:
    """Return the profile that fits all publishers of a topic: reliable and latched if all of them are."""
    reliable = all(
        info.qos_profile.reliability is ReliabilityPolicy.RELIABLE for info in infos
    )
    latched = all(
        info.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
        for info in infos
    )
    depth = 1 if latched else max(1, *(info.qos_profile.depth for info in infos))
    return Qos(
        "reliable" if reliable else "best_effort",
        "transient_local" if latched else "volatile",
        depth,
    )
