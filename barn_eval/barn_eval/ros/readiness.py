"""What a planner lacks on the ROS graph before a trial, and what goes wrong during it.

Nothing in this module knows ROS or reads a clock: endpoints and times come in as plain
data.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from barn_eval.trials.result import Outcome
from barn_eval.trials.ros_config import WaitLimits
from barn_worlds.messages.topics import CMD_VEL, CMD_VEL_STAMPED, GOAL_POSE

# Bytes of a DDS GUID that the endpoints of a process have in common.
PARTICIPANT_BYTES = 12
TWIST = CMD_VEL.type_name
TWIST_STAMPED = CMD_VEL_STAMPED.type_name
POSE_STAMPED = GOAL_POSE.type_name
COMMAND_TYPES = {
    "auto": (TWIST, TWIST_STAMPED),
    "twist": (TWIST,),
    "twist_stamped": (TWIST_STAMPED,),
}
_PACE_WINDOW_S = 60.0  # over which the pace of a planner is judged


@dataclass(frozen=True)
class Endpoint:
    """A publisher or subscription as the graph shows it."""

    topic: str
    type_name: str
    # DDS GUID, unique among endpoints while it lives.
    identity: bytes
    # Full name of the node, empty while discovery has not told it.
    node: str = ""
    reliable: bool = True
    latched: bool = False

    @property
    def participant(self) -> bytes:
        """First 12 bytes of the DDS GUID, which all endpoints of a process share."""
        return self.identity[:PARTICIPANT_BYTES]


@dataclass(frozen=True)
class Graph:
    """The endpoints of all nodes but the evaluator."""

    publishers: Sequence[Endpoint] = ()
    subscriptions: Sequence[Endpoint] = ()
    # Name and type of each action server.
    actions: Sequence[tuple[str, str]] = ()

    @property
    def endpoints(self) -> tuple[Endpoint, ...]:
        """All publishers, then all subscriptions."""
        return (*self.publishers, *self.subscriptions)


@dataclass(frozen=True)
class Needs:
    """What a planner must offer."""

    command_topic: str
    # A key of COMMAND_TYPES.
    command_type: str = "auto"
    # Topics that it must subscribe to, with their types.
    inputs: Sequence[tuple[str, str]] = ()
    # Publishers of the evaluator itself, such as the goal's.
    offered: Sequence[Endpoint] = ()
    # Name and type of the action that takes the goal, if one does.
    action: tuple[str, str] | None = None
    # Full names of nodes that belong to no planner, such as the simulator's.
    known_nodes: Collection[str] = ()
    # Where the graph is looked at, for the message that no node is seen.
    surroundings: str = ""


@dataclass(frozen=True)
class Finding:
    """What the readiness gate sees of a planner."""

    # ROS type of the commands, empty while it is unknown or not allowed.
    command_type: str = ""
    # Full name of the node that sends commands.
    command_node: str = ""
    missing: tuple[str, ...] = ()
    outcome: Outcome = Outcome.PLANNER_NOT_READY
    command_reliable: bool = True
    # Whether a subscription is of a QoS that its publishers never offer.
    has_unfit_qos: bool = False

    def text(self) -> str:
        """Return what is missing, joined by "; "; empty if nothing is."""
        return "; ".join(self.missing)


class _Problem(NamedTuple):
    """Something missing or wrong on the graph."""

    text: str
    is_wrong_type: bool = False
    is_unfit_qos: bool = False


def inspect(graph: Graph, needs: Needs) -> Finding:
    """Return what the graph has and lacks of a planner's endpoints; wait for nothing.

    Args:
        graph: The endpoints of other nodes.
        needs: What the planner must offer.

    Returns:
        What the graph has of it, and what is missing.
    """
    commands = [
        endpoint
        for endpoint in graph.publishers
        if endpoint.topic == needs.command_topic
    ]
    types = sorted({endpoint.type_name for endpoint in commands})
    problems = [
        *_command_problems(graph, needs, types),
        *_input_problems(graph, needs),
        *_action_problems(graph, needs),
    ]

    missing = [problem.text for problem in problems]
    nodes = {endpoint.node for endpoint in graph.endpoints}
    # If only the simulator is in sight, the planner is probably on another domain or
    # out of discovery range, which no missing topic tells.
    if problems and nodes.issubset(needs.known_nodes):
        missing.append(f"no node of a planner is seen {needs.surroundings}".rstrip())

    command_type = ""
    if len(types) == 1 and types[0] in COMMAND_TYPES[needs.command_type]:
        command_type = types[0]
    outcome = Outcome.PLANNER_NOT_READY
    if any(problem.is_wrong_type for problem in problems):
        outcome = Outcome.WRONG_MESSAGE_TYPE
    return Finding(
        command_type,
        # The first by name, in whatever order discovery lists the publishers.
        min((endpoint.node for endpoint in commands), default=""),
        tuple(missing),
        outcome,
        all(endpoint.reliable for endpoint in commands),
        any(problem.is_unfit_qos for problem in problems),
    )


def _command_problems(
    graph: Graph, needs: Needs, types: Sequence[str]
) -> Iterator[_Problem]:
    """Yield what is wrong on the topic of commands: no publisher, or a wrong type."""
    topic = needs.command_topic
    accepted = COMMAND_TYPES[needs.command_type]
    if not types:
        text = f"no publisher on {topic}"
        # Velocities on another topic are most often a remapping that was forgotten.
        velocities = [
            (endpoint.topic, endpoint.type_name)
            for endpoint in graph.publishers
            if endpoint.type_name in (TWIST, TWIST_STAMPED)
        ]
        if velocities:
            other_topic, type_name = min(velocities)
            kind = short_type(type_name)
            text += f"; a {kind} publisher exists on {other_topic}: remap it"
        yield _Problem(text)
    elif len(types) > 1:
        yield _Problem(
            f"publishers of different types on {topic}: {_short_types(types)}", True
        )
    elif types[0] not in accepted:
        expected = " or ".join(map(short_type, accepted))
        yield _Problem(
            f"no publisher on {topic}; a {short_type(types[0])} publisher exists on"
            f" {topic}, but this run expects {expected}",
            True,
        )


def _input_problems(graph: Graph, needs: Needs) -> Iterator[_Problem]:
    """Yield topics with no subscription of the right type, or with unfit QoS."""
    publishers = (*graph.publishers, *needs.offered)
    for topic, type_name in needs.inputs:
        readers = [
            endpoint for endpoint in graph.subscriptions if endpoint.topic == topic
        ]
        if not readers:
            hint = _input_hint(graph, needs, type_name)
            yield _Problem(f"no subscription to {topic}{hint}")
            continue

        # A subscription of another type gets nothing, but shows that the planner is
        # there.
        typed_readers = [reader for reader in readers if reader.type_name == type_name]
        if not typed_readers:
            types = _short_types({short_type(reader.type_name) for reader in readers})
            yield _Problem(
                f"no subscription to {topic}; one of {types} exists, but it carries"
                f" {short_type(type_name)}",
                True,
            )
            continue

        writers = [endpoint for endpoint in publishers if endpoint.topic == topic]
        compatible = (
            _is_compatible(writer, reader)
            for writer in writers
            for reader in typed_readers
        )
        if writers and not any(compatible):
            quality = "transient local durability"
            remedy = "volatile durability (in rclpy depth 10 alone)"
            if typed_readers[0].reliable and not writers[0].reliable:
                quality = "reliable delivery"
                remedy = "best effort (in rclpy qos_profile_sensor_data)"
            yield _Problem(
                f"the subscription to {topic} asks for {quality}, which its publisher"
                f" does not offer; subscribe with {remedy}",
                is_unfit_qos=True,
            )


def _input_hint(graph: Graph, needs: Needs, type_name: str) -> str:
    """Return a message's end that says where the planner listens instead, or ""."""
    published = {endpoint.topic for endpoint in (*graph.publishers, *needs.offered)}
    idle_topics = []
    for endpoint in graph.subscriptions:
        is_idle = endpoint.topic not in published
        is_foreign = endpoint.node not in needs.known_nodes
        if endpoint.type_name == type_name and is_idle and is_foreign:
            idle_topics.append(endpoint.topic)
    if idle_topics:
        return (
            f"; a {short_type(type_name)} subscription exists on {min(idle_topics)}:"
            " remap it"
        )

    goal_actions = [
        name for name, kind in graph.actions if short_type(kind) == "NavigateToPose"
    ]
    if type_name == POSE_STAMPED and goal_actions:
        return f"; the action {min(goal_actions)} takes goals: set goal_by to action"
    return ""


def _action_problems(graph: Graph, needs: Needs) -> Iterator[_Problem]:
    """Yield a problem if the goal's action is missing or of another type."""
    if needs.action is None or needs.action in graph.actions:
        return
    name, type_name = needs.action
    kind = short_type(type_name)

    types = [action_type for action, action_type in graph.actions if action == name]
    if types:
        text = f"no action {name} of {kind}; one of {_short_types(types)} exists"
        yield _Problem(text, True)
        return

    text = f"no action {name}"
    names = [
        action for action, action_type in graph.actions if action_type == type_name
    ]
    if names:
        text += f"; a {kind} action exists as {min(names)}"
    yield _Problem(text)


def _is_compatible(writer: Endpoint, reader: Endpoint) -> bool:
    """Return whether a reader asks for no better QoS than its writer offers."""
    # A reader may ask for less than its writer offers, but never for more.
    is_reliable = writer.reliable or not reader.reliable
    is_durable = writer.latched or not reader.latched
    return is_reliable and is_durable


def short_type(type_name: str) -> str:
    """Return the last part of a ROS type: "Twist" of "geometry_msgs/msg/Twist"."""
    return type_name.rsplit("/", 1)[-1]


def _short_types(type_names: Iterable[str]) -> str:
    """Return the last parts of ROS types in one text, sorted, joined by commas."""
    return ", ".join(short_type(name) for name in sorted(type_names))


class Watchdog:
    """Tells when simulator or planner has exceeded a wait limit in a trial."""

    def __init__(
        self,
        patience: WaitLimits,
        now_s: float,
        commands: int = 0,
        tick: str = "no tick of /clock",
    ):
        """Start the watch of a trial.

        Args:
            patience: Limits of waits.
            now_s: The evaluator's time, by which limits count.
            commands: Number of commands that came before the trial.
            tick: Text for simulated time that stands still, without its duration.
        """
        self._tick = tick
        self._patience = patience
        self._start_s = now_s
        self._last_tick_s = now_s
        self._last_command_s = now_s
        self._last_publisher_s = now_s
        self._ticks = 0
        self._commands = commands
        self._commands_before = commands
        self._window = _PaceWindow(now_s, 0.0, 0.0)

    def hear(self, now_s: float, ticks: int, commands: int) -> None:
        """Note how many ticks and commands have come so far, and when they last did.

        Args:
            now_s: The evaluator's time.
            ticks: Number of ticks of simulated time.
            commands: Number of commands.
        """
        if ticks > self._ticks:
            self._ticks = ticks
            self._last_tick_s = now_s
        if commands > self._commands:
            self._commands = commands
            self._last_command_s = now_s

    def is_clock_standing(self, now_s: float) -> bool:
        """Return whether simulated time has stood still for most of `command_s`."""
        return now_s - self._last_tick_s > 0.9 * self._patience.command_s

    def publisher_seen(self, now_s: float) -> None:
        """Note that at this time the graph has the planner's publisher of commands."""
        self._last_publisher_s = now_s

    def judge(
        self,
        now_s: float,
        *,
        has_started: bool,
        simulated_s: float = 0.0,
        waited_s: float = 0.0,
    ) -> tuple[Outcome, str] | None:
        """Return outcome and detail if something hangs or takes too long, else None.

        Once a minute it also judges the pace of the planner, and begins anew.

        Args:
            now_s: The evaluator's time.
            has_started: Whether the robot has made its first motion.
            simulated_s: Simulated time of the trial so far.
            waited_s: Wall-clock time so far in which the planner owed an answer to a
                scan.
        """
        patience = self._patience
        if now_s - self._last_tick_s > patience.clock_s:
            detail = f"{self._tick} for {patience.clock_s:g} s"
            return Outcome.SIMULATOR_DIED, detail
        if now_s - self._last_publisher_s > patience.vanished_s:
            detail = "its publisher of commands has vanished from the graph"
            return Outcome.PLANNER_DIED, detail

        # A planner owes nothing until time goes on after its last command: it may be
        # the simulator that is stuck.
        owes_command = self._last_tick_s > self._last_command_s
        if owes_command and now_s - self._last_command_s > patience.command_s:
            detail = f"no command for {patience.command_s:g} s of wall-clock time"
            if has_started:
                return Outcome.PLANNER_STALLED, detail
            if self._commands == self._commands_before:
                detail += ", none since the trial began"
            return Outcome.NO_FIRST_MOTION, detail

        slowness = self._describe_slowness(_PaceWindow(now_s, simulated_s, waited_s))
        if now_s - self._start_s > patience.trial_s:
            slowness = f"no verdict after {patience.trial_s:g} s of wall-clock time"
        if slowness:
            return Outcome.PLANNER_STALLED, slowness
        return None

    def _describe_slowness(self, now: "_PaceWindow") -> str:
        """Every 60 s, return how slow the planner was in them; "" if fast or before."""
        start = self._window
        duration_s = now.time_s - start.time_s
        # Over a short time, a first compilation of kernels would look like slowness.
        if duration_s < _PACE_WINDOW_S:
            return ""
        self._window = now

        simulated_s = now.simulated_s - start.simulated_s
        slowness = self._patience.slowness
        # The planner is slow only if it owed answers for half of the window.
        owed_s = now.waited_s - start.waited_s
        if simulated_s * slowness > duration_s or owed_s < 0.5 * duration_s:
            return ""
        return (
            f"{duration_s:.0f} s of wall-clock time for {simulated_s:.2f} simulated"
            f" seconds: more than {slowness:g} s per simulated second"
        )


class _PaceWindow(NamedTuple):
    """A moment from which the pace of a planner is measured."""

    time_s: float
    simulated_s: float
    waited_s: float
