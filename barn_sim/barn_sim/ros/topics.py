"""The topics of the simulator node: its commands, its readings and its status."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import ReliabilityPolicy
from rclpy.subscription import Subscription

from barn_sim.config import SimulatorNodeConfig
from barn_sim.ros.trial import SimulatedTrial
from barn_worlds.base.types import Velocity2D, seconds
from barn_worlds.messages import decode, topics
from barn_worlds.messages.encode import ERROR, FINE, WARNING, encode_diagnostics
from barn_worlds.messages.topics import (
    BEST_EFFORT,
    CMD_VEL,
    CMD_VEL_STAMPED,
    SIMULATOR_DIAGNOSTICS,
    OutgoingMessage,
)
from barn_worlds.ros.private_line import PrivateLine
from barn_worlds.ros.topics import (
    create_optional_publisher,
    create_publisher,
    subscribe,
)

_COMMANDS = {"twist": CMD_VEL, "twist_stamped": CMD_VEL_STAMPED}
_KINDS = {topic.type_name: kind for kind, topic in _COMMANDS.items()}

# The referee judges by these: they go over the private line, if there is one, and
# before they are published.
_JUDGED = (topics.CLOCK, topics.ODOM, topics.GROUND_TRUTH, topics.COLLISION)
_PUBLISHED = (
    *_JUDGED,
    topics.AMCL_POSE,
    topics.JOINT_STATES,
    topics.ROBOT_DESCRIPTION,
    SIMULATOR_DIAGNOSTICS,
    topics.TF,
    topics.TF_STATIC,
)
_TRUTH = (topics.GROUND_TRUTH, topics.COLLISION)
_FAULTS = ("missed_commands", "invalid_commands")


class CommandInput:
    """Subscribes to cmd_vel with the type and reliability of its publishers."""

    kind: str
    """Type of the commands: "twist" or "twist_stamped"."""

    complaint: str
    """What is wrong with the publishers, or an empty text."""

    def __init__(self, node: Node, kind: str, take: Callable[[Velocity2D], None]):
        """Subscribe to cmd_vel by `kind`, at first as twist if it is auto.

        Args:
            node: Node that subscribes.
            kind: "twist", "twist_stamped", or "auto" for that of the publishers.
            take: Receives the commands.
        """
        # Until a publisher shows which type it has.
        self.kind = "twist" if kind == "auto" else kind
        self.complaint = ""
        self._follows_publishers = kind == "auto"
        self._node = node
        self._take = take
        self._topic = node.resolve_topic_name(CMD_VEL.name)
        self._has_complained = False
        self._is_reliable = True
        self._subscription = self._subscribe()

    def _subscribe(self) -> Subscription:
        """Subscribe to cmd_vel with the present type and reliability."""
        topic = _COMMANDS[self.kind]
        decode_command = partial(decode.command, type_name=topic.type_name)
        qos = topic.qos
        if not self._is_reliable:
            qos = replace(qos, reliability="best_effort")
        return subscribe(self._node, topic, decode_command, self._take, qos)

    def publishers(self) -> int:
        """Return the number of cmd_vel publishers that the node sees now."""
        return int(self._subscription.get_publisher_count())

    def begin_trial(self) -> None:
        """Allow one logged complaint in the new trial, and check the publishers."""
        self._has_complained = False
        self.check_publishers()

    def check_publishers(self) -> None:
        """Resubscribe if publishers' type or reliability differs; set, log `complaint`.

        Publishers of another type are complained of once per trial.
        """
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        kind = self.kind
        kinds = sorted(
            _KINDS[info.topic_type] for info in publishers if info.topic_type in _KINDS
        )
        if self._follows_publishers and kinds and kind not in kinds:
            kind = kinds[0]

        # A reliable subscription does not receive from a best-effort publisher.
        is_reliable = all(
            info.qos_profile.reliability is not ReliabilityPolicy.BEST_EFFORT
            for info in publishers
        )
        type_name = _COMMANDS[kind].type_name
        if publishers and (kind, is_reliable) != (self.kind, self._is_reliable):
            self.kind = kind
            self._is_reliable = is_reliable
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe()
            delivery = "reliably" if is_reliable else "best-effort"
            short_name = type_name.rpartition("/")[2]
            self._node.get_logger().info(
                f"{self._topic}: commands come {delivery} as {short_name}"
            )

        strangers = sorted(
            f"{info.topic_type} of {info.node_name}"
            for info in publishers
            if info.topic_type != type_name
        )
        self.complaint = ""
        if strangers:
            self.complaint = (
                f"{self._topic}: not heard: {', '.join(strangers)}; "
                f"this run expects {type_name}"
            )
            # Not at each change: at first a node's name may be missing.
            if not self._has_complained:
                self._has_complained = True
                self._node.get_logger().error(self.complaint)


class Outputs:
    """Publishes messages; sends those that the referee needs over the private line.

    Transforms are published only where their type is installed, the truth only if the
    configuration allows it.
    """

    def __init__(
        self, node: Node, config: SimulatorNodeConfig, line: PrivateLine | None = None
    ):
        """Create the publishers: of truth if configured, of transforms if installed.

        Args:
            node: Node that publishes.
            config: Whether to publish the truth, and reliability of the scans.
            line: Private line to the evaluator.
        """
        scan_qos = None
        if config.scan_reliability == "best_effort":
            scan_qos = BEST_EFFORT
        self._scan = create_publisher(node, topics.SCAN, scan_qos)
        self._line = line
        self._publishers: dict[str, Publisher | None] = {topics.SCAN.name: self._scan}
        for topic in _PUBLISHED:
            if config.ground_truth or topic not in _TRUTH:
                self._publishers[topic.name] = create_optional_publisher(node, topic)
        if self._publishers[topics.TF.name] is None:
            node.get_logger().info(
                "tf2_msgs is not installed: /tf and /tf_static are not published"
            )

    def publish(self, messages: Iterable[OutgoingMessage]) -> None:
        """Publish messages, the referee's first over the line; drop unknown topics.

        Those of a topic without a publisher are dropped.
        """
        for topic, data in messages:
            # Over the line first: the referee must not lag behind what a planner can
            # know.
            if self._line is not None and topic in _JUDGED:
                self._line.publish(topic.name, data)
            topic_publisher = self._publishers.get(topic.name)
            if topic_publisher is not None:
                topic_publisher.publish(data)

    def scan_subscriptions(self) -> int:
        """Return the number of subscriptions to the scans that the node sees now."""
        return self._scan.get_subscription_count()


def diagnosis(
    trial: SimulatedTrial, commands: CommandInput, state: str, *, discreet: bool = False
) -> OutgoingMessage:
    """Return a trial's diagnostics, without world and seed if discreet; send nothing.

    Args:
        trial: Trial that runs.
        commands: Type of commands, and complaints about their publishers.
        state: "running" or "paused".
        discreet: Whether to leave out which world it is, which a planner under test
            must not know.
    """
    counts = trial.counts()
    faults = [
        f"{counts[name]} {name.replace('_', ' ')}" for name in _FAULTS if counts[name]
    ]
    # A planner of another type is never heard, so that is the graver fault.
    level = WARNING if faults else FINE
    problems = faults
    if commands.complaint:
        level = ERROR
        problems = [commands.complaint, *faults]

    values = {"state": state}
    if not discreet:
        values["world"] = trial.world_name
        values["seed"] = str(trial.config.seed)
    values["simulated_s"] = f"{seconds(trial.simulator.stamp_ns):.3f}"
    values["command_type"] = commands.kind
    for name, count in counts.items():
        values[name] = str(count)

    data = encode_diagnostics(
        trial.now_ns,
        level,
        "simulator",
        "; ".join(problems) or state,
        values,
        hardware_id="simulated jackal",
    )
    return OutgoingMessage(SIMULATOR_DIAGNOSTICS, data)
