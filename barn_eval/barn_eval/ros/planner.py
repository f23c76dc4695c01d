"""The planner under test as the evaluator meets it: any node that takes scans and sends commands."""

from __future__ import annotations

import time

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node

from barn_eval.evaluator_config import EvaluatorConfig
from barn_eval.gate import Needs, inspect
from barn_eval.outcome import Outcome
from barn_eval.ros.graph import GraphView
from barn_eval.ros.remote import SET_PARAMETERS, Refused, RemoteNode, Silent
from barn_eval.ros.station import PLANNER, Station, TrialEnded
from barn_eval.trial import MAP_FRAME, TrialSpec
from barn_worlds.ros.conversions import LATCHED, reliable, to_occupancy_grid, to_pose_stamped

_LOOK_S = 0.05  # between two looks at the graph
_TELL_S = 5.0  # between two notes on what is waited for
_REPEAT_S = 0.5  # between two goals while the planner is not ready
_INPUT_TYPES = {
    "scan": "sensor_msgs/msg/LaserScan",
    "odom": "nav_msgs/msg/Odometry",
    "goal_pose": "geometry_msgs/msg/PoseStamped",
    "map": "nav_msgs/msg/OccupancyGrid",
    "amcl_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "tf": "tf2_msgs/msg/TFMessage",
}


class PlannerClient:
    """Waits until the planner is there, tells it what to do and waits until it is ready."""

    def __init__(self, station: Station, view: GraphView, config: EvaluatorConfig) -> None:
        node: Node = station.node
        self._station = station
        self._view = view
        self._config = config
        self._patience = config.patience
        self._remote = RemoteNode(station, config.planner_node, PLANNER)
        self._remotes: dict[str, RemoteNode] = {}
        self._goals = node.create_publisher(PoseStamped, "goal_pose", reliable(10))
        self._maps = node.create_publisher(OccupancyGrid, "map", LATCHED) if config.publish_map else None
        self._needs = Needs(
            node.resolve_topic_name("cmd_vel"),
            config.command_type,
            [(node.resolve_topic_name(name), _INPUT_TYPES[name]) for name in config.required_inputs],
        )

    def await_presence(self, limit_s: float) -> str:
        """Wait until everything that a planner must have is on the graph and return the type of its commands.

        Raises TrialEnded with all that is missing after the limit; sooner where a type is wrong.
        """
        patience, began = self._patience, time.monotonic()
        complete_since = wrong_since = None
        tell_at = began + _TELL_S
        while True:
            now = time.monotonic()
            finding = inspect(self._view.graph(), self._needs)
            known = finding.ready and bool(self._config.planner_node or finding.command_node)
            complete_since = (complete_since or now) if known else None
            wrong_since = (wrong_since or now) if finding.outcome is Outcome.WRONG_MESSAGE_TYPE else None
            if complete_since is not None and now - complete_since >= patience.settle_s:
                self._meet(self._config.planner_node or finding.command_node)
                return finding.command_type
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
            self._maps.publish(to_occupancy_grid(spec.map, stamp_ns, MAP_FRAME))
        self._await_listeners()
        self.send_goal(spec, stamp_ns)
        if not self._remote.offers("ready"):
            return
        deadline = time.monotonic() + self._patience.gate_s
        repeat_at = time.monotonic() + _REPEAT_S
        while (reason := self._not_ready()) is not None:
            if time.monotonic() > deadline:
                raise TrialEnded(Outcome.PLANNER_NOT_READY, f"{self._remote.name} says: {reason}")
            if time.monotonic() > repeat_at:
                repeat_at += _REPEAT_S
                self.send_goal(spec, stamp_ns)
            self._station.wait(lambda: False, 0.02, PLANNER)

    def send_goal(self, spec: TrialSpec, stamp_ns: int) -> None:
        """Publish the goal in the planning frame."""
        self._goals.publish(to_pose_stamped(spec.goal, stamp_ns, spec.planning_frame))

    def publishes(self) -> bool:
        """Tell whether the planner's publisher of commands is on the graph."""
        return self._view.publishes(self._needs.command_topic)

    def _await_listeners(self) -> None:
        """Wait until all who subscribe to the goal are connected: a planner without ~/ready hears it only once."""
        topic = self._goals.topic_name
        listeners = sum(endpoint.topic == topic for endpoint in self._view.graph().subscriptions)
        if not self._station.wait(
            lambda: self._goals.get_subscription_count() >= listeners, self._patience.service_s, PLANNER
        ):
            raise TrialEnded(Outcome.PLANNER_NOT_READY, f"no connection to the subscription to {topic}")

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
