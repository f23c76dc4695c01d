"""The planner under test as the evaluator meets it: any node that drives by scans."""

import json
import re
from collections.abc import Callable
from contextlib import closing, suppress

from barn_eval.ros.evaluator_loop import EvaluatorLoop, PlannerNotReady, TrialEnded
from barn_eval.ros.goals import ActionGoal, TopicGoal
from barn_eval.ros.graph import GraphView, resolve_node_name
from barn_eval.ros.readiness import Finding, Needs, inspect
from barn_eval.ros.remote_node import (
    SET_PARAMETERS,
    RemoteNode,
    ServiceRefused,
    ServiceTimeout,
)
from barn_eval.ros.supervision.nodes import discovery_range
from barn_eval.trials.result import PLANNER, Outcome
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_eval.trials.spec import TrialSpec
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import Pose2D
from barn_worlds.messages import topics
from barn_worlds.messages.encode import PoseStampedEncoder, encode_map
from barn_worlds.ros.topics import create_publisher

_GOAL_PERIOD_S = 0.5  # between two goals while the planner is not ready
_READY_PERIOD_S = 0.02  # between two calls of ~/ready
# Limits for the parameters of all nodes: time for all and for each, number of nodes,
# and the number of parameters beyond which no other node is read.
_ALL_PARAMETERS_S = 10.0
_NODE_PARAMETERS_S = 2.0
_MAX_NODES = 100
_MAX_PARAMETERS = 4000
# Ending of a node's name that differs from one start to the next.
_RANDOM_ENDING = re.compile(r"_(?=[a-f]*\d)[0-9a-f]{4,}$")
# What is stored of a node that tells no parameters, and of one that takes no seed either.
_SILENT = "tells none"
_MUTE = "answers nothing"
_INPUTS = (
    topics.SCAN,
    topics.ODOM,
    topics.GOAL_POSE,
    topics.MAP,
    topics.AMCL_POSE,
    topics.TF,
)
_INPUT_TYPES = {topic.name.lstrip("/"): topic.type_name for topic in _INPUTS}


class PlannerClient:
    """Waits for the planner, gives it seed, map and goal, and waits until it is ready.

    Methods raise TrialEnded if the planner does not do its part within a limit.
    """

    def __init__(self, loop: EvaluatorLoop, view: GraphView, config: EvaluatorConfig):
        """Create publishers and clients for goal, map and services; wait for nothing.

        Args:
            loop: Spends the time of waits.
            view: Shows the graph.
            config: How the planner is reached, and limits of waits.
        """
        node = loop.node
        self._loop = loop
        self._view = view
        self._config = config
        self._patience = config.patience
        self._nodes: dict[str, RemoteNode] = {}
        # Full name of the planner's node, empty if the commands' sender counts.
        self._name = ""
        if config.planner_node:
            self._name = resolve_node_name(node, config.planner_node)
        self._node = self._remote_node(self._name)
        self._awaits_services = bool(self._name)
        # Parameters of the planner's nodes as texts, by "NODE NAME".
        self.parameters: dict[str, str] = {}
        # Start in the frame of a system's odometry; None if the odometry begins there.
        self.origin: Pose2D | None = None
        self._managed_nodes = [
            self._remote_node(resolve_node_name(node, name))
            for name in config.lifecycle_nodes
        ]

        # The route of the goal to the planner.
        self.goal: ActionGoal | TopicGoal
        inputs = list(config.required_inputs)
        if config.goal_by == "action":
            self.goal = ActionGoal(loop, config)
            # The action carries the goal, so nobody need subscribe to the topic.
            inputs = [name for name in inputs if name != "goal_pose"]
        else:
            self.goal = TopicGoal(loop, view, config)
        self._map_publisher = None
        if config.publish_map:
            self._map_publisher = create_publisher(node, topics.MAP)

        domain = node.context.get_domain_id()
        self._needs = Needs(
            node.resolve_topic_name(topics.CMD_VEL.name),
            config.command_type,
            [(node.resolve_topic_name(name), _INPUT_TYPES[name]) for name in inputs],
            offered=self.goal.offered,
            action=self.goal.action,
            known_nodes={resolve_node_name(node, config.simulator_node)},
            surroundings=(
                f"on ROS domain {domain}, discovery range {discovery_range()}:"
                " compare the planner's environment"
            ),
        )

    def await_node(self, limit_s: float) -> None:
        """Wait for `planner_node` (the first time, its services), or PlannerNotReady.

        Nothing happens if none is set. A node that starts slowly must not be taken for
        one without ~/ready.
        """

        def describe_missing() -> str:
            """Return a text if the named node is not there, else ""."""
            if not self._name or self._name in self._view.nodes():
                return ""
            return f"the node {self._name} (planner_node) is not there"

        self._wait(describe_missing, limit_s)
        if self._awaits_services:
            # Services appear on the graph after their node.
            self._awaits_services = False
            self._loop.wait(
                lambda: self._node.offers("get_state"), self._patience.settle_s, PLANNER
            )

    def inactive_nodes(self) -> str:
        """Return which lifecycle nodes are not active, in words; empty if all are."""
        nodes = {node.name: node for node in self._managed_nodes}
        if self._name and self._node.offers("get_state"):
            nodes[self._name] = self._node
        problems = (node.lifecycle_problem() for node in nodes.values())
        return "; ".join(filter(None, problems))

    def await_active(self) -> None:
        """Wait until all lifecycle nodes are active, or raise PlannerNotReady."""
        self._wait(self.inactive_nodes, self._patience.lifecycle_s, "managed nodes: ")

    def await_presence(self, limit_s: float, *, first: bool) -> Finding:
        """Await, store and return the planner's endpoints, steadily complete; or raise.

        Args:
            limit_s: Longest wait.
            first: Whether no trial has been driven yet.

        Returns:
            Type, reliability and sender of its commands.

        Raises:
            TrialEnded: If something is still missing after the limit, or if a type or
                QoS is wrong for longer than `mismatch_s`.
            BarnError: If a QoS is wrong for that long before any trial, as all trials would
                end in the same way.
        """
        complete_since_s: float | None = None
        wrong_since_s: float | None = None
        finding = Finding()

        def describe_missing() -> str:
            """Return what is missing, "" once steadily complete; raise if wrong."""
            nonlocal finding, complete_since_s, wrong_since_s
            now_s = self._loop.now_s
            finding = inspect(self._view.graph(), self._needs)

            is_wrong_type = finding.outcome is Outcome.WRONG_MESSAGE_TYPE
            if not (is_wrong_type or finding.has_unfit_qos):
                wrong_since_s = None
            else:
                # A planner before this one may have left endpoints, which are about to
                # be replaced.
                wrong_since_s = wrong_since_s or now_s
                if now_s - wrong_since_s > self._patience.mismatch_s:
                    if first and not is_wrong_type:
                        raise BarnError(f"planner: {finding.text()}")
                    raise TrialEnded(finding.outcome, finding.text())

            is_complete = not finding.missing and (self._name or finding.command_node)
            if not is_complete:
                complete_since_s = None
                return finding.text() or "it has just appeared"
            complete_since_s = complete_since_s or now_s
            # The other nodes may see the planner a little later than the evaluator.
            if now_s - complete_since_s < self._patience.settle_s:
                return "it has just appeared"
            return ""

        self._wait(describe_missing, limit_s)
        self._node = self._remote_node(self._name or finding.command_node)
        return finding

    def report_parameters(self) -> None:
        """Read, store and report parameters of all nodes but the simulator's."""
        self.parameters = {}
        deadline_s = self._loop.now_s + _ALL_PARAMETERS_S
        # The empty name stands for all nodes whose names discovery has not told yet.
        names = self._view.nodes() - {"", *self._needs.known_nodes}
        for name in sorted(names)[:_MAX_NODES]:
            stable_name = _RANDOM_ENDING.sub("_*", name)
            parameters = self._read_parameters(name, deadline_s)
            for key, value in parameters.items():
                self.parameters[f"{stable_name} {key}"] = value
            if not parameters:
                self.parameters[stable_name] = _SILENT
        self._loop.report("parameters", text=json.dumps(self.parameters))

    def _read_parameters(self, name: str, deadline_s: float) -> dict[str, str]:
        """Return a node's parameters as texts; {} if it does not tell them in time."""
        if len(self.parameters) >= _MAX_PARAMETERS:
            return {}
        # RuntimeError: a value of a type that rclpy does not know.
        with (
            closing(RemoteNode(self._loop, name, PLANNER)) as node,
            suppress(ServiceTimeout, RuntimeError),
        ):
            if node.offers("list_parameters"):
                remaining_s = deadline_s - self._loop.now_s
                return node.read_parameters(min(_NODE_PARAMETERS_S, remaining_s))
        return {}

    def instruct(self, spec: TrialSpec, stamp_ns: int) -> None:
        """Reset the planner, send map and goal, await ~/ready, or raise TrialEnded.

        Args:
            spec: The trial.
            stamp_ns: Simulated time now.
        """
        self._reset(spec)
        if spec.map is not None and self._map_publisher is not None:
            self._map_publisher.publish(
                encode_map(spec.map, stamp_ns, self._config.map_frame)
            )
        self.goal.begin(self._encode_goal(spec, stamp_ns))
        if not self._node.offers("ready"):
            return

        loop = self._loop
        deadline_s = loop.now_s + self._patience.gate_s
        next_goal_s = loop.now_s + _GOAL_PERIOD_S
        while refusal := self._refusal(
            lambda: self._node.trigger("ready", self._patience.service_s)
        ):
            if loop.now_s > deadline_s:
                raise PlannerNotReady(refusal)
            if loop.now_s > next_goal_s:
                next_goal_s += _GOAL_PERIOD_S
                self.repeat_goal(spec, stamp_ns)
            loop.sleep(_READY_PERIOD_S, PLANNER)

    def repeat_goal(self, spec: TrialSpec, stamp_ns: int) -> None:
        """Send the goal again, but to an action only if the last goal has failed.

        Args:
            spec: The trial.
            stamp_ns: Simulated time for the goal's header.
        """
        self.goal.repeat(self._encode_goal(spec, stamp_ns))

    def clock_problem(self) -> str:
        """Return a text if the planner says that use_sim_time is off, else ""."""
        if self._use_sim_time() == "False":
            return f"use_sim_time is off in {self._node.name}"
        return ""

    def follows_clock(self) -> bool:
        """Return whether the planner has said that it uses simulated time."""
        return self._use_sim_time() == "True"

    def idle_topics(self) -> str:
        """Return a text on topics that it hears nothing on, as no node publishes; or ""."""
        node = self._loop.node
        subscriptions = self._view.graph().subscriptions
        topics = {item.topic for item in subscriptions}
        idle = [topic for topic in sorted(topics) if not node.count_publishers(topic)]
        text = ", ".join(idle)
        return text and f"no node publishes {text}"

    def _use_sim_time(self) -> str:
        """Return the planner's parameter use_sim_time as a text, empty if unknown."""
        return self.parameters.get(f"{self._node.name} use_sim_time", "")

    def _wait(
        self,
        describe_missing: Callable[[], str],
        limit_s: float,
        subject: str = "the planner: ",
    ) -> None:
        """Wait until `describe_missing` returns "", or raise PlannerNotReady.

        The user gets a note every 5 s. A graph that is too crowded counts as missing
        something.
        """
        # A crowded graph is reported first: a look at all of it would take too long.
        missing = self._loop.wait_for_missing(
            subject, lambda: self._view.crowd() or describe_missing(), limit_s, PLANNER
        )
        if missing:
            raise PlannerNotReady(f"{missing} (waited {limit_s:g} s)")

    def _encode_goal(self, spec: TrialSpec, stamp_ns: int) -> bytes:
        """Return the goal as a serialized PoseStamped, in the map or odom frame."""
        config = self._config
        # A planner that is given a map is localized in it, others have odometry alone.
        frame = config.map_frame if spec.protocol.map_given else config.odom_frame
        goal = spec.goal
        if self.origin is not None and not spec.protocol.map_given:
            goal = self.origin @ goal
        return PoseStampedEncoder(frame).encode(goal, stamp_ns)

    def _remote_node(self, name: str) -> RemoteNode:
        """Return the client of a node by full name; make it at the first call."""
        if name not in self._nodes:
            self._nodes[name] = RemoteNode(self._loop, name, PLANNER)
        return self._nodes[name]

    def _reset(self, spec: TrialSpec) -> None:
        """Set the seed, which may be refused; call ~/reset or raise PlannerNotReady.

        Each is done only where the node offers it. A refused seed is logged.
        """
        node = self._node
        limit_s = self._patience.service_s
        name = _RANDOM_ENDING.sub("_*", node.name)
        if node.offers(SET_PARAMETERS) and self.parameters.get(name) != _MUTE:
            seed = {"seed": spec.planner_seed}
            try:
                refusal = self._refusal(lambda: node.set_parameters(seed, limit_s))
            except PlannerNotReady as error:
                # A node that only publishes may never be spun, and drives all the same.
                if self.parameters.get(name) != _SILENT:
                    raise
                self.parameters[name] = _MUTE
                refusal = error.detail
            if refusal:
                # A planner need not take a seed.
                self._loop.node.get_logger().info(
                    f"the planner takes no seed: {refusal}", once=True
                )
        if node.offers("reset"):
            refusal = self._refusal(lambda: node.trigger("reset", limit_s, limit_s))
            if refusal:
                raise PlannerNotReady(refusal)

    def _refusal(self, call: Callable[[], object]) -> str:
        """Call a service; return why it refused, else ""; PlannerNotReady if silent."""
        try:
            call()
        except ServiceRefused as error:
            return f"{self._node.name} says: {error}"
        except ServiceTimeout as error:
            raise PlannerNotReady(str(error)) from None
        return ""
