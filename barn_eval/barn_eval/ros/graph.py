"""The ROS graph as the readiness gate wants to see it."""

import time
from collections.abc import Callable
from contextlib import suppress

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from barn_eval.ros.readiness import PARTICIPANT_BYTES, Endpoint, Graph
from barn_worlds.ros.topics import own_identity

LEASE_S = 30.0  # DDS forgets a process that was killed after some 20 s
_SEND_GOAL = "/_action/send_goal"


class GraphView:
    """Sees the endpoints of other nodes, less those of processes known to have died.

    Until DDS forgets those, a planner that is started in place of another would seem to be there before it is.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._own = own_identity(node)[:PARTICIPANT_BYTES]
        self._gone: dict[bytes, float] = {}  # until when they are left out

    def graph(self) -> Graph:
        """Return all endpoints of other nodes that are alive as far as known."""
        topics = [topic for topic, _ in self._node.get_topic_names_and_types()]
        publishers = [endpoint for topic in topics for endpoint in self.publishers(topic)]
        return Graph(publishers, [one for topic in topics for one in self.subscriptions(topic)], self._actions())

    def nodes(self) -> set[str]:
        """Return the full names of other nodes that are alive as far as known."""
        return {endpoint.node for endpoint in self.graph().endpoints}

    def _actions(self) -> list[tuple[str, str]]:
        """Return the action servers by name and type: those that have the service by which goals are sent."""
        return [
            (name.removesuffix(_SEND_GOAL), kind.removesuffix("_SendGoal"))
            for name, kinds in self._node.get_service_names_and_types()
            for kind in kinds
            if name.endswith(_SEND_GOAL)
        ]

    def publishers(self, topic: str) -> list[Endpoint]:
        """Return the publishers of other nodes on a topic."""
        return self._endpoints(topic, self._node.get_publishers_info_by_topic(topic))

    def subscriptions(self, topic: str) -> list[Endpoint]:
        """Return the subscriptions of other nodes to a topic."""
        return self._endpoints(topic, self._node.get_subscriptions_info_by_topic(topic))

    def clients_of(self, name: str) -> list[str]:
        """Return the nodes that have a client for a service of a node, and have not gone meanwhile."""
        found = []
        for node, namespace in self._node.get_node_names_and_namespaces():
            with suppress(RuntimeError):  # it has gone meanwhile
                clients = self._node.get_client_names_and_types_by_node(node, namespace)
                if any(service.rpartition("/")[0] == name for service, _ in clients):
                    found.append(f"{namespace.rstrip('/')}/{node}")
        return sorted(found)

    def known_to_all(self, topic: str, type_name: str) -> tuple[int, int]:
        """Return how many publishers and subscriptions of a type a topic has, our own and the dead included."""
        ways = (self._node.get_publishers_info_by_topic, self._node.get_subscriptions_info_by_topic)
        writers, readers = (sum(info.topic_type == type_name for info in way(topic)) for way in ways)
        return writers, readers

    def leave_out(self, belongs: Callable[[Endpoint], bool]) -> None:
        """Leave out what processes that have ended still have on the graph, given whether an endpoint is theirs."""
        until_s = time.monotonic() + LEASE_S  # what DDS has not forgotten by then is alive after all
        for endpoint in self.graph().endpoints:
            if belongs(endpoint):
                self._gone[endpoint.identity] = until_s

    def _endpoints(self, topic: str, infos: list[TopicEndpointInfo]) -> list[Endpoint]:
        return [
            Endpoint(
                topic,
                info.topic_type,
                identity,
                full_name(info),
                reliable=info.qos_profile.reliability is not ReliabilityPolicy.BEST_EFFORT,
                latched=info.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL,
            )
            for info in infos
            if self._gone.get(identity := bytes(info.endpoint_gid), 0.0) <= time.monotonic()
            and not identity.startswith(self._own)
        ]


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node that an endpoint belongs to, empty while discovery has not told it."""
    if info.node_name in ("", "_NODE_NAME_UNKNOWN_"):
        return ""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def resolve_node_name(node: Node, name: str) -> str:
    """Return the full name of another node; a relative one is of the namespace of `node`."""
    return name if name.startswith("/") else f"{node.get_namespace().rstrip('/')}/{name}"
