"""Diagnoses in words: what of a planner is missing on the ROS graph before a trial, and what goes wrong during it.

Nothing here knows ROS or reads a clock: endpoints and times come in as plain data, so that each is tested alone.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field

from barn_eval.trials.outcome import Outcome
from barn_eval.trials.ros_config import WaitLimits
from barn_worlds.messages.topics import CMD_VEL, CMD_VEL_STAMPED, GOAL_POSE

PARTICIPANT_BYTES = 12  # of a DDS GUID: what the endpoints of a process have in common
TWIST, TWIST_STAMPED, POSE_STAMPED = (
    CMD_VEL.type_name,
    CMD_VEL_STAMPED.type_name,
    GOAL_POSE.type_name,
)
ACCEPTED = {
    "auto": (TWIST, TWIST_STAMPED),
    "twist": (TWIST,),
    "twist_stamped": (TWIST_STAMPED,),
}


@dataclass(frozen=True)
class Endpoint:
    """A publisher or subscription as the graph shows it."""

    topic: str
    type_name: str
    identity: bytes  # which tells it from any other for as long as it lives
    node: str = ""  # full name, empty while not known
    reliable: bool = True
    latched: bool = False

    @property
    def participant(self) -> bytes:
        """The part of the identity that tells its process from any other."""
        return self.identity[:PARTICIPANT_BYTES]


@dataclass(frozen=True)
class Graph:
    """The endpoints of all nodes but the evaluator's own, and the action servers as (name, type)."""

    publishers: Sequence[Endpoint] = ()
    subscriptions: Sequence[Endpoint] = ()
    actions: Sequence[tuple[str, str]] = ()

    @property
    def endpoints(self) -> tuple[Endpoint, ...]:
        """All of them."""
        return (*self.publishers, *self.subscriptions)


@dataclass(frozen=True)
class Needs:
    """What a planner must offer: a publisher of commands, and subscriptions to topics of types."""

    command_topic: str
    command_type: str = "auto"
    inputs: Sequence[tuple[str, str]] = field(default_factory=tuple)
    offered: Sequence[
        Endpoint
    ] = ()  # publishers of the evaluator itself, such as that of the goal
    action: tuple[str, str] | None = (
        None  # name and type of the action that takes the goal, if one does
    )
    known_nodes: Collection[
        str
    ] = ()  # full names of nodes that are no planner's, such as the simulator's
    surroundings: str = ""  # where the graph is looked at, for when nobody is there


@dataclass(frozen=True)
class Finding:
    """What the gate sees: type, reliability and sender of the commands once known, and everything still missing."""

    command_type: str = ""
    command_node: str = ""
    missing: tuple[str, ...] = ()
    outcome: Outcome = Outcome.PLANNER_NOT_READY
    command_reliable: bool = True

    def text(self) -> str:
        """Return what is missing as one line."""
        return "; ".join(self.missing)


def inspect(graph: Graph, needs: Needs) -> Finding:
    """Return what of the needs the graph meets."""
    commands = [
        endpoint
        for endpoint in graph.publishers
        if endpoint.topic == needs.command_topic
    ]
    types = sorted({endpoint.type_name for endpoint in commands})
    faults = [
        *_command_faults(graph, needs, types),
        *_input_faults(graph, needs),
        *_action_faults(graph, needs),
    ]
    missing = [text for text, _ in faults]
    if faults and all(
        endpoint.node in needs.known_nodes for endpoint in graph.endpoints
    ):
        missing.append(f"no node of a planner is seen {needs.surroundings}".rstrip())
    return Finding(
        types[0]
        if len(types) == 1 and types[0] in ACCEPTED[needs.command_type]
        else "",
        min((endpoint.node for endpoint in commands), default=""),
        tuple(missing),
        Outcome.WRONG_MESSAGE_TYPE
        if any(wrong for _, wrong in faults)
        else Outcome.PLANNER_NOT_READY,
        all(endpoint.reliable for endpoint in commands),
    )


_Faults = Iterator[tuple[str, bool]]  # what is missing, and whether a type is wrong


def _command_faults(graph: Graph, needs: Needs, types: Sequence[str]) -> _Faults:
    topic, accepted = needs.command_topic, ACCEPTED[needs.command_type]
    if not types:
        velocities = (
            one for one in graph.publishers if one.type_name in (TWIST, TWIST_STAMPED)
        )
        found = min(((one.topic, one.type_name) for one in velocities), default=None)
        hint = (
            f"; a {short(found[1])} publisher exists on {found[0]}, remap it"
            if found
            else ""
        )
        yield f"no publisher on {topic}{hint}", False
    elif len(types) > 1:
        yield (
            f"publishers of different types on {topic}: {', '.join(map(short, types))}",
            True,
        )
    elif types[0] not in accepted:
        expected = " or ".join(map(short, accepted))
        exists = f"a {short(types[0])} publisher exists on {topic}, this run expects {expected}"
        yield f"no publisher on {topic}; {exists}", True


def _input_faults(graph: Graph, needs: Needs) -> _Faults:
    served = (*graph.publishers, *needs.offered)
    for topic, type_name in needs.inputs:
        readers = [
            endpoint for endpoint in graph.subscriptions if endpoint.topic == topic
        ]
        right = [endpoint for endpoint in readers if endpoint.type_name == type_name]
        writers = [endpoint for endpoint in served if endpoint.topic == topic]
        if not readers:
            yield (
                f"no subscription to {topic}{_read_elsewhere(graph, needs, type_name)}",
                False,
            )
        elif not right:
            found = ", ".join(
                sorted({short(endpoint.type_name) for endpoint in readers})
            )
            yield (
                f"no subscription to {topic}; one of {found} exists, it carries {short(type_name)}",
                True,
            )
        elif writers and not any(
            _compatible(writer, reader) for writer in writers for reader in right
        ):
            unsure = right[0].reliable and not writers[0].reliable
            asked = "reliable delivery" if unsure else "transient local durability"
            yield (
                f"the subscription to {topic} asks for {asked}, which its publisher does not offer",
                False,
            )


def _read_elsewhere(graph: Graph, needs: Needs, type_name: str) -> str:
    fed = {endpoint.topic for endpoint in (*graph.publishers, *needs.offered)}
    idle = (
        one
        for one in graph.subscriptions
        if one.type_name == type_name and one.topic not in fed
    )
    if found := min(
        (one.topic for one in idle if one.node not in needs.known_nodes), default=""
    ):
        return f"; a {short(type_name)} subscription exists on {found}, remap it"
    takers = sorted(
        name for name, kind in graph.actions if short(kind) == "NavigateToPose"
    )
    if type_name == POSE_STAMPED and takers:
        return f"; the action {takers[0]} takes goals, set goal_by to action"
    return ""


def _action_faults(graph: Graph, needs: Needs) -> _Faults:
    if needs.action is None or needs.action in graph.actions:
        return
    name, type_name = needs.action
    other = min(
        (action for action, kind in graph.actions if kind == type_name), default=""
    )
    if found := sorted(kind for action, kind in graph.actions if action == name):
        yield (
            f"no action {name} of {short(type_name)}; one of {', '.join(map(short, found))} exists",
            True,
        )
    else:
        yield (
            f"no action {name}"
            + (f"; a {short(type_name)} action exists as {other}" if other else ""),
            False,
        )


def _compatible(writer: Endpoint, reader: Endpoint) -> bool:
    return (writer.reliable or not reader.reliable) and (
        writer.latched or not reader.latched
    )


def short(type_name: str) -> str:
    """Return the last part of a type's name."""
    return type_name.rsplit("/", 1)[-1]


_WINDOW_S = 60.0  # over which the pace of a planner is judged


class Watchdog:
    """Tell when patience is at an end during a trial, before which so many commands had come."""

    def __init__(self, patience: WaitLimits, now_s: float, commands: int = 0) -> None:
        self._patience = patience
        self._began_s = self._ticked_s = self._commanded_s = self._publisher_s = now_s
        self._ticks, self._commands, self._commands_before = 0, commands, commands
        self._window = (now_s, 0.0, 0.0)

    def hear(self, now_s: float, ticks: int, commands: int) -> None:
        """Note how many ticks of the simulated time, and how many commands, have come so far."""
        if ticks > self._ticks:
            self._ticks, self._ticked_s = ticks, now_s
        if commands > self._commands:
            self._commands, self._commanded_s = commands, now_s

    def publisher_seen(self, now_s: float) -> None:
        """Note that the planner's publisher of commands is on the graph."""
        self._publisher_s = now_s

    def judge(
        self,
        now_s: float,
        *,
        moved: bool,
        simulated_s: float = 0.0,
        waited_s: float = 0.0,
    ) -> tuple[Outcome, str] | None:
        """Return what has gone wrong, if anything has.

        moved: whether the robot has made its first motion. simulated_s: so far; waited_s: wall-clock time in which the
        planner owed an answer to a scan, so far.
        """
        patience = self._patience
        if now_s - self._ticked_s > patience.clock_s:
            return (
                Outcome.SIMULATOR_DIED,
                f"no tick of /clock for {patience.clock_s:g} s",
            )
        if now_s - self._publisher_s > patience.vanished_s:
            return (
                Outcome.PLANNER_DIED,
                "its publisher of commands has vanished from the graph",
            )
        # a planner owes nothing until time goes on after its last command: it may be the simulator that is stuck
        if (
            self._ticked_s > self._commanded_s
            and now_s - self._commanded_s > patience.command_s
        ):
            waited = f"no command for {patience.command_s:g} s of wall-clock time"
            since = (
                ""
                if self._commands > self._commands_before
                else ", none since the trial began"
            )
            return (
                (Outcome.PLANNER_STALLED, waited)
                if moved
                else (Outcome.NO_FIRST_MOTION, waited + since)
            )
        slow = self._slowness(now_s, simulated_s, waited_s)
        if now_s - self._began_s > patience.trial_s:
            slow = f"no verdict after {patience.trial_s:g} s of wall-clock time"
        return (Outcome.PLANNER_STALLED, slow) if slow else None

    def _slowness(self, now_s: float, simulated_s: float, waited_s: float) -> str:
        """Return how slow the planner was in the last minute, empty if it was fast enough or that is not over."""
        began_s, before_s, owed_s = self._window
        lasted_s, progress_s = now_s - began_s, simulated_s - before_s
        if lasted_s < _WINDOW_S:
            return ""
        self._window = (now_s, simulated_s, waited_s)
        if (
            progress_s * self._patience.slowness > lasted_s
            or waited_s - owed_s < 0.5 * lasted_s
        ):
            return ""
        most = f"more than {self._patience.slowness:g} s per simulated second"
        return f"{lasted_s:.0f} s of wall-clock time for {progress_s:.2f} simulated seconds: {most}"
