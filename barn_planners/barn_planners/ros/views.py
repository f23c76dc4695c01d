"""What a planner's node shows: plans, costmap, band, candidates and diagnostics, as messages for RViz and Foxglove."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, Vector3
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from barn_planners.candidates import ShownCandidates, shown_candidates
from barn_planners.interface import Decision, FloatArray, Planner, PlannerStatus
from barn_worlds.ros.conversions import reliable, to_header, to_occupancy_grid, to_path
from barn_worlds.types import nanoseconds

_LEVELS = {
    PlannerStatus.RUNNING: DiagnosticStatus.OK,
    PlannerStatus.GOAL_REACHED: DiagnosticStatus.OK,
    PlannerStatus.RECOVERING: DiagnosticStatus.WARN,
    PlannerStatus.BLOCKED: DiagnosticStatus.WARN,
    PlannerStatus.FAILED: DiagnosticStatus.ERROR,
}
_DIAGNOSTICS_NS = nanoseconds(1.0)


class Views:
    """Publishes what a planner shows, at most once per period and only what somebody listens to.

    The plan is in the planning frame, all else in the odom frame.
    """

    def __init__(self, node: Node, planning_frame: str, odom_frame: str, period_s: float):
        self._name = node.get_name()
        self._planning_frame, self._odom_frame = planning_frame, odom_frame
        self._period_ns = nanoseconds(period_s)
        self._plan = node.create_publisher(Path, "plan", reliable(1))
        self._local_plan = node.create_publisher(Path, "local_plan", reliable(1))
        self._costmap = node.create_publisher(OccupancyGrid, "local_costmap/costmap", reliable(1))
        self._band = node.create_publisher(MarkerArray, "band", reliable(1))
        self._candidates = node.create_publisher(MarkerArray, "candidates", reliable(1))
        self._diagnostics = node.create_publisher(DiagnosticArray, "diagnostics", reliable(10))
        self.reset()

    def reset(self) -> None:
        """Forget when anything was published."""
        self._plan_ns = self._view_ns = self._diagnostics_ns = -(10**18)
        self._status: PlannerStatus | None = None

    def publish(self, planner: Planner, decision: Decision, stamp_ns: int) -> None:
        """Publish what is due after a decision."""
        plan = decision.plan
        if plan is not None and self._due(self._plan_ns, stamp_ns) and self._plan.get_subscription_count():
            self._plan_ns = stamp_ns
            self._plan.publish(to_path(plan, stamp_ns, self._planning_frame))
        if self._due(self._view_ns, stamp_ns):
            self._view_ns = stamp_ns
            self._publish_view(planner, stamp_ns)
        changed = decision.status is not self._status
        if (changed or stamp_ns - self._diagnostics_ns >= _DIAGNOSTICS_NS) and decision.command is not None:
            self._diagnostics_ns, self._status = stamp_ns, decision.status
            if self._diagnostics.get_subscription_count():
                self._diagnostics.publish(to_diagnostics(decision, self._name, stamp_ns))

    def _due(self, last_ns: int, stamp_ns: int) -> bool:
        return stamp_ns - last_ns >= self._period_ns

    def _publish_view(self, planner: Planner, stamp_ns: int) -> None:
        listened = [self._local_plan, self._costmap, self._band, self._candidates]
        if not any(publisher.get_subscription_count() for publisher in listened):
            return
        view = planner.view()
        if view.local_plan is not None and self._local_plan.get_subscription_count():
            self._local_plan.publish(to_path(view.local_plan, stamp_ns, self._odom_frame))
        if view.costmap is not None and self._costmap.get_subscription_count():
            self._costmap.publish(to_occupancy_grid(view.costmap, stamp_ns, self._odom_frame))
        if view.band is not None and self._band.get_subscription_count():
            self._band.publish(to_band(view.band, stamp_ns, self._odom_frame))
        if view.candidates is not None and self._candidates.get_subscription_count():
            shown = shown_candidates(view.candidates, view.candidate_costs)
            self._candidates.publish(to_candidates(shown, stamp_ns, self._odom_frame))


def to_band(band: FloatArray, stamp_ns: int, frame: str) -> MarkerArray:
    """Return bubbles (n, 3) x, y, radius in metres as discs and a line through their centres."""
    header = to_header(stamp_ns, frame)
    markers = [Marker(header=header, ns="band", action=Marker.DELETEALL)]
    for index, (x, y, radius) in enumerate(band.tolist()):
        disc = Marker(header=header, ns="bubbles", id=index, type=Marker.CYLINDER, action=Marker.ADD)
        disc.pose = Pose(position=Point(x=x, y=y))
        disc.scale = Vector3(x=2.0 * radius, y=2.0 * radius, z=0.01)
        disc.color = ColorRGBA(r=0.1, g=0.5, b=0.9, a=0.3)
        markers.append(disc)
    line = Marker(header=header, ns="band", id=0, type=Marker.LINE_STRIP, action=Marker.ADD)
    line.scale.x = 0.02
    line.color = ColorRGBA(r=0.9, g=0.3, b=0.1, a=1.0)
    line.points = [Point(x=x, y=y) for x, y, _ in band.tolist()]
    return MarkerArray(markers=[*markers, line])


def to_candidates(shown: ShownCandidates, stamp_ns: int, frame: str) -> MarkerArray:
    """Return a line per trajectory."""
    header = to_header(stamp_ns, frame)
    markers = [Marker(header=header, ns="candidates", action=Marker.DELETEALL)]
    for index, (points, colour) in enumerate(zip(shown.points.tolist(), shown.colours.tolist(), strict=True)):
        line = Marker(header=header, ns="candidates", id=index, type=Marker.LINE_STRIP, action=Marker.ADD)
        line.scale.x = 0.01
        line.color = ColorRGBA(r=colour[0], g=colour[1], b=colour[2], a=colour[3])
        line.points = [Point(x=x, y=y) for x, y in points]
        markers.append(line)
    return MarkerArray(markers=markers)


def to_diagnostics(decision: Decision, name: str, stamp_ns: int) -> DiagnosticArray:
    """Return status, reason and figures of a decision."""
    values: Mapping[str, Any] = decision.diagnostics
    status = DiagnosticStatus(
        level=_LEVELS[decision.status],
        name=name,
        message=decision.reason or decision.status.value,
        values=[KeyValue(key="status", value=decision.status.value)]
        + [KeyValue(key=key, value=f"{value:.6g}") for key, value in values.items() if math.isfinite(value)],
    )
    return DiagnosticArray(header=to_header(stamp_ns, ""), status=[status])
