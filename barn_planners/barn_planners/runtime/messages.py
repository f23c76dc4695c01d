"""The serialized messages of a planner, which a node sends and a bag records."""

import math
from collections.abc import Callable, Iterable, Iterator
from functools import cache, lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from barn_planners.interface import Decision, FloatArray, Planner, PlannerStatus
from barn_worlds.base.arrays import Integers
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, STOP, Velocity2D, nanoseconds
from barn_worlds.messages import encode, topics
from barn_worlds.messages.cdr import Layout, Message, Slot, Template, make_message
from barn_worlds.messages.topics import Frames, OutgoingMessage, Topic

# Topics of what a planner shows with its method `view`.
VIEW_TOPICS = (topics.LOCAL_PLAN, topics.COSTMAP, topics.BAND, topics.CANDIDATES)
# Limits of what is published of a planner's candidates, which can be thousands.
MAX_CANDIDATES = 20
MAX_POINTS = 8
# Red, green, blue and opacity of the cheapest and the costliest valid candidate and of
# rejected ones.
CHEAPEST_COLOR = (0.0, 0.25, 0.5, 0.9)
COSTLIEST_COLOR = (0.55, 0.8, 0.95, 0.7)
REJECTED_COLOR = (0.55, 0.55, 0.55, 0.5)

_LEVELS = {
    PlannerStatus.RUNNING: encode.FINE,
    PlannerStatus.GOAL_REACHED: encode.FINE,
    PlannerStatus.RECOVERING: encode.WARNING,
    PlannerStatus.BLOCKED: encode.WARNING,
    PlannerStatus.FAILED: encode.ERROR,
}
_BUBBLE_COLOR = (0.1, 0.5, 0.9, 0.3)
_BUBBLE_HEIGHT_M = 0.01
_BUBBLE_FIELDS = ("pose.position.x", "pose.position.y", "scale.x", "scale.y")
_BAND_COLOR = (0.9, 0.3, 0.1, 1.0)
_BAND_WIDTH_M = 0.02
_CANDIDATE_WIDTH_M = 0.01
# A marker and the names of its fields that vary from message to message.
_MarkerFields: TypeAlias = tuple[Message, tuple[str, ...]]
# A time so long ago that every period has passed.
_NEVER_NS = -(10**18)


class CandidateLines(NamedTuple):
    """Candidates as they are drawn."""

    points: FloatArray  # (k, n, 2) x and y in m
    colors: FloatArray  # (k, 4) red, green, blue, opacity from 0 to 1


def choose_candidates(costs: FloatArray) -> Integers:
    """Return indices of at most 20 candidates, evenly spread, the cheapest among them.

    Args:
        costs: Costs (k,), as in `PlannerView`.
    """
    indices: Integers = _spread_indices(len(costs), MAX_CANDIDATES).copy()
    if np.isfinite(costs).any():
        cheapest = int(np.nanargmin(costs))
        # In place of its neighbor in the selection, so that the number stays.
        indices[np.argmin(np.abs(indices - cheapest))] = cheapest
    return indices


def select_candidates(
    candidates: FloatArray, costs: FloatArray | None
) -> CandidateLines:
    """Return at most 20 candidates of up to 8 points, evenly spread, colored by cost.

    The cheapest is among them, and both ends of each.

    Args:
        candidates: Trajectories (k, n, 2) in m.
        costs: Costs (k,), +inf if rejected. Unknown ones, which are NaN, or None for
            all, get the costliest color.
    """
    if costs is None:
        costs = np.full(len(candidates), math.nan)
    indices = choose_candidates(costs)
    point_indices = _spread_indices(candidates.shape[1], MAX_POINTS)
    points = candidates[indices][:, point_indices]
    return CandidateLines(points, _colors(costs[indices]))


def _colors(costs: FloatArray) -> FloatArray:
    """Return RGBA (k, 4), cheapest to costliest color; NaN is costliest, inf gray."""
    is_known = np.isfinite(costs)
    shares = np.ones(len(costs))
    if is_known.any():
        low = float(costs[is_known].min())
        spread = float(costs[is_known].max()) - low
        shares[is_known] = (costs[is_known] - low) / (spread or 1.0)

    cheapest = np.array(CHEAPEST_COLOR)
    colors = cheapest + shares[:, None] * (np.array(COSTLIEST_COLOR) - cheapest)
    return np.where(np.isinf(costs)[:, None], np.array(REJECTED_COLOR), colors)


@lru_cache(maxsize=64)
def _spread_indices(count: int, limit: int) -> Integers:
    """Return at most `limit` indices below `count`, evenly spread, with both ends.

    The array is cached: copy it before a change.
    """
    places = np.linspace(0, count - 1, min(count, limit))
    indices: Integers = places.round().astype(np.int64)
    return indices


class PlannerMessages:
    """Makes the messages of one planner: commands, and views at intervals."""

    def __init__(
        self,
        frames: Frames,
        name: str = "planner",
        *,
        stamped: bool = False,
        view_period_s: float = topics.PLAN.period_s,
    ):
        """Prepare the encoders; nothing is sent here or by any method.

        Args:
            frames: Names of the frames for the headers.
            name: Name of the node, which diagnostics carry.
            stamped: Whether commands are TwistStamped instead of Twist.
            view_period_s: Simulated time between two views, in s.
        """
        self._frames = frames
        self._name = name
        # Only a stamped command has a frame, and so a template that is worth keeping.
        self._twist_encoder = None
        if stamped:
            self._twist_encoder = encode.TwistStampedEncoder(
                frames.of(topics.CMD_VEL_STAMPED)
            )
        self._plan_encoder = encode.PathEncoder(frames.of(topics.PLAN))
        self._local_plan_encoders = {
            frame: encode.PathEncoder(frame) for frame in (frames.odom, frames.planning)
        }
        self._view_period_ns = nanoseconds(view_period_s)
        self.reset()

    def reset(self) -> None:
        """Forget when views, plans and diagnostics were made: all are due again."""
        self._plan_ns = self._view_ns = self._diagnostics_ns = _NEVER_NS
        self._status: PlannerStatus | None = None

    def warm_up(self, planner: Planner) -> None:
        """Make display messages once and drop them, so that the first are not slow."""
        list(self.display(planner, Decision(STOP, plan=np.zeros((2, 2))), 0))
        self.reset()

    def command(self, velocity: Velocity2D, stamp_ns: int) -> OutgoingMessage:
        """Return a command as serialized Twist or, if `stamped`, TwistStamped.

        Args:
            velocity: Command of the planner.
            stamp_ns: Simulated time in ns, for stamped commands.
        """
        if self._twist_encoder is None:
            return OutgoingMessage(topics.CMD_VEL, encode.encode_twist(velocity))
        data = self._twist_encoder.encode(velocity, stamp_ns)
        return OutgoingMessage(topics.CMD_VEL_STAMPED, data)

    def display(
        self,
        planner: Planner,
        decision: Decision,
        stamp_ns: int,
        is_wanted: Callable[[Topic], bool] = lambda _: True,
    ) -> Iterator[OutgoingMessage]:
        """Yield the serialized display messages that are due and wanted after a cycle.

        Views are due once per period, diagnostics each second or if the status changes.

        Args:
            planner: Planner whose view is taken, only if a topic of it is wanted.
            decision: Decision of the cycle.
            stamp_ns: Simulated time in ns.
            is_wanted: Tells whether someone listens to a topic.
        """
        plan = decision.plan
        is_plan_due = stamp_ns - self._plan_ns >= self._view_period_ns
        if plan is not None and is_plan_due and is_wanted(topics.PLAN):
            self._plan_ns = stamp_ns
            yield OutgoingMessage(
                topics.PLAN, self._plan_encoder.encode(plan, stamp_ns)
            )

        if stamp_ns - self._view_ns >= self._view_period_ns:
            self._view_ns = stamp_ns
            yield from self._view(planner, stamp_ns, is_wanted)

        period_ns = nanoseconds(topics.DIAGNOSTICS.period_s)
        is_due = (
            decision.status is not self._status
            or stamp_ns - self._diagnostics_ns >= period_ns
        )
        # A cycle without a command says nothing new about the status.
        if is_due and decision.command is not None:
            self._diagnostics_ns = stamp_ns
            self._status = decision.status
            if is_wanted(topics.DIAGNOSTICS):
                data = _encode_diagnostics(decision, self._name, stamp_ns)
                yield OutgoingMessage(topics.DIAGNOSTICS, data)

    def _view(
        self, planner: Planner, stamp_ns: int, is_wanted: Callable[[Topic], bool]
    ) -> Iterator[OutgoingMessage]:
        """Yield local plan, costmap, band and candidates that exist and are wanted."""
        # A view may take longer than a control cycle, so it is made only for listeners.
        wanted_topics = set(filter(is_wanted, VIEW_TOPICS))
        if not wanted_topics:
            return

        view = planner.view()
        frame = self._frames.planning if view.in_planning_frame else self._frames.odom
        if view.local_plan is not None and topics.LOCAL_PLAN in wanted_topics:
            data = self._local_plan_encoders[frame].encode(view.local_plan, stamp_ns)
            yield OutgoingMessage(topics.LOCAL_PLAN, data)
        if view.costmap is not None and topics.COSTMAP in wanted_topics:
            data = encode.encode_map(view.costmap, stamp_ns, frame)
            yield OutgoingMessage(topics.COSTMAP, data)
        if view.band is not None and topics.BAND in wanted_topics:
            yield OutgoingMessage(topics.BAND, encode_band(view.band, stamp_ns, frame))
        if view.candidates is not None and topics.CANDIDATES in wanted_topics:
            lines = select_candidates(view.candidates, view.candidate_costs)
            data = encode_candidates(lines, stamp_ns, frame)
            yield OutgoingMessage(topics.CANDIDATES, data)


def encode_band(band: FloatArray, stamp_ns: int, frame: str) -> bytes:
    """Return an elastic band as serialized MarkerArray: discs and a line through them.

    Args:
        band: Bubbles (n, 3): x, y and radius in m.
        stamp_ns: Simulated time in ns.
        frame: Frame of the bubbles.
    """
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
    """Return the template of a band of `count` bubbles, cached by length and frame.

    Bands have a few dozen lengths, which recur.
    """
    markers: list[_MarkerFields] = []
    for index in range(count):
        disc = encode.make_marker(
            frame, "bubbles", encode.CYLINDER, index=index, color=_BUBBLE_COLOR
        )
        # Flat discs: in a viewer, balls would hide the robot.
        disc.scale.z = _BUBBLE_HEIGHT_M
        markers.append((disc, _BUBBLE_FIELDS))

    line = encode.make_marker(frame, "band", encode.LINE_STRIP, color=_BAND_COLOR)
    markers.append((line, _add_points(line, _BAND_WIDTH_M, count)))
    return _marker_template(topics.BAND, frame, "band", markers)


def encode_candidates(lines: CandidateLines, stamp_ns: int, frame: str) -> bytes:
    """Return candidates as serialized MarkerArray: a colored line for each.

    Args:
        lines: Points and colors.
        stamp_ns: Simulated time in ns.
        frame: Frame of the points.
    """
    stamp = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    count, length, _ = lines.points.shape
    points = np.zeros((count, length, 3))
    points[:, :, :2] = lines.points
    colors = lines.colors.astype(np.float32)
    values: list[object] = [*stamp]
    for line, color in zip(points, colors, strict=True):
        values += [*stamp, color.tobytes(), line.tobytes()]
    return _candidates_layout(count, length, frame).fill(*values)


@cache
def _candidates_layout(count: int, length: int, frame: str) -> Layout:
    """Return the cached layout of `count` lines of `length` points each.

    A planner uses one or two such layouts. Color and points of each line are bytes.
    """
    markers = []
    for index in range(count):
        line = encode.make_marker(frame, "candidates", encode.LINE_STRIP, index=index)
        _add_points(line, _CANDIDATE_WIDTH_M, length)
        markers.append((line, ("color.r", "points.0.x")))
    template = _marker_template(topics.CANDIDATES, frame, "candidates", markers)
    slots = []
    for slot in template.slots:
        # Four numbers of single precision, or coordinates in double precision.
        size = {"f": 16, "d": 24 * length}.get(slot.format)
        slots.append(slot if size is None else Slot(slot.offset, f"{size}s"))
    return Layout(template.data, slots)


def _add_points(line: Message, width_m: float, count: int) -> tuple[str, ...]:
    """Give a line marker its width and points; return names of their x and y fields."""
    line.scale.x = width_m
    line.points = [make_message("geometry_msgs/msg/Point") for _ in range(count)]
    return tuple(f"points.{index}.{axis}" for index in range(count) for axis in "xy")


def _marker_template(
    topic: Topic,
    frame: str,
    namespace: str,
    markers: Iterable[_MarkerFields],
) -> Template:
    """Return a template of markers that replace all earlier ones; all stamps vary."""
    # Viewers keep markers until told otherwise: the first marker deletes earlier ones.
    messages = [encode.make_marker(frame, namespace, action=encode.DELETE_ALL)]
    fields = [f"markers.0.{name}" for name in encode.STAMP_FIELDS]
    for index, (marker, varying_fields) in enumerate(markers, 1):
        messages.append(marker)
        names = encode.STAMP_FIELDS + varying_fields
        fields += [f"markers.{index}.{name}" for name in names]
    return Template(make_message(topic.type_name, markers=messages), fields)


def _encode_diagnostics(decision: Decision, name: str, stamp_ns: int) -> bytes:
    """Return a decision as serialized DiagnosticArray, with its finite values."""
    status = decision.status
    values = {"status": status.value}
    for key, value in decision.diagnostics.items():
        # NaN tells people nothing, and some viewers refuse it.
        if math.isfinite(value):
            values[key] = f"{value:.6g}"
    message = decision.reason or status.value
    return encode.encode_diagnostics(stamp_ns, _LEVELS[status], name, message, values)
