"""Watches a trial's ROS graph for what must not be there: others who speak for the simulator or the evaluator.

None of it can change a score where simulator and evaluator have a private line; it can mislead whoever looks on, and a
planner that tries is not to be ranked. What reads the truth, and a second sender of commands, is only remarked upon.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

from barn_eval.ros.adapter import TrialTopics
from barn_eval.ros.graph import LEASE_S, GraphView
from barn_eval.ros.readiness import Endpoint
from barn_eval.ros.session import Session, TrialEnded
from barn_eval.ros.simulator import SimulatorChannel
from barn_eval.trials.outcome import Outcome
from barn_worlds.base.errors import ConfigError

_UNNAMED = "an unnamed node"
_DISCOVERY_S = 3.0  # within which DDS has told of whoever was there before


@dataclass
class Integrity:
    """Judges endpoints by the process that they belong to, not by the names of their nodes, which anybody can take.

    channel: to the simulator. Without one the simulator is whoever has its name, and a second one is interference.
    ours: topics that only the evaluator publishes.
    """

    view: GraphView
    channel: SimulatorChannel | None
    simulator: str
    topics: TrialTopics
    ours: Collection[str]
    _remarks: set[str] = field(default_factory=set)
    _patience_s: float = LEASE_S

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

        if session.wait(speaker, _DISCOVERY_S) and not session.wait(lambda: not speaker(), LEASE_S):
            what = f"{speaker()} there, as only the trials' own simulator may"
            raise ConfigError(f"ROS_DOMAIN_ID {domain}: {what}; end it, or leave ROS_DOMAIN_ID unset")

    def require(self, session: Session) -> None:
        """Raise TrialEnded if somebody interferes."""
        # What DDS still shows of processes that were killed before there was this evaluator is given time to go; by
        # hand a simulator can be started afresh at any time.
        limit_s = self._patience_s
        self._patience_s = 0.0 if self.channel is not None else LEASE_S
        if not session.wait(lambda: not self.look(), limit_s):
            raise TrialEnded(Outcome.INTERFERENCE, self.look())

    def look(self) -> str:
        """Return in one line who interferes and how, an empty text if nobody does."""
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
        simulator = self.channel.participant if self.channel is not None else next(iter(named), b"")
        spoken = self._spoken()
        return _said(one for one in spoken if one.topic in self.ours or simulator not in (b"", one.participant))

    def _spoken(self) -> Iterator[Endpoint]:
        return (one for topic in (*self.topics.of_simulator, *self.ours) for one in self.view.publishers(topic))

    def _named(self) -> set[bytes]:
        named = (one for one in self._spoken() if one.topic in self.topics.of_simulator and one.node == self.simulator)
        return {endpoint.participant for endpoint in named}

    def _remark(self) -> None:
        readers = sorted({endpoint.node or _UNNAMED for endpoint in self.view.subscriptions(self.topics.truth)})
        if readers:
            self._remarks.add(f"{', '.join(readers)} subscribed to {self.topics.truth}")
        senders = [endpoint.node or _UNNAMED for endpoint in self.view.publishers(self.topics.command)]
        if len(senders) > 1:
            who = ", ".join(sorted(senders))
            self._remarks.add(f"{len(senders)} publishers on {self.topics.command}: {who}")


def _said(endpoints: Iterator[Endpoint]) -> str:
    return next((f"{one.node or _UNNAMED} publishes {one.topic}" for one in endpoints), "")
