"""What a trial is worth so far, as messages for those who watch it and for its bag."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from barn_eval.bags.messages import make, serialise
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.protocol import Course
from barn_eval.trials.referee import Standing
from barn_eval.trials.scores import challenge_metric
from barn_eval.trials.spec import MAP_FRAME, TrialSpec
from barn_worlds.types import NANOSECONDS, nanoseconds

# What is published: a number to plot, a word to show, and a text within the scene.
TOPICS = {
    "/score": "std_msgs/msg/Float64",
    "/outcome": "std_msgs/msg/String",
    "/score_text": "visualization_msgs/msg/MarkerArray",
}
RUNNING = "running"
_PERIOD_NS = nanoseconds(0.5)
_BELOW_START_M = 1.5
_TEXT_M = 0.3
# Constant of visualization_msgs/Marker.
_TEXT_VIEW_FACING = 9


class Shown(NamedTuple):
    """A message to be published and recorded."""

    topic: str
    data: bytes


class LiveScore:
    """Says twice a second, and once more at the verdict, how a trial stands."""

    def __init__(self, spec: TrialSpec) -> None:
        self._course = spec.course
        self._title = f"{spec.planner}, {spec.world.name}"
        self._due_ns: int | None = None
        self._concluded = False

    def take(self, standing: Standing, stamp_ns: int) -> Iterator[Shown]:
        """Yield what is due at the end of an instant."""
        due = self._due_ns is None or stamp_ns >= self._due_ns or standing.outcome is not None
        if self._concluded or not due:
            return
        self._due_ns, self._concluded = stamp_ns + _PERIOD_NS, standing.outcome is not None
        value = score_so_far(standing, self._course)
        word = standing.outcome.value if standing.outcome else RUNNING
        yield Shown("/score", serialise(make(TOPICS["/score"], data=value)))
        yield Shown("/outcome", serialise(make(TOPICS["/outcome"], data=word)))
        yield Shown("/score_text", self._text(_lines(self._title, standing, value), stamp_ns))

    def _text(self, lines: list[str], stamp_ns: int) -> bytes:
        header = make("std_msgs/msg/Header", frame_id=MAP_FRAME)
        header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, NANOSECONDS)
        marker = make("visualization_msgs/msg/Marker", header=header, ns="score", type=_TEXT_VIEW_FACING)
        start = self._course.start
        marker.pose.position.x, marker.pose.position.y = start.x, start.y - _BELOW_START_M
        marker.pose.orientation.w = 1.0
        marker.scale.z = _TEXT_M
        marker.color.a = 1.0
        marker.text = "\n".join(lines)
        return serialise(make(TOPICS["/score_text"], markers=[marker]))


def score_so_far(standing: Standing, course: Course) -> float:
    """Return the challenge metric: that of the verdict or, before it, what it would be if the goal were reached now."""
    outcome = standing.outcome or Outcome.SUCCESS
    on_clock_s = standing.on_clock_s if standing.outcome else standing.on_clock_s or 0.0
    return challenge_metric(Verdict(outcome, "", on_clock_s, 0.0, 0.0), course.optimal_time_s)


def _lines(title: str, standing: Standing, value: float) -> list[str]:
    clock = "clock not started" if standing.on_clock_s is None else f"{standing.on_clock_s:.2f} s on the clock"
    left = "" if standing.left_m is None else f"{standing.left_m:.2f} m to the goal"
    contact = f"{standing.contact_s:.2f} s in contact"
    outcome = f"{standing.outcome.value}: {value:.3f}" if standing.outcome else f"worth {value:.3f} if there now"
    return [title, clock, left, contact, outcome]
