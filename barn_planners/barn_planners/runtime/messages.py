"""The messages of a planner, serialised: its node sends them, a direct trial records them."""

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from barn_planners.interface import Decision, FloatArray, Planner, PlannerStatus
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, STOP, Velocity2D, nanoseconds
from barn_worlds.messages import encode, topics
from barn_worlds.messages.cdr import Template, make
from barn_worlds.messages.topics import Frames, Outgoing, Topic

MOST_SHOWN = 20
MOST_POINTS = 8
# Red, green, blue, opacity of the cheapest and the costliest valid trajectory, and of rejected ones.
CHEAPEST, DEAREST, REJECTED = (
    (0.0, 0.25, 0.5, 0.9),
    (0.55, 0.8, 0.95, 0.7),
    (0.55, 0.55, 0.55, 0.5),
)
_LEVELS = {
    PlannerStatus.RUNNING: encode.FINE,
    PlannerStatus.GOAL_REACHED: encode.FINE,
    PlannerStatus.RECOVERING: encode.WARNING,
    PlannerStatus.BLOCKED: encode.WARNING,
    PlannerStatus.FAILED: encode.ERROR,
}
_BUBBLE_COLOUR, _BAND_COLOUR = (0.1, 0.5, 0.9, 0.3), (0.9, 0.3, 0.1, 1.0)
_BUBBLE_HEIGHT_M, _BAND_WIDTH_M, _CANDIDATE_WIDTH_M = 0.01, 0.02, 0.01
_NEVER_NS = -(10**18)


class ShownCandidates(NamedTuple):
    """Trajectories (k, n, 2) in metres and their colours (k, 4): red, green, blue, opacity."""

    points: FloatArray
    colours: FloatArray


def shown_candidates(
    candidates: FloatArray, costs: FloatArray | None
) -> ShownCandidates:
    """Choose `MOST_SHOWN` of trajectories (k, n, 2), evenly, and of each `MOST_POINTS` points, both ends among them.

    The cheapest is always chosen; costs (k,) are +inf where rejected. Without costs all have the colour of the
    costliest.
    """
    worth = (
        np.zeros(len(candidates))
        if costs is None
        else np.where(np.isnan(costs), np.inf, costs)
    )
    chosen = _spread(len(candidates), MOST_SHOWN)
    if costs is not None and np.isfinite(worth).any():
        cheapest = int(np.argmin(worth))
        chosen[np.argmin(np.abs(chosen - cheapest))] = cheapest
    points = candidates[chosen][:, _spread(candidates.shape[1], MOST_POINTS)]
    return ShownCandidates(
        np.asarray(points, np.float64), _colours(worth[chosen], costs is not None)
    )


def _colours(costs: FloatArray, graded: bool) -> FloatArray:
    free = np.isfinite(costs)
    low, high = (
        (float(costs[free].min()), float(costs[free].max()))
        if free.any()
        else (0.0, 0.0)
    )
    share = (
        (np.where(free, costs, high) - low) / (high - low)
        if high > low
        else np.zeros(len(costs))
    )
    share = share if graded else np.ones(len(costs))
    graded_colours = np.array(CHEAPEST) + share[:, None] * (
        np.array(DEAREST) - np.array(CHEAPEST)
    )
    return np.where(free[:, None], graded_colours, np.array(REJECTED))


def _spread(count: int, most: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return at most `most` of the numbers from 0 to count - 1, evenly spaced, with both ends."""
    spread: np.ndarray[tuple[int], np.dtype[np.int64]] = (
        np.linspace(0, count - 1, min(count, most)).round().astype(int)
    )
    return spread


class PlannerMessages:
    """The messages of one planner, a node of that name: each command, stamped if told so, and its view at intervals."""

    def __init__(
        self,
        frames: Frames,
        name: str = "planner",
        *,
        stamped: bool = False,
        view_period_s: float = topics.PLAN.period_s,
    ) -> None:
        self._name = name
        self._frames = frames
        self._stamped = (
            encode.TwistStampedEncoder(frames.of(topics.CMD_VEL_STAMPED))
            if stamped
            else None
        )
        self._plan = encode.PathEncoder(frames.of(topics.PLAN))
        self._local_plans = {
            frame: encode.PathEncoder(frame) for frame in (frames.odom, frames.planning)
        }
        self._view_period_ns = nanoseconds(view_period_s)
        self.reset()

    def reset(self) -> None:
        """Forget when views were published."""
        self._plan_ns = self._view_ns = self._diagnostics_ns = _NEVER_NS
        self._status: PlannerStatus | None = None

    def warm_up(self, planner: Planner) -> None:
        """Make one of each message, so that the first of a trial are not slower than the others."""
        list(self.shown(planner, Decision(STOP, plan=np.zeros((2, 2))), 0))
        self.reset()

    def command(self, velocity: Velocity2D, stamp_ns: int) -> Outgoing:
        """Return a command."""
        if self._stamped is None:
            return Outgoing(topics.CMD_VEL, encode.encode_twist(velocity))
        return Outgoing(
            topics.CMD_VEL_STAMPED, self._stamped.encode(velocity, stamp_ns)
        )

    def shown(
        self,
        planner: Planner,
        decision: Decision,
        stamp_ns: int,
        wanted: Callable[[Topic], bool] = lambda _: True,
    ) -> Iterator[Outgoing]:
        """Yield what is due of the topics that are wanted: views once per period, diagnostics each second or if new."""
        plan = decision.plan
        if (
            plan is not None
            and stamp_ns - self._plan_ns >= self._view_period_ns
            and wanted(topics.PLAN)
        ):
            self._plan_ns = stamp_ns
            yield Outgoing(topics.PLAN, self._plan.encode(plan, stamp_ns))
        if stamp_ns - self._view_ns >= self._view_period_ns:
            self._view_ns = stamp_ns
            yield from self._view(planner, stamp_ns, wanted)
        waited_ns = stamp_ns - self._diagnostics_ns
        due = decision.status is not self._status or waited_ns >= nanoseconds(
            topics.DIAGNOSTICS.period_s
        )
        if due and decision.command is not None:
            self._diagnostics_ns, self._status = stamp_ns, decision.status
            if wanted(topics.DIAGNOSTICS):
                yield Outgoing(
                    topics.DIAGNOSTICS, _diagnostics(decision, self._name, stamp_ns)
                )

    def _view(
        self, planner: Planner, stamp_ns: int, wanted: Callable[[Topic], bool]
    ) -> Iterator[Outgoing]:
        here = (topics.LOCAL_PLAN, topics.COSTMAP, topics.BAND, topics.CANDIDATES)
        asked = {topic for topic in here if wanted(topic)}
        if not asked:
            return
        view = planner.view()
        frame = self._frames.planning if view.in_planning_frame else self._frames.odom
        if view.local_plan is not None and topics.LOCAL_PLAN in asked:
            yield Outgoing(
                topics.LOCAL_PLAN,
                self._local_plans[frame].encode(view.local_plan, stamp_ns),
            )
        if view.costmap is not None and topics.COSTMAP in asked:
            yield Outgoing(
                topics.COSTMAP, encode.encode_map(view.costmap, stamp_ns, frame)
            )
        if view.band is not None and topics.BAND in asked:
            yield Outgoing(topics.BAND, encode_band(view.band, stamp_ns, frame))
        if view.candidates is not None and topics.CANDIDATES in asked:
            shown = shown_candidates(view.candidates, view.candidate_costs)
            yield Outgoing(topics.CANDIDATES, encode_candidates(shown, stamp_ns, frame))


def encode_band(band: FloatArray, stamp_ns: int, frame: str) -> bytes:
    """Return bubbles (n, 3) x, y, radius in metres as discs and a line through their centres."""
    stamp = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    bubbles = band.tolist()
    values: list[float] = [*stamp]
    for x, y, radius in bubbles:
        values += [*stamp, x, y, 2.0 * radius, 2.0 * radius]
    values += stamp
    for x, y, _ in bubbles:
        values += [x, y]
    return _band_template(len(bubbles), frame).fill(*values)


@cache
def _band_template(count: int, frame: str) -> Template:
    """Return the template of a band; bands have a few dozen lengths, which recur."""
    discs = [
        encode.marker(frame, "bubbles", encode.CYLINDER, index=k, colour=_BUBBLE_COLOUR)
        for k in range(count)
    ]
    for disc in discs:
        disc.scale.z = _BUBBLE_HEIGHT_M
    place = ("pose.position.x", "pose.position.y", "scale.x", "scale.y")
    line = _line(
        encode.marker(frame, "band", encode.LINE_STRIP, colour=_BAND_COLOUR),
        _BAND_WIDTH_M,
        count,
    )
    return _template(
        topics.BAND, frame, "band", [*((disc, place) for disc in discs), line]
    )


def _line(line: Any, width_m: float, count: int) -> tuple[Any, tuple[str, ...]]:
    """Return a marker as a line of that many points, and their fields."""
    line.scale.x, line.points = (
        width_m,
        [make("geometry_msgs/msg/Point") for _ in range(count)],
    )
    return line, tuple(
        f"points.{index}.{axis}" for index in range(count) for axis in "xy"
    )


def _template(
    topic: Topic, frame: str, namespace: str, markers: list[tuple[Any, tuple[str, ...]]]
) -> Template:
    """Return the template of markers with the fields that vary, besides stamps; the first one deletes all others."""
    every = [(encode.marker(frame, namespace, action=encode.DELETE_ALL), ()), *markers]
    fields = [
        f"markers.{k}.{name}"
        for k, (_, own) in enumerate(every)
        for name in (*encode.STAMP_FIELDS, *own)
    ]
    return Template(make(topic.type_name, markers=[one for one, _ in every]), fields)


def encode_candidates(shown: ShownCandidates, stamp_ns: int, frame: str) -> bytes:
    """Return a line per trajectory."""
    stamp = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    values: list[float] = [*stamp]
    for points, colour in zip(shown.points, shown.colours, strict=True):
        values += [*stamp, *colour.tolist(), *points.ravel().tolist()]
    count, length, _ = shown.points.shape
    return _candidates_template(count, length, frame).fill(*values)


@cache
def _candidates_template(count: int, length: int, frame: str) -> Template:
    """Return the template of that many lines of that many points; a planner has one or two of them."""
    markers = []
    for index in range(count):
        line = encode.marker(frame, "candidates", encode.LINE_STRIP, index=index)
        line, points = _line(line, _CANDIDATE_WIDTH_M, length)
        markers.append((line, ("color.r", "color.g", "color.b", "color.a", *points)))
    return _template(topics.CANDIDATES, frame, "candidates", markers)


def _diagnostics(decision: Decision, name: str, stamp_ns: int) -> bytes:
    figures = {
        key: f"{value:.6g}"
        for key, value in decision.diagnostics.items()
        if math.isfinite(value)
    }
    status = decision.status
    values = {"status": status.value} | figures
    return encode.encode_diagnostics(
        stamp_ns, _LEVELS[status], name, decision.reason or status.value, values
    )
