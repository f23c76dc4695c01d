"""Managed (lifecycle) nodes of others, which are waited for before the first trial."""

import time
from collections.abc import Sequence

from lifecycle_msgs.srv import GetState

from barn_eval.ros.graph import resolve_node_name
from barn_eval.ros.remote import RemoteNode, Silent
from barn_eval.ros.station import PLANNER, Station, TrialEnded
from barn_eval.trials.outcome import Outcome

_ACTIVE = "active"
_LOOK_S = 0.25  # between two rounds of questions
_ANSWER_S = 2.0
_TELL_S = 5.0  # between two notes on what is waited for


class LifecycleNodes:
    """Asks managed nodes for their state."""

    def __init__(self, station: Station, names: Sequence[str]) -> None:
        self._station = station
        self._nodes = [RemoteNode(station, resolve_node_name(station.node, name), PLANNER) for name in names]

    def waiting_for(self) -> list[str]:
        """Return a phrase for each node that is not active now; TrialEnded if the planner's process ends meanwhile."""
        return [phrase for node in self._nodes if (phrase := _missing(node))]

    def await_active(self, limit_s: float) -> None:
        """Return once all nodes are active; TrialEnded, naming those that are not, after the limit."""
        began = time.monotonic()
        tell_at = began + _TELL_S
        while missing := self.waiting_for():
            now, text = time.monotonic(), "; ".join(missing)
            if now - began > limit_s:
                raise TrialEnded(Outcome.PLANNER_NOT_READY, f"{text} (waited {limit_s:g} s)")
            if now > tell_at:
                tell_at = now + _TELL_S
                self._station.note(f"waiting for managed nodes: {text}")
            self._station.wait(lambda: False, _LOOK_S, PLANNER)


def _missing(node: RemoteNode) -> str:
    if not node.offers("get_state"):
        return f"the lifecycle node {node.name} is not there"
    try:
        state = node.call("get_state", GetState, GetState.Request(), _ANSWER_S).current_state.label
    except Silent:
        return f"the lifecycle node {node.name} does not answer"
    return "" if state == _ACTIVE else f"the lifecycle node {node.name} is {state or 'in no state'}"
