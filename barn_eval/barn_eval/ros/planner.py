"""The planner under test as the evaluator meets it: any node that takes scans and sends commands."""

import json
import re
from collections.abc import Callable
from contextlib import suppress

from rclpy.node import Node

from barn_eval.ros.goals import ActionGoal, TopicGoal
from barn_eval.ros.graph import GraphView, resolve_node_name
from barn_eval.ros.readiness import Finding, Needs, inspect
from barn_eval.ros.session import (
    PLANNER,
    SET_PARAMETERS,
    RemoteNode,
    ServiceRefused,
    ServiceTimeout,
    Session,
    TrialEnded,
)
from barn_eval.ros.supervision.nodes import reach
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.ros_config import EvaluatorConfig
from barn_eval.trials.spec import TrialSpec
from barn_worlds.messages import topics
from barn_worlds.messages.encode import PoseStampedEncoder, encode_map
from barn_worlds.ros.topics import create_publisher

_REPEAT_S = 0.5  # between two goals while the planner is not ready
_READ_S, _NODE_S = 10.0, 2.0  # for all nodes, and for each, to tell their parameters
_OF_ITS_OWN = re.compile(
    r"_(?=[a-f]*\d)[0-9a-f]{4,}$"
)  # what sets a node apart from that of another start
_MOST_NODES, _MOST_READ = (
    100,
    4000,
)  # that are asked; parameters, beyond which no more are
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
    """Waits until the planner is there, tells it what to do and waits until it is ready.

    goal: how it gets that. told: the parameters of its nodes, by "NODE NAME".
    """

    def __init__(
        self, session: Session, view: GraphView, config: EvaluatorConfig
    ) -> None:
        node: Node = session.node
        self._session, self._view = session, view
        self._config, self._patience = config, config.patience
        self._remotes: dict[str, RemoteNode] = {}
        self._name = (
            resolve_node_name(node, config.planner_node) if config.planner_node else ""
        )
        self._remote = self._known(self._name)
        self._looked_at = not self._name  # whether the named node has been
        self.told: dict[str, str] = {}
        self._managed = [
            self._known(resolve_node_name(node, name))
            for name in config.lifecycle_nodes
        ]
        by_action = config.goal_by == "action"
        self.goal = (
            ActionGoal(session, config)
            if by_action
            else TopicGoal(session, view, config)
        )
        self._maps = create_publisher(node, topics.MAP) if config.publish_map else None
        inputs = [
            name
            for name in config.required_inputs
            if name != "goal_pose" or not by_action
        ]
        where = (
            f"on ROS domain {node.context.get_domain_id()}, discovery range {reach()}"
        )
        self._needs = Needs(
            node.resolve_topic_name(topics.CMD_VEL.name),
            config.command_type,
            [(node.resolve_topic_name(name), _INPUT_TYPES[name]) for name in inputs],
            offered=self.goal.offered,
            action=self.goal.action,
            known_nodes={resolve_node_name(node, config.simulator_node)},
            surroundings=f"{where}: compare the planner's environment",
        )

    def await_node(self, limit_s: float) -> None:
        """Wait for the node that the configuration names: a slow one is not one without ~/ready; else TrialEnded."""

        def missing() -> str:
            there = not self._name or self._name in self._view.nodes()
            return "" if there else f"the node {self._name} (planner_node) is not there"

        self._wait_for(missing, limit_s)
        if not self._looked_at:  # services are seen after their node
            self._looked_at = True
            self._session.wait(
                lambda: self._remote.offers("get_state"),
                self._patience.settle_s,
                PLANNER,
            )

    def inactive(self) -> str:
        """Return which managed nodes, the planner's own included, are not active now, in words."""
        own = [self._remote] if self._name and self._remote.offers("get_state") else []
        nodes = {node.name: node for node in (*self._managed, *own)}
        return "; ".join(
            filter(None, (node.fault_of_state() for node in nodes.values()))
        )

    def await_active(self) -> None:
        """Return once all managed nodes are active; TrialEnded, naming those that are not, after the limit."""
        self._wait_for(self.inactive, self._patience.lifecycle_s, "managed nodes: ")

    def await_presence(self, limit_s: float) -> Finding:
        """Wait until a planner has all that it must have and return what was found; else TrialEnded with what lacks."""
        complete_since = wrong_since = None
        finding = Finding()

        def missing() -> str:
            nonlocal finding, complete_since, wrong_since
            now, finding = self._session.now_s, inspect(self._view.graph(), self._needs)
            known = not finding.missing and bool(self._name or finding.command_node)
            complete_since = (complete_since or now) if known else None
            wrong_since = (
                (wrong_since or now)
                if finding.outcome is Outcome.WRONG_MESSAGE_TYPE
                else None
            )
            if (
                wrong_since is not None
                and now - wrong_since > self._patience.mismatch_s
            ):
                raise TrialEnded(finding.outcome, finding.text())
            settled = (
                complete_since is not None
                and now - complete_since >= self._patience.settle_s
            )
            return "" if settled else finding.text() or "it has just come"

        self._wait_for(missing, limit_s)
        self._remote = self._known(self._name or finding.command_node)
        return finding

    def tell_parameters(self) -> None:
        """Tell the supervisor what the planner's nodes say of their parameters, in bounds of time and number."""
        self.told = found = dict[str, str]()
        end_s, nodes = (
            self._session.now_s + _READ_S,
            self._view.nodes() - {"", *self._needs.known_nodes},
        )
        for name in sorted(nodes)[:_MOST_NODES]:
            remote, own = RemoteNode(self._session, name, PLANNER), {}
            with suppress(
                ServiceTimeout, RuntimeError
            ):  # too late, or a value of no type that there is
                if len(found) < _MOST_READ and remote.offers("list_parameters"):
                    own = remote.parameters(min(_NODE_S, end_s - self._session.now_s))
            remote.close()
            called = _OF_ITS_OWN.sub("_*", name)
            found |= {f"{called} {key}": text for key, text in own.items()} or {
                called: "tells none"
            }
        self._session.tell("parameters", text=json.dumps(found))

    def instruct(self, spec: TrialSpec, stamp_ns: int) -> None:
        """Give the planner seed, map and goal and wait until it says that it is ready, where it can say so."""
        self._reset(spec)
        if spec.map is not None and self._maps is not None:
            self._maps.publish(encode_map(spec.map, stamp_ns, self._config.map_frame))
        self.goal.begin(self._goal_message(spec, stamp_ns))
        if not self._remote.offers("ready"):
            return
        session = self._session
        deadline_s, repeat_s = (
            session.now_s + self._patience.gate_s,
            session.now_s + _REPEAT_S,
        )
        while refused := self._refused(
            lambda: self._remote.trigger("ready", self._patience.service_s)
        ):
            if session.now_s > deadline_s:
                raise TrialEnded(Outcome.PLANNER_NOT_READY, refused)
            if session.now_s > repeat_s:
                repeat_s += _REPEAT_S
                self.repeat_goal(spec, stamp_ns)
            session.sleep(0.02, PLANNER)

    def repeat_goal(self, spec: TrialSpec, stamp_ns: int) -> None:
        """Hand over the goal again."""
        self.goal.repeat(self._goal_message(spec, stamp_ns))

    def publishes(self) -> bool:
        """Tell whether the planner's publisher of commands is on the graph."""
        return bool(self._view.publishers(self._needs.command_topic))

    def clock_fault(self) -> str:
        """Return what is wrong with the planner's idea of time, as far as its parameters tell; empty if nothing is."""
        off = self.told.get(f"{self._remote.name} use_sim_time") == "False"
        return f"use_sim_time is off in {self._remote.name}" if off else ""

    def _wait_for(
        self, missing: Callable[[], str], limit_s: float, what: str = "the planner: "
    ) -> None:
        if text := self._session.wait_for(
            what, lambda: self._view.crowd() or missing(), limit_s, PLANNER
        ):
            raise TrialEnded(
                Outcome.PLANNER_NOT_READY, f"{text} (waited {limit_s:g} s)"
            )

    def _goal_message(self, spec: TrialSpec, stamp_ns: int) -> bytes:
        frame = (
            self._config.map_frame
            if spec.protocol.map_given
            else self._config.odom_frame
        )
        return PoseStampedEncoder(frame).encode(spec.goal, stamp_ns)

    def _known(self, name: str) -> RemoteNode:
        return self._remotes.setdefault(name, RemoteNode(self._session, name, PLANNER))

    def _reset(self, spec: TrialSpec) -> None:
        remote, limit_s, seed = (
            self._remote,
            self._patience.service_s,
            {"seed": spec.planner_seed},
        )
        if remote.offers(SET_PARAMETERS) and (
            refused := self._refused(lambda: remote.set_parameters(seed, limit_s))
        ):
            # a planner that takes no seed is no less a planner
            self._session.node.get_logger().info(
                f"the planner is not seeded: {refused}", once=True
            )
        if remote.offers("reset") and (
            refused := self._refused(lambda: remote.trigger("reset", limit_s, limit_s))
        ):
            raise TrialEnded(Outcome.PLANNER_NOT_READY, refused)

    def _refused(self, call: Callable[[], object]) -> str:
        """Call a service of the planner and return what it says against that; TrialEnded if it does not answer."""
        try:
            call()
        except ServiceRefused as error:
            return f"{self._remote.name} says: {error}"
        except ServiceTimeout as error:
            raise TrialEnded(Outcome.PLANNER_NOT_READY, str(error)) from None
        return ""
