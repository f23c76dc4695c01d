"""The ROS graph as the readiness gate sees it, and who must not be on it."""

import time
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from barn_eval.ros.adapter import TrialTopics
from barn_eval.ros.evaluator_loop import EvaluatorLoop, TrialEnded
from barn_eval.ros.readiness import PARTICIPANT_BYTES, Endpoint, Graph
from barn_eval.ros.simulator import SimulatorChannel
from barn_eval.trials.result import Outcome
from barn_worlds.base.errors import ConfigError
from barn_worlds.ros.topics import read_endpoint_identity

LEASE_S = 30.0  # DDS forgets a process that was killed after some 20 s
_UNNAMED = "an unnamed node"
# Most that a trial's graph may have; Nav2 has some 100, 250 and 30.
_MAX_TOPICS = 1000
_MAX_SERVICES = 4000
_MAX_NODES = 300
# Within this time DDS tells of whoever is there, and forgets those killed before.
_DISCOVERY_S = 3.0
_SEND_GOAL = "/_action/send_goal"


class GraphView:
    """Shows the endpoints of other nodes, without processes known to have died.

    Until DDS forgets those, a planner that is started in place of another would seem
    to be there before it is.
    """

    def __init__(self, node: Node):
        """Look at the graph through a node; its own process is left out."""
        self._node = node
        self._participant = read_endpoint_identity(node)[:PARTICIPANT_BYTES]
        # Participants that are left out, with the monotonic time until when.
        self._dead: dict[bytes, float] = {}

    def crowd(self) -> str:
        """Return which of topics, services and nodes are too many, or an empty string.

        The time for a look grows with the square of these numbers, and anybody can
        make them grow.
        """
        node = self._node
        limits = (
            (len(node.get_topic_names_and_types()), _MAX_TOPICS, "topics"),
            (len(node.get_service_names_and_types()), _MAX_SERVICES, "services"),
            (len(node.get_node_names()), _MAX_NODES, "nodes"),
        )
        return "; ".join(
            f"{count} {kind} are on the graph, more than {limit}"
            for count, limit, kind in limits
            if count > limit
        )

    def graph(self) -> Graph:
        """Return endpoints of other processes not known to be dead, and all actions."""
        publishers: list[Endpoint] = []
        subscriptions: list[Endpoint] = []
        for topic, _ in self._node.get_topic_names_and_types():
            publishers += self.publishers(topic)
            subscriptions += self.subscriptions(topic)
        # An action server is known by its service for goals.
        actions = []
        for name, kinds in self._node.get_service_names_and_types():
            if name.endswith(_SEND_GOAL):
                action = name.removesuffix(_SEND_GOAL)
                actions += [(action, kind.removesuffix("_SendGoal")) for kind in kinds]
        return Graph(publishers, subscriptions, actions)

    def nodes(self) -> set[str]:
        """Return full names of live nodes that have endpoints, "" for unknown ones."""
        return {endpoint.node for endpoint in self.graph().endpoints}

    def publishers(self, topic: str) -> list[Endpoint]:
        """Return the publishers on a topic, given in full, of other live processes."""
        return self._endpoints(topic, self._node.get_publishers_info_by_topic(topic))

    def subscriptions(self, topic: str) -> list[Endpoint]:
        """Return the subscriptions to a topic, given in full, of other processes."""
        return self._endpoints(topic, self._node.get_subscriptions_info_by_topic(topic))

    def clients_of(self, node_name: str) -> list[str]:
        """Return sorted names of others' live nodes that have a client for a node.

        Of nodes with one name, one of which may have died, DDS only tells apart the
        writers of requests.
        """
        # A node counts once, however many clients it has.
        names = set()
        for service, _ in self._node.get_service_names_and_types():
            if service.rpartition("/")[0] == node_name:
                # A service is a pair of DDS topics. Clients are the publishers of its
                # requests.
                infos = self._node.get_publishers_info_by_topic(
                    f"rq{service}Request", no_mangle=True
                )
                for client in self._endpoints(service, infos):
                    names.add(client.node or _UNNAMED)
        return sorted(names)

    def leave_out(self, belongs: Callable[[Endpoint], bool]) -> None:
        """Hide processes that own an endpoint for which `belongs` is true, for 30 s.

        Args:
            belongs: Returns whether an endpoint is that process's.
        """
        # What DDS has not forgotten by then is alive after all.
        until_s = time.monotonic() + LEASE_S
        for topic, _ in self._node.get_topic_names_and_types()[:_MAX_TOPICS]:
            for endpoint in (*self.publishers(topic), *self.subscriptions(topic)):
                if belongs(endpoint):
                    self._dead[endpoint.participant] = until_s

    def _endpoints(self, topic: str, infos: list[TopicEndpointInfo]) -> list[Endpoint]:
        """Convert ROS infos on a topic's endpoints; leave out own and dead ones."""
        endpoints = []
        for info in infos:
            identity = bytes(info.endpoint_gid)
            participant = identity[:PARTICIPANT_BYTES]
            is_dead = self._dead.get(participant, 0.0) > time.monotonic()
            if is_dead or participant == self._participant:
                continue
            qos = info.qos_profile
            endpoints.append(
                Endpoint(
                    topic,
                    info.topic_type,
                    identity,
                    _full_name(info),
                    reliable=qos.reliability is not ReliabilityPolicy.BEST_EFFORT,
                    latched=qos.durability is DurabilityPolicy.TRANSIENT_LOCAL,
                )
            )
        return endpoints


def _full_name(info: TopicEndpointInfo) -> str:
    """Return namespace and name of an endpoint's node, empty while they are unknown."""
    # The middleware may hear of an endpoint before it hears of the endpoint's node.
    if info.node_name in ("", "_NODE_NAME_UNKNOWN_"):
        return ""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def resolve_node_name(node: Node, name: str) -> str:
    """Return a node's name from the root; a relative one is in `node`'s namespace.

    Args:
        node: A relative name is in the namespace of this node.
        name: Full or relative name.

    Returns:
        The name from the root.
    """
    if name.startswith("/"):
        return name
    return f"{node.get_namespace().rstrip('/')}/{name}"


@dataclass
class Integrity:
    """Watches a trial's graph for nodes that speak for the simulator or the evaluator.

    None of it can change a score where simulator and evaluator have a private line; it
    can mislead whoever looks on, and a planner that tries is not ranked. Subscriptions
    to the true pose and a second publisher of commands are only remarked upon.
    Endpoints are judged by their process: anybody can take the name of a node.
    """

    view: GraphView
    # To the simulator. Without it the simulator is whoever has its name, and a second
    # one is interference.
    channel: SimulatorChannel | None
    # Full name of the simulator node.
    simulator: str
    topics: TrialTopics
    # Topics that only the evaluator publishes.
    evaluator_topics: Collection[str]
    _remarks: set[str] = field(init=False, default_factory=set)

    @property
    def remarks(self) -> str:
        """Remarks on this trial for its row, joined by "; "; they change no verdict."""
        return "; ".join(sorted(self._remarks))

    def begin(self) -> None:
        """Forget remarks and forbidden requests of the trial before."""
        # Remarks belong to a row, and so to one trial.
        self._remarks.clear()
        if self.channel is not None:
            self.channel.interference.clear()

    def require_alone(self, loop: EvaluatorLoop, domain: str) -> None:
        """Wait up to 6 s; ConfigError if others publish what only the suite may.

        This is before simulator and evaluator begin; it waits up to 6 s for discovery.

        Args:
            loop: Spends the time of waits.
            domain: ROS domain, for the message.

        Raises:
            ConfigError: If a node still does so after the wait.
        """

        def describe_speaker() -> str:
            """Return who publishes on a protected topic, empty if nobody does."""
            return _describe_publisher(self._publishers_to_protect())

        if loop.wait(describe_speaker, _DISCOVERY_S) and not loop.wait(
            lambda: not describe_speaker(), _DISCOVERY_S
        ):
            raise ConfigError(
                f"ROS_DOMAIN_ID {domain}: {describe_speaker()} there, but only the trials'"
                " simulator may do so; stop that process, or leave ROS_DOMAIN_ID unset"
            )

    def require(self, loop: EvaluatorLoop) -> None:
        """End the trial as INTERFERENCE if `look` finds any, by hand for 30 s."""
        # By hand, another simulator may have taken the place of one that DDS still
        # shows: it has time to go.
        limit_s = LEASE_S if self.channel is None else 0.0
        if not loop.wait(lambda: not self.look(), limit_s):
            raise TrialEnded(Outcome.INTERFERENCE, self.look())

    def look(self) -> str:
        """Return who interferes, or what is too crowded, else ""; add to `remarks`.

        Remarks on other nodes are added to `remarks`.
        """
        crowd = self.view.crowd()
        if crowd:
            return crowd
        self._update_remarks()
        return self._forbidden_request() or self._foreign_publisher()

    def _forbidden_request(self) -> str:
        """Return the first forbidden request, after who may have made it; or ""."""
        if self.channel is None or not self.channel.interference:
            return ""
        nodes = ", ".join(self.view.clients_of(self.simulator)) or _UNNAMED
        return f"{nodes} {self.channel.interference[0]}"

    def _foreign_publisher(self) -> str:
        """Return who publishes as simulator or evaluator, or has its name; or ""."""
        # By hand, the simulator is known by its name only, which anybody may take.
        participants = set()
        for endpoint in self._publishers_to_protect():
            is_simulated = endpoint.topic in self.topics.of_simulator
            if is_simulated and endpoint.node == self.simulator:
                participants.add(endpoint.participant)
        if len(participants) > 1:
            return f"{len(participants)} nodes are named {self.simulator}"

        # Without a private line, the node's name is all that is known of the simulator.
        # While no node has the name, nobody counts as foreign.
        simulator = next(iter(participants), b"")
        if self.channel is not None:
            simulator = self.channel.participant
        return _describe_publisher(
            endpoint
            for endpoint in self._publishers_to_protect()
            if endpoint.topic in self.evaluator_topics
            or simulator not in (b"", endpoint.participant)
        )

    def _publishers_to_protect(self) -> Iterator[Endpoint]:
        """Yield all publishers on topics that only simulator and evaluator may use."""
        for topic in (*self.topics.of_simulator, *self.evaluator_topics):
            yield from self.view.publishers(topic)

    def _update_remarks(self) -> None:
        """Add remarks on readers of the true pose and on several command senders."""
        truth = self.topics.truth
        readers = _node_names(self.view.subscriptions(truth))
        if readers:
            names = ", ".join(sorted(set(readers)))
            self._remarks.add(f"{names} subscribed to {truth}")

        command = self.topics.command
        senders = _node_names(self.view.publishers(command))
        if len(senders) > 1:
            names = ", ".join(sorted(senders))
            self._remarks.add(f"{len(senders)} publishers on {command}: {names}")


def _node_names(endpoints: Iterable[Endpoint]) -> list[str]:
    """Return the name of each endpoint's node, "an unnamed node" if it is unknown."""
    return [endpoint.node or _UNNAMED for endpoint in endpoints]


def _describe_publisher(endpoints: Iterable[Endpoint]) -> str:
    """Return "NODE publishes TOPIC" of the first endpoint, empty if there is none."""
    for endpoint in endpoints:
        return f"{endpoint.node or _UNNAMED} publishes {endpoint.topic}"
    return ""
