"""What a planner shows of itself as serialised ROS messages: bands, candidates and diagnostics.

The same bytes as those of the messages that the planner's node makes.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import numpy.typing as npt

from barn_eval.bags.encode import STAMP_FIELDS
from barn_eval.bags.messages import Template, make, serialise
from barn_planners.candidates import ShownCandidates
from barn_planners.interface import Decision, PlannerStatus
from barn_worlds.types import NANOSECONDS

MARKERS_TYPE, DIAGNOSTICS_TYPE = "visualization_msgs/msg/MarkerArray", "diagnostic_msgs/msg/DiagnosticArray"
_MARKER = "visualization_msgs/msg/Marker"
# Constants of visualization_msgs/Marker and diagnostic_msgs/DiagnosticStatus.
_ADD, _DELETE_ALL, _CYLINDER, _LINE_STRIP = 0, 3, 3, 4
_LEVELS = {PlannerStatus.RECOVERING: 1, PlannerStatus.BLOCKED: 1, PlannerStatus.FAILED: 2}
_BUBBLE_COLOUR = {"r": 0.1, "g": 0.5, "b": 0.9, "a": 0.3}
_LINE_COLOUR = {"r": 0.9, "g": 0.3, "b": 0.1, "a": 1.0}


def encode_band(band: npt.NDArray[np.float64], stamp_ns: int, frame: str) -> bytes:
    """Return bubbles (n, 3) x, y, radius in metres as discs and a line through their centres."""
    stamp = divmod(stamp_ns, NANOSECONDS)
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
    header = make("std_msgs/msg/Header", frame_id=frame)
    markers = [make(_MARKER, header=header, ns="band", action=_DELETE_ALL)]
    fields = [f"markers.0.{name}" for name in STAMP_FIELDS]
    for index in range(count):
        disc = make(_MARKER, header=header, ns="bubbles", id=index, type=_CYLINDER, action=_ADD)
        disc.scale.z = 0.01
        disc.color = make("std_msgs/msg/ColorRGBA", **_BUBBLE_COLOUR)
        markers.append(disc)
        varying = (*STAMP_FIELDS, "pose.position.x", "pose.position.y", "scale.x", "scale.y")
        fields += [f"markers.{index + 1}.{name}" for name in varying]
    line = make(_MARKER, header=header, ns="band", type=_LINE_STRIP, action=_ADD)
    line.scale.x = 0.02
    line.color = make("std_msgs/msg/ColorRGBA", **_LINE_COLOUR)
    line.points = [make("geometry_msgs/msg/Point") for _ in range(count)]
    fields += [f"markers.{count + 1}.{name}" for name in STAMP_FIELDS]
    fields += [f"markers.{count + 1}.points.{index}.{axis}" for index in range(count) for axis in "xy"]
    for marker in (*markers, line):
        marker.pose.orientation.w = 1.0
    return Template(make(MARKERS_TYPE, markers=[*markers, line]), fields)


def encode_candidates(shown: ShownCandidates, stamp_ns: int, frame: str) -> bytes:
    """Return a line per trajectory."""
    stamp = divmod(stamp_ns, NANOSECONDS)
    values: list[float] = [*stamp]
    for points, colour in zip(shown.points, shown.colours, strict=True):
        values += [*stamp, *colour.tolist(), *points.ravel().tolist()]
    count, length, _ = shown.points.shape
    return _candidates_template(count, length, frame).fill(*values)


@cache
def _candidates_template(count: int, length: int, frame: str) -> Template:
    """Return the template of that many lines of that many points; a planner has one or two of them."""
    header = make("std_msgs/msg/Header", frame_id=frame)
    markers = [make(_MARKER, header=header, ns="candidates", action=_DELETE_ALL)]
    fields = [f"markers.0.{name}" for name in STAMP_FIELDS]
    varying = [*STAMP_FIELDS, "color.r", "color.g", "color.b", "color.a"]
    varying += [f"points.{point}.{axis}" for point in range(length) for axis in "xy"]
    for index in range(count):
        line = make(_MARKER, header=header, ns="candidates", id=index, type=_LINE_STRIP, action=_ADD)
        line.scale.x = 0.01
        line.points = [make("geometry_msgs/msg/Point") for _ in range(length)]
        markers.append(line)
        fields += [f"markers.{index + 1}.{name}" for name in varying]
    for marker in markers:
        marker.pose.orientation.w = 1.0
    return Template(make(MARKERS_TYPE, markers=markers), fields)


def encode_diagnostics(decision: Decision, name: str, stamp_ns: int) -> bytes:
    """Return status, reason and figures of a decision."""
    header = make("std_msgs/msg/Header")
    header.stamp.sec, header.stamp.nanosec = divmod(stamp_ns, NANOSECONDS)
    texts = {"status": decision.status.value} | {
        key: f"{value:.6g}" for key, value in decision.diagnostics.items() if math.isfinite(value)
    }
    status = make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=_LEVELS.get(decision.status, 0),
        name=name,
        message=decision.reason or decision.status.value,
        values=[make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in texts.items()],
    )
    return serialise(make(DIAGNOSTICS_TYPE, header=header, status=[status]))
