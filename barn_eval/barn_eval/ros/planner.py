"""The planner under test as the evaluator meets it: any node that takes scans and sends commands."""

import time

from rclpy.node import Node

from barn_eval.experiments.ros_config import EvaluatorConfig
from barn_eval.ros.gate import Finding, Needs, inspect
from barn_eval.ros.goals import goal_channel
from barn_eval.ros.graph import GraphView, resolve_node_name
from barn_eval.ros.loopback import reach
from barn_eval.ros.remote import SET_PARAMETERS, LifecycleNodes, Refused, RemoteNode, Silent
from barn_eval.ros.station import PLANNER, Station, TrialEnded
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.spec import TrialSpec
from barn_worlds.messages import topics
from barn_worlds.messages.encode import PoseStampedEncoder, encode_map
from barn_worlds.ros.topics import publisher

_LOOK_S = 0.05  # between two looks at the graph
_TELL_S = 5.0  # between two notes on what is waited for
_REPEAT_S = 0.5  # between two goals while the planner is not ready
_INPUTS = (topics.SCAN, topics.ODOM, topics.GOAL_POSE, topics.MAP, topics.AMCL_POSE, topics.TF)
_INPUT_TYPES = {topic.name.lstrip("/"): topic.type_name for topic in _INPUTS}


class PlannerClient:
    """Waits until the planner is there, tells it what to do and waits until it is ready.

    lifecycle: managed nodes that it consists of.
    """

    def __init__(self, station: Station, view: GraphView, config: EvaluatorConfig) -> None:
        node: Node = station.node
        self._station = station
        self._view = view
        self._config = config
        self._patience = config.patience
        self._name = resolve_node_name(node, config.planner_node) if config.planner_node else ""
        self._remote = RemoteNode(station, self._name, PLANNER)
        self._known = False  # whether the named node has been looked at
        self._remotes: dict[str, RemoteNode] = {}
        self._goal = goal_channel(station, view, config)
        self._maps = publisher(node, topics.MAP) if config.publish_map else None
        self.lifecycle = LifecycleNodes(station, config.lifecycle_nodes)
        inputs = [name for name in config.required_inputs if name != "goal_pose" or self._goal.action is None]
        self._needs = Needs(
            node.resolve_topic_name(topics.CMD_VEL.name),
            config.command_type,
            [(node.resolve_topic_name(name), _INPUT_TYPES[name]) for name in inputs],
            offered=[self._goal.offered] if self._goal.offered else [],
            action=self._goal.action,
            known_nodes={resolve_node_name(node, config.simulator_node)},
            surroundings=_surroundings(node),
        )

    @property
    def verdict(self) -> str | None:
        """What the planner itself says of the trial, None where it is not asked."""
        return self._goal.verdict

    def await_node(self, limit_s: float) -> None:
        """Wait until the node that the configuration names is there; from then on, a managed one has to be active.

        Otherwise one that is slow to start would be taken for one without ~/ready. TrialEnded after the limit.
        """
        began = time.monotonic()
        tell_at = began + _TELL_S
        while self._name and self._name not in self._view.nodes():
            now, text = time.monotonic(), f"the node {self._name} (planner_node) is not there"
            if now - began > limit_s:
                raise TrialEnded(Outcome.PLANNER_NOT_READY, f"{text} (waited {limit_s:g} s)")
            if now > tell_at:
                tell_at += _TELL_S
                self._station.note(f"waiting for the planner: {text}")
            self._station.wait(lambda: False, _LOOK_S, PLANNER)
        if self._name and not self._known:
            self._known = True
            self.lifecycle.add(self._remote)
            self._station.wait(lambda: self._remote.offers("get_state"), self._patience.settle_s, PLANNER)

    def await_presence(self, limit_s: float) -> Finding:
        """Wait until everything that a planner must have is on the graph and return what was found.

        Raises TrialEnded with all that is missing after the limit; sooner where a type is wrong.
        """
        patience, began = self._patience, time.monotonic()
        complete_since = wrong_since = None
        tell_at = began + _TELL_S
        while True:
            now = time.monotonic()
            finding = inspect(self._view.graph(), self._needs)
            known = finding.ready and bool(self._name or finding.command_node)
            complete_since = (complete_since or now) if known else None
            wrong_since = (wrong_since or now) if finding.outcome is Outcome.WRONG_MESSAGE_TYPE else None
            if complete_since is not None and now - complete_since >= patience.settle_s:
                self._meet(self._name or finding.command_node)
                return finding
            if wrong_since is not None and now - wrong_since > patience.mismatch_s:
                raise TrialEnded(finding.outcome, finding.text())
            if now - began > limit_s:
                raise TrialEnded(finding.outcome, f"{finding.text()} (waited {limit_s:g} s)")
            if now > tell_at:
                tell_at += _TELL_S
                self._station.note(f"waiting for the planner: {finding.text()}")
            self._station.wait(lambda: False, _LOOK_S, PLANNER)

    def instruct(self, spec: TrialSpec, stamp_ns: int) -> None:
        """Give the planner seed, map and goal and wait until it says that it is ready, where it can say so."""
        self._reset(spec)
        if spec.map is not None and self._maps is not None:
            self._maps.publish(encode_map(spec.map, stamp_ns, self._config.map_frame))
        self._goal.begin(self._goal_message(spec, stamp_ns))
        if not self._remote.offers("ready"):
            return
        deadline = time.monotonic() + self._patience.gate_s
        repeat_at = time.monotonic() + _REPEAT_S
        while (reason := self._not_ready()) is not None:
            if time.monotonic() > deadline:
                raise TrialEnded(Outcome.PLANNER_NOT_READY, f"{self._remote.name} says: {reason}")
            if time.monotonic() > repeat_at:
                repeat_at += _REPEAT_S
                self.repeat_goal(spec, stamp_ns)
            self._station.wait(lambda: False, 0.02, PLANNER)

    def repeat_goal(self, spec: TrialSpec, stamp_ns: int) -> None:
        """Hand over the goal again."""
        self._goal.repeat(self._goal_message(spec, stamp_ns))

    def dismiss(self) -> None:
        """Take the goal back, the trial being over."""
        self._goal.end()

    def publishes(self) -> bool:
        """Tell whether the planner's publisher of commands is on the graph."""
        return bool(self._view.publishers(self._needs.command_topic))

    def topics(self) -> dict[str, str]:
        """Return what the node that sends the commands publishes: topic to type."""
        return self._view.topics_of(self._remote.name)

    def clock_fault(self) -> str:
        """Return what is wrong with the planner's idea of time, as far as its parameters tell; empty if nothing is."""
        if not self._remote.offers("get_parameters"):
            return ""
        try:
            simulated = self._remote.get_parameter("use_sim_time", self._patience.connection_s)
        except (Silent, TrialEnded):
            return ""
        return f"use_sim_time is off in {self._remote.name}" if simulated is False else ""

    def _goal_message(self, spec: TrialSpec, stamp_ns: int) -> bytes:
        frame = self._config.map_frame if spec.protocol.map_given else self._config.odom_frame
        return PoseStampedEncoder(frame).encode(spec.goal, stamp_ns)

    def _meet(self, name: str) -> None:
        if name not in self._remotes:
            self._remotes[name] = RemoteNode(self._station, name, PLANNER)
        self._remote = self._remotes[name]

    def _reset(self, spec: TrialSpec) -> None:
        limit_s = self._patience.service_s
        try:
            if self._remote.offers(SET_PARAMETERS):
                self._seed(spec, limit_s)
            if self._remote.offers("reset"):
                self._remote.trigger("reset", limit_s, once=True)
        except Silent as error:
            raise TrialEnded(Outcome.PLANNER_NOT_READY, str(error)) from None
        except Refused as error:
            raise TrialEnded(Outcome.PLANNER_NOT_READY, f"{self._remote.name} says: {error}") from None

    def _seed(self, spec: TrialSpec, limit_s: float) -> None:
        try:
            self._remote.set_parameters({"seed": spec.planner_seed}, limit_s)
        except Refused as error:
            # a planner that takes no seed is no less a planner
            self._station.node.get_logger().info(f"the planner is not seeded: {error}", once=True)

    def _not_ready(self) -> str | None:
        try:
            self._remote.trigger("ready", self._patience.service_s, once=False)
        except Refused as error:
            return str(error)
        except Silent as error:
            raise TrialEnded(Outcome.PLANNER_NOT_READY, str(error)) from None
        return None


def _surroundings(node: Node) -> str:
    """Return where the graph is looked at, for the user to compare with the planner's environment."""
    return f"on ROS domain {node.context.get_domain_id()}, discovery range {reach()}: compare the planner's environment"
