"""The ROS graph as the readiness gate wants to see it, and who must not be on it."""

import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from barn_eval.ros.adapter import TrialTopics
from barn_eval.ros.readiness import PARTICIPANT_BYTES, Endpoint, Graph
from barn_eval.ros.session import Session, TrialEnded
from barn_eval.ros.simulator import SimulatorChannel
from barn_eval.trials.outcome import Outcome
from barn_worlds.base.errors import ConfigError
from barn_worlds.ros.topics import read_endpoint_identity

LEASE_S = 30.0  # DDS forgets a process that was killed after some 20 s
_UNNAMED = "an unnamed node"
_MOST_TOPICS, _MOST_SERVICES, _MOST_NODES = (
    1000,
    4000,
    300,
)  # on the graph of a trial; Nav2 has some 100, 250 and 30
_DISCOVERY_S = 3.0  # within which DDS has told of whoever is there, and not of those killed before it was asked
_SEND_GOAL = "/_action/send_goal"


class GraphView:
    """Sees the endpoints of other nodes, less those of processes known to have died.

    Until DDS forgets those, a planner that is started in place of another would seem to be there before it is.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._own = read_endpoint_identity(node)[:PARTICIPANT_BYTES]
        self._gone: dict[
            bytes, float
        ] = {}  # participants, and until when they are left out

    def crowd(self) -> str:
        """Return of what there is more than can be looked at in a moment, in words; empty if of nothing.

        The time for a look grows with the square of these numbers, and anybody can make them grow.
        """
        counted = (
            (len(self._node.get_topic_names_and_types()), _MOST_TOPICS, "topics"),
            (len(self._node.get_service_names_and_types()), _MOST_SERVICES, "services"),
            (len(self._node.get_node_names()), _MOST_NODES, "nodes"),
        )
        return "; ".join(
            f"{count} {what} are on the graph, more than {most}"
            for count, most, what in counted
            if count > most
        )

    def graph(self) -> Graph:
        """Return all endpoints of other nodes that are alive as far as known."""
        topics = [topic for topic, _ in self._node.get_topic_names_and_types()]
        publishers = [
            endpoint for topic in topics for endpoint in self.publishers(topic)
        ]
        return Graph(
            publishers,
            [one for topic in topics for one in self.subscriptions(topic)],
            self._actions(),
        )

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
        """Return the nodes that have a client for a service of a node, those known to have died left out.

        Of several nodes of one name, one of which may have died, DDS only tells apart the writers of requests.
        """
        services = [
            one
            for one, _ in self._node.get_service_names_and_types()
            if one.rpartition("/")[0] == name
        ]
        writers = self._node.get_publishers_info_by_topic
        clients = [
            self._endpoints(one, writers(f"rq{one}Request", no_mangle=True))
            for one in services
        ]
        return sorted(
            {client.node or _UNNAMED for of_one in clients for client in of_one}
        )

    def known_to_all(self, topic: str, type_name: str) -> tuple[int, int]:
        """Return how many publishers and subscriptions of a type a topic has, our own and the dead included."""
        ways = (
            self._node.get_publishers_info_by_topic,
            self._node.get_subscriptions_info_by_topic,
        )
        writers, readers = (
            sum(info.topic_type == type_name for info in way(topic)) for way in ways
        )
        return writers, readers

    def leave_out(self, belongs: Callable[[Endpoint], bool]) -> None:
        """Leave out what processes that have ended still have on the graph, given whether an endpoint is theirs."""
        until_s = (
            time.monotonic() + LEASE_S
        )  # what DDS has not forgotten by then is alive after all
        topics = [topic for topic, _ in self._node.get_topic_names_and_types()][
            :_MOST_TOPICS
        ]
        for endpoint in (
            one
            for topic in topics
            for one in (*self.publishers(topic), *self.subscriptions(topic))
        ):
            if belongs(endpoint):
                self._gone[endpoint.participant] = until_s

    def _endpoints(self, topic: str, infos: list[TopicEndpointInfo]) -> list[Endpoint]:
        return [
            Endpoint(
                topic,
                info.topic_type,
                identity,
                full_name(info),
                reliable=info.qos_profile.reliability
                is not ReliabilityPolicy.BEST_EFFORT,
                latched=info.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL,
            )
            for info in infos
            if self._gone.get(
                (identity := bytes(info.endpoint_gid))[:PARTICIPANT_BYTES], 0.0
            )
            <= time.monotonic()
            and not identity.startswith(self._own)
        ]


def full_name(info: TopicEndpointInfo) -> str:
    """Return the full name of the node that an endpoint belongs to, empty while discovery has not told it."""
    if info.node_name in ("", "_NODE_NAME_UNKNOWN_"):
        return ""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def resolve_node_name(node: Node, name: str) -> str:
    """Return the full name of another node; a relative one is of the namespace of `node`."""
    return (
        name if name.startswith("/") else f"{node.get_namespace().rstrip('/')}/{name}"
    )


@dataclass
class Integrity:
    """Watches a trial's graph for others who speak for the simulator or the evaluator.

    None of it can change a score where simulator and evaluator have a private line; it can mislead whoever looks on,
    and a planner that tries is not to be ranked. What reads the truth, and a second sender of commands, is only
    remarked upon. Endpoints are judged by their process, not by the names of nodes, which anybody can take.

    channel: to the simulator. Without one the simulator is whoever has its name, and a second one is interference.
    ours: topics that only the evaluator publishes.
    """

    view: GraphView
    channel: SimulatorChannel | None
    simulator: str
    topics: TrialTopics
    ours: Collection[str]
    _remarks: set[str] = field(default_factory=set)

    @property
    def remarks(self) -> str:
        """What is to be known of the trial so far beside its verdict, in one line; empty if nothing is."""
        return "; ".join(sorted(self._remarks))

    def begin(self) -> None:
        """Forget what was before a trial."""
        self._remarks.clear()
        if self.channel is not None:
            self.channel.interference.clear()

    def require_alone(self, session: Session, domain: str) -> None:
        """Raise ConfigError if anybody speaks for simulator or evaluator before they, and the planner, have begun."""

        def speaker() -> str:
            return _said(self._spoken())

        if session.wait(speaker, _DISCOVERY_S) and not session.wait(
            lambda: not speaker(), _DISCOVERY_S
        ):
            what = f"{speaker()} there, as only the trials' own simulator may"
            raise ConfigError(
                f"ROS_DOMAIN_ID {domain}: {what}; end it, or leave ROS_DOMAIN_ID unset"
            )

    def require(self, session: Session) -> None:
        """Raise TrialEnded if somebody interferes."""
        # what DDS shows of a simulator is given time to go where, by hand, another may have been started in its place
        if not session.wait(
            lambda: not self.look(), LEASE_S if self.channel is None else 0.0
        ):
            raise TrialEnded(Outcome.INTERFERENCE, self.look())

    def look(self) -> str:
        """Return in one line who interferes and how, an empty text if nobody does."""
        if crowd := self.view.crowd():
            return crowd
        self._remark()
        return self._deed() or self._foreign_publisher()

    def _deed(self) -> str:
        if self.channel is None or not self.channel.interference:
            return ""
        who = ", ".join(self.view.clients_of(self.simulator)) or _UNNAMED
        return f"{who} {self.channel.interference[0]}"

    def _foreign_publisher(self) -> str:
        named = self._named()
        if len(named) > 1:
            return f"{len(named)} nodes are named {self.simulator}"
        simulator = (
            self.channel.participant
            if self.channel is not None
            else next(iter(named), b"")
        )
        spoken = self._spoken()
        return _said(
            one
            for one in spoken
            if one.topic in self.ours or simulator not in (b"", one.participant)
        )

    def _spoken(self) -> Iterator[Endpoint]:
        return (
            one
            for topic in (*self.topics.of_simulator, *self.ours)
            for one in self.view.publishers(topic)
        )

    def _named(self) -> set[bytes]:
        named = (
            one
            for one in self._spoken()
            if one.topic in self.topics.of_simulator and one.node == self.simulator
        )
        return {endpoint.participant for endpoint in named}

    def _remark(self) -> None:
        readers = sorted(
            {
                endpoint.node or _UNNAMED
                for endpoint in self.view.subscriptions(self.topics.truth)
            }
        )
        if readers:
            self._remarks.add(f"{', '.join(readers)} subscribed to {self.topics.truth}")
        senders = [
            endpoint.node or _UNNAMED
            for endpoint in self.view.publishers(self.topics.command)
        ]
        if len(senders) > 1:
            who = ", ".join(sorted(senders))
            self._remarks.add(
                f"{len(senders)} publishers on {self.topics.command}: {who}"
            )


def _said(endpoints: Iterator[Endpoint]) -> str:
    return next(
        (f"{one.node or _UNNAMED} publishes {one.topic}" for one in endpoints), ""
    )
