"""What the simulator node publishes, and its status on /diagnostics."""

import math
from collections.abc import Iterable

from rclpy.node import Node

from barn_sim.config import SimulatorNodeConfig
from barn_sim.ros.commands import CommandInput
from barn_sim.ros.trial import Trial
from barn_worlds.messages import topics
from barn_worlds.messages.encode import ERROR, FINE, WARNING, encode_diagnostics
from barn_worlds.messages.topics import BEST_EFFORT, SIMULATOR_DIAGNOSTICS, Outgoing
from barn_worlds.ros.topics import optional_publisher, publisher
from barn_worlds.types import seconds

_TOPICS = (
    topics.CLOCK,
    topics.ODOM,
    topics.GROUND_TRUTH,
    topics.AMCL_POSE,
    topics.COLLISION,
    topics.JOINT_STATES,
    topics.ROBOT_DESCRIPTION,
    topics.SIMULATOR_DIAGNOSTICS,
    topics.TF,
    topics.TF_STATIC,
)
_FAULTS = ("missed_commands", "invalid_commands")


class Outputs:
    """Publish messages on the topics of the simulator; transforms only where their type is installed."""

    def __init__(self, node: Node, config: SimulatorNodeConfig) -> None:
        free = config.scan_reliability == "auto" and not config.lockstep
        scan = BEST_EFFORT if free or config.scan_reliability == "best_effort" else None
        self._scan = publisher(node, topics.SCAN, scan)
        self._publishers = {topic.name: optional_publisher(node, topic) for topic in _TOPICS}
        self._publishers[topics.SCAN.name] = self._scan
        if self._publishers[topics.TF.name] is None:
            node.get_logger().info("tf2_msgs is not installed: /tf and /tf_static are off")

    def publish(self, messages: Iterable[Outgoing]) -> None:
        """Publish messages, in their order."""
        for topic, data in messages:
            sender = self._publishers[topic.name]
            if sender is not None:
                sender.publish(data)

    def scan_subscriptions(self) -> int:
        """Return how many subscriptions the scans reach."""
        return self._scan.get_subscription_count()


def diagnosis(trial: Trial, commands: CommandInput, state: str, real_time_factor: float | None) -> Outgoing:
    """Return the report: an error if commands are not heard, a warning if some were missed or were not numbers.

    real_time_factor: achieved; None in lockstep, NaN while it is not known.
    """
    counts = trial.counts()
    faults = [f"{counts[key]} {key.replace('_', ' ')}" for key in _FAULTS if counts[key]]
    level = WARNING if faults else FINE
    if commands.complaint:
        level = ERROR
        faults.insert(0, commands.complaint)
    values: dict[str, object] = {
        "state": state,
        "world": trial.world_name,
        "seed": trial.config.seed,
        "simulated_s": f"{seconds(trial.simulator.stamp_ns):.3f}",
        "command_type": commands.kind,
        **counts,
    }
    if real_time_factor is not None and not math.isnan(real_time_factor):
        values["real_time_factor"] = f"{real_time_factor:.3f}"
    texts = {key: str(value) for key, value in values.items()}
    message = "; ".join(faults) or state
    data = encode_diagnostics(trial.now_ns, level, "simulator", message, texts, hardware_id="simulated jackal")
    return Outgoing(SIMULATOR_DIAGNOSTICS, data)
