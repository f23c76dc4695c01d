"""The topics of the simulator node: the commands that it takes, and what it publishes, its status included."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

from rclpy.node import Node
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
# What a trial is judged by: goes over the private line, if there is one, and before it is published.
_JUDGED = (topics.CLOCK, topics.ODOM, topics.GROUND_TRUTH, topics.COLLISION)
_JUDGED_NAMES = {topic.name for topic in _JUDGED}
_OTHERS = (
    topics.AMCL_POSE,
    topics.JOINT_STATES,
    topics.ROBOT_DESCRIPTION,
    SIMULATOR_DIAGNOSTICS,
)
_PUBLISHED = (*_JUDGED, *_OTHERS, topics.TF, topics.TF_STATIC)
_TRUE = (topics.GROUND_TRUTH, topics.COLLISION)
_FAULTS = ("missed_commands", "invalid_commands")


class CommandInput:
    """Subscribes to cmd_vel by `kind`, "twist" or "twist_stamped"; `complaint`: what is wrong with its publishers."""

    def __init__(
        self, node: Node, wanted: str, take: Callable[[Velocity2D], None]
    ) -> None:
        self.complaint = ""
        self.kind = "twist" if wanted == "auto" else wanted
        self._node, self._take, self._fixed = node, take, wanted != "auto"
        self._topic = node.resolve_topic_name(CMD_VEL.name)
        self._complained, self._reliable = False, True
        self._subscription = self._subscribe()

    def _subscribe(self) -> Subscription:
        topic = _COMMANDS[self.kind]
        read = partial(decode.command, type_name=topic.type_name)
        qos = (
            topic.qos
            if self._reliable
            else replace(topic.qos, reliability="best_effort")
        )
        return subscribe(self._node, topic, read, self._take, qos)

    def publishers(self) -> int:
        """Return the number of publishers of commands."""
        return int(self._subscription.get_publisher_count())

    def begin_trial(self) -> None:
        """Allow one complaint in the new trial."""
        self._complained = False
        self.look()

    def look(self) -> None:
        """Check the publishers on the topic: adopt their type and reliability, or complain, once per trial."""
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        kinds = sorted(
            _KINDS[info.topic_type] for info in publishers if info.topic_type in _KINDS
        )
        kind = (
            kinds[0]
            if not self._fixed and kinds and self.kind not in kinds
            else self.kind
        )
        # a reliable subscription does not receive from a best-effort publisher
        guaranteed = all(
            info.qos_profile.reliability is not ReliabilityPolicy.BEST_EFFORT
            for info in publishers
        )
        name = _COMMANDS[kind].type_name
        if publishers and (kind, guaranteed) != (self.kind, self._reliable):
            self.kind, self._reliable = kind, guaranteed
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe()
            delivery = "reliably" if guaranteed else "best-effort"
            self._node.get_logger().info(
                f"{self._topic}: commands come {delivery} as {name.rpartition('/')[2]}"
            )
        wrong = sorted(
            f"{info.topic_type} of {info.node_name}"
            for info in publishers
            if info.topic_type != name
        )
        self.complaint = (
            f"{self._topic}: not heard: {', '.join(wrong)}; this run expects {name}"
            if wrong
            else ""
        )
        if (
            wrong and not self._complained
        ):  # not at each change: at first a node's name may not be known
            self._complained = True
            self._node.get_logger().error(self.complaint)


class Outputs:
    """Publishes messages; transforms only where their type is installed, the truth only where it is asked for.

    What a trial is judged by also goes over the private line, if there is one.
    """

    def __init__(
        self, node: Node, config: SimulatorNodeConfig, line: PrivateLine | None = None
    ) -> None:
        free = config.scan_reliability == "auto" and not config.lockstep
        scan = BEST_EFFORT if free or config.scan_reliability == "best_effort" else None
        self._scan = create_publisher(node, topics.SCAN, scan)
        self._line = line
        published = [
            topic for topic in _PUBLISHED if config.ground_truth or topic not in _TRUE
        ]
        self._publishers = {
            topic.name: create_optional_publisher(node, topic) for topic in published
        }
        self._publishers[topics.SCAN.name] = self._scan
        if self._publishers[topics.TF.name] is None:
            node.get_logger().info(
                "tf2_msgs is not installed: /tf and /tf_static are off"
            )

    def publish(self, messages: Iterable[OutgoingMessage]) -> None:
        """Publish messages, in their order."""
        for topic, data in messages:
            if self._line is not None and topic.name in _JUDGED_NAMES:
                self._line.publish(topic.name, data)
            if (sender := self._publishers.get(topic.name)) is not None:
                sender.publish(data)

    def scan_subscriptions(self) -> int:
        """Return how many subscriptions the scans reach."""
        return self._scan.get_subscription_count()


def diagnosis(
    trial: SimulatedTrial, commands: CommandInput, state: str, *, discreet: bool = False
) -> OutgoingMessage:
    """Return the report; discreet: without what would tell a planner under test which world it is in."""
    counts = trial.counts()
    faults = [
        f"{counts[key]} {key.replace('_', ' ')}" for key in _FAULTS if counts[key]
    ]
    level = ERROR if commands.complaint else WARNING if faults else FINE
    texts = {"state": state}
    texts |= (
        {} if discreet else {"world": trial.world_name, "seed": str(trial.config.seed)}
    )
    texts |= {
        "simulated_s": f"{seconds(trial.simulator.stamp_ns):.3f}",
        "command_type": commands.kind,
    }
    texts |= {key: str(value) for key, value in counts.items()}
    message = "; ".join(filter(None, (commands.complaint, *faults))) or state
    data = encode_diagnostics(
        trial.now_ns, level, "simulator", message, texts, hardware_id="simulated jackal"
    )
    return OutgoingMessage(SIMULATOR_DIAGNOSTICS, data)
