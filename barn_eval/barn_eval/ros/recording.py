"""The bag of a trial over ROS: messages as sent, at the simulated time of sending."""

import importlib.util
from collections.abc import Collection, Iterable
from dataclasses import replace
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
from barn_worlds.messages.topics import (
    BEST_EFFORT,
    LATCHED,
    RELIABLE,
    OutgoingMessage,
    Qos,
    Topic,
)
from barn_worlds.ros.topics import create_optional_publisher


class Recording:
    """Subscribes to what somebody publishes and writes it to the bag of a trial."""

    def __init__(
        self,
        node: Node,
        subscriber: Subscriber,
        exclude: Collection[str],
        required: Collection[str],
    ):
        """Create the publishers of the evaluator's own topics.

        Args:
            node: The evaluator node.
            subscriber: Holds the subscriptions.
            exclude: Full names of topics that no bag has; they are not resolved.
            required: Resolved names of topics that are subscribed to even where no bag
                is recorded.
        """
        self._node = node
        self._subscriber = subscriber
        self._required = required
        self._bag_exclude = set(exclude)
        # Bags get the evaluator's own topics from `show`, not over DDS: by the time
        # they arrive there, the tick that they belong to is over.
        evaluator_topics = {topic.path for topic in (*TRUE_TOPICS, *TOPICS)}
        self._exclude = {*exclude, *evaluator_topics}
        self._bag_names = _bag_names(node)
        self._publishers = {
            topic: create_optional_publisher(node, topic) for topic in TOPICS
        }
        self._profiles: dict[str, Qos] = {}
        self._refused: set[str] = set()
        # Latched messages that are in the bag already.
        self._written: set[tuple[str, int]] = set()

    def discover(self, *, everything: bool) -> None:
        """Subscribe to required topics that have a publisher, or to all for a bag.

        Args:
            everything: Subscribe to all topics, and not only to those that are needed.
        """
        finished = self._refused | self._subscriber.topics().keys()
        for topic, types in self._node.get_topic_names_and_types():
            is_required = topic in self._required
            infos = self._node.get_publishers_info_by_topic(topic)
            # Where nodes disagree about a type, a subscription would get only a part of
            # the messages.
            if not infos or len(types) != 1:
                continue
            if not (is_required or (everything and topic not in self._exclude)):
                continue
            # The profile of the first look counts, for topics of the judge as well.
            profile = self._profiles.setdefault(topic, common_profile(infos))
            if topic in finished:
                continue
            (type_name,) = types
            obstacle = register_type(type_name)
            if not obstacle and not self._subscriber.subscribe(
                topic, type_name, profile, judged=is_required
            ):
                obstacle = f"{type_name} is not installed"
            if obstacle:
                # Logged once, and never tried again.
                self._refused.add(topic)
                self._node.get_logger().warning(
                    f"{topic} is not recorded: its type {obstacle}"
                )

    def begin(self, recorder: Recorder, stamp_ns: int) -> None:
        """Write the last message of each latched topic to a new bag, at `stamp_ns`.

        Args:
            recorder: Writes the bag.
            stamp_ns: Simulated time at which the trial begins.
        """
        latched = self._subscriber.read_latched()
        # Nothing counts as written before, or the latched messages would be left out.
        self._written = set()
        self.write(recorder, latched, stamp_ns)
        self._written = {(message.topic, message.sent_ns) for message in latched}

    def write(
        self, recorder: Recorder, messages: Iterable[Message], stamp_ns: int
    ) -> None:
        """Write a tick's messages of recorded topics to the bag, latched ones once.

        Args:
            recorder: Writes the bag.
            messages: In the order of sending; topics without a subscription are left
                out.
            stamp_ns: Simulated time of the tick.
        """
        types = self._subscriber.topics()
        for message in messages:
            topic = message.topic
            if topic not in types or topic in self._exclude:
                continue
            if (topic, message.sent_ns) in self._written:
                continue
            profile = self._profiles.get(topic, Qos())
            recorder.add_topic(
                topic, types[topic], profile, self._bag_names.get(topic, "")
            )
            recorder.write(topic, message.data, stamp_ns)

    def show(
        self,
        messages: Iterable[OutgoingMessage],
        stamp_ns: int,
        recorder: Recorder | None,
    ) -> None:
        """Publish the evaluator's own messages where somebody listens, and record them.

        Args:
            messages: Topics of the evaluator with their serialized messages.
            stamp_ns: Simulated time of the messages.
            recorder: Writes the bag; None where no bag is recorded.
        """
        for topic, data in messages:
            # Some topics are only recorded, and some types may not be installed.
            publisher = self._publishers.get(topic)
            if publisher is not None and publisher.get_subscription_count():
                publisher.publish(data)
            if recorder is not None and topic.path not in self._bag_exclude:
                recorder.record([OutgoingMessage(topic, data)], stamp_ns)


def _bag_names(node: Node) -> dict[str, str]:
    """Return names in bags by names on the graph, for topics where the two differ.

    Remapped topics of the suite go by the suite's name in bags, which readers know. A
    foreign topic that has such a name here gets an ending.
    """
    suite_names = {}
    for topic in vars(topics).values():
        if isinstance(topic, Topic):
            suite_names[node.resolve_topic_name(topic.name)] = topic.path

    bag_names = {}
    for path in suite_names.values():
        if path not in suite_names:
            bag_names[path] = f"{path}_of_others"
    return bag_names | {
        name: path for name, path in suite_names.items() if name != path
    }


def register_type(type_name: str) -> str:
    """Register a message type with rosbags; return what prevents that, "" if nothing.

    Returns:
        What prevents it, as an end to "its type ...", and an empty text if nothing
        does.
    """
    type_store = jazzy_types()
    new_types: Typesdict = {}
    pending = [type_name]
    while pending:
        name = pending.pop()
        if name in type_store.fielddefs or name in new_types:
            continue
        package, kind, short_name = name.split("/")
        # Their definitions are parts of other files, which rosbags does not read.
        if kind != "msg":
            return (
                f"{name} is not a message of its own, but a part of a service or an"
                " action"
            )
        file = _definition_file(package, short_name)
        if file is None:
            return f"{name} is not installed"
        try:
            new_types |= get_types_from_msg(file.read_text("utf-8"), name)
        except (TypesysError, OSError) as error:
            return f"{name} cannot be read from {file}: {error}"
        for _, field_type in new_types[name][1]:
            pending += _part_names(field_type)

    type_store.register(new_types)
    return ""


def _definition_file(package: str, short_name: str) -> Path | None:
    """Return the installed .msg file of a package's type, None if there is none."""
    spec = importlib.util.find_spec(package)
    locations = spec.submodule_search_locations if spec is not None else None
    for location in locations or ():
        for prefix in Path(location).parents:
            file = prefix / "share" / package / "msg" / f"{short_name}.msg"
            if file.is_file():
                return file
    return None


def _part_names(field_type: Any) -> list[str]:
    """Return the message type in a field of rosbags, as a list of one or none."""
    kind, content = field_type
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        # The content of both is a pair: the element's description and a length.
        kind, content = content[0]
    return [content] if kind == Nodetype.NAME else []


def common_profile(infos: Collection[TopicEndpointInfo]) -> Qos:
    """Return a QoS profile for all publishers: reliable or latched only if all are."""
    profiles = [info.qos_profile for info in infos]
    is_reliable = all(
        profile.reliability is ReliabilityPolicy.RELIABLE for profile in profiles
    )
    is_latched = all(
        profile.durability is DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles
    )
    profile = RELIABLE if is_reliable else BEST_EFFORT
    if is_latched:
        return replace(profile, durability=LATCHED.durability, depth=1)
    return replace(profile, depth=max(1, *(profile.depth for profile in profiles)))
