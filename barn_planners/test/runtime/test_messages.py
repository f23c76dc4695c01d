"""What a planner publishes against messages of rclpy that are filled field by field, and when it is due."""

import math

import numpy as np
import pytest

from barn_planners.interface import Decision, Planner, PlannerStatus, PlannerView
from barn_planners.runtime.messages import (
    PlannerMessages,
    encode_band,
    encode_candidates,
    select_candidates,
)
from barn_worlds.base.types import (
    NANOSECONDS_PER_SECOND,
    STOP,
    OccupancyMap,
    Velocity2D,
)
from barn_worlds.messages import decode, topics
from barn_worlds.messages.cdr import deserialize, serialize
from barn_worlds.messages.topics import Frames

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, Vector3
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

STAMP = 3_250_000_000
HEADER = Header(stamp=Time(sec=3, nanosec=250_000_000), frame_id="odom")
LEVELS = {
    "recovering": DiagnosticStatus.WARN,
    "blocked": DiagnosticStatus.WARN,
    "failed": DiagnosticStatus.ERROR,
}


def to_band(band) -> MarkerArray:
    markers = [Marker(header=HEADER, ns="band", action=Marker.DELETEALL)]
    for index, (x, y, radius) in enumerate(band.tolist()):
        disc = Marker(
            header=HEADER,
            ns="bubbles",
            id=index,
            type=Marker.CYLINDER,
            action=Marker.ADD,
        )
        disc.pose = Pose(position=Point(x=x, y=y))
        disc.scale = Vector3(x=2.0 * radius, y=2.0 * radius, z=0.01)
        disc.color = ColorRGBA(r=0.1, g=0.5, b=0.9, a=0.3)
        markers.append(disc)
    line = Marker(
        header=HEADER, ns="band", id=0, type=Marker.LINE_STRIP, action=Marker.ADD
    )
    line.scale.x = 0.02
    line.color = ColorRGBA(r=0.9, g=0.3, b=0.1, a=1.0)
    line.points = [Point(x=x, y=y) for x, y, _ in band.tolist()]
    return MarkerArray(markers=[*markers, line])


def to_candidates(selection) -> MarkerArray:
    markers = [Marker(header=HEADER, ns="candidates", action=Marker.DELETEALL)]
    for index, (points, color) in enumerate(
        zip(selection.points.tolist(), selection.colors.tolist(), strict=True)
    ):
        line = Marker(
            header=HEADER,
            ns="candidates",
            id=index,
            type=Marker.LINE_STRIP,
            action=Marker.ADD,
        )
        line.scale.x = 0.01
        line.color = ColorRGBA(**dict(zip("rgba", color, strict=True)))
        line.points = [Point(x=x, y=y) for x, y in points]
        markers.append(line)
    return MarkerArray(markers=markers)


def to_diagnostics(decision, name) -> DiagnosticArray:
    figures = {
        key: f"{value:.6g}"
        for key, value in decision.diagnostics.items()
        if math.isfinite(value)
    }
    values = {"status": decision.status.value} | figures
    status = DiagnosticStatus(
        level=LEVELS.get(decision.status.value, DiagnosticStatus.OK),
        name=name,
        message=decision.reason or decision.status.value,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
    return DiagnosticArray(header=Header(stamp=HEADER.stamp), status=[status])


def as_read(message, length: int, type_name: str) -> bytes:
    """Return a message of ROS with the bytes between its fields set to zero and those behind it cut off."""
    return serialize(deserialize(serialize_message(message)[:length], type_name))


@pytest.mark.parametrize("count", [0, 1, 2, 7, 30])
def test_band(count):
    band = np.random.default_rng(count).uniform(-3.0, 3.0, (count, 3))
    ours = encode_band(band, STAMP, "odom")
    assert ours == as_read(to_band(band), len(ours), topics.BAND.type_name)


@pytest.mark.parametrize(
    "count, length", [(0, 5), (1, 1), (1, 80), (151, 2), (140, 80)]
)
def test_candidates(count, length):
    draw = np.random.default_rng(count)
    costs = np.where(draw.random(count) < 0.3, np.inf, draw.uniform(0.0, 9.0, count))
    selection = select_candidates(draw.uniform(-3.0, 3.0, (count, length, 2)), costs)
    ours = encode_candidates(selection, STAMP, "odom")
    assert ours == as_read(
        to_candidates(selection), len(ours), topics.CANDIDATES.type_name
    )
    assert len(ours) < 9000


class Shower(Planner):
    """Shows everything, always the same."""

    requests = 0

    def start(self, task, seed): ...

    def step(self, observation):
        return Decision(STOP)

    def view(self):
        self.requests += 1
        return PlannerView(
            local_plan=np.zeros((3, 3)),
            costmap=OccupancyMap(np.zeros((2, 3), np.int8), 0.25, 0.0, 0.0),
            band=np.ones((2, 3)),
            candidates=np.zeros((2, 4, 2)),
            candidate_costs=np.array([1.0, np.inf]),
        )


def messages_of(messages, decision, time_s, accepts=lambda _: True, planner=None):
    planner = planner or Shower()
    return {
        topic.name: data
        for topic, data in messages.display(
            planner, decision, round(time_s * NANOSECONDS_PER_SECOND), accepts
        )
    }


@pytest.mark.parametrize("status", list(PlannerStatus))
@pytest.mark.parametrize("reason", ["", "no way through"])
def test_diagnostics(status, reason):
    figures = {"cost": 12.3456789, "samples": 20.0, "unknown": np.nan}
    decision = Decision(STOP, status, reason, diagnostics=figures)
    ours = messages_of(PlannerMessages(Frames(), "dwa"), decision, 3.25)["diagnostics"]
    assert ours == as_read(
        to_diagnostics(decision, "dwa"), len(ours), topics.DIAGNOSTICS.type_name
    )
    assert decode.diagnostics(ours)[0]["status"] == status.value


VIEWS = {"local_plan", "local_costmap/costmap", "band", "candidates"}


def test_views_come_twice_a_second_diagnostics_on_change():
    messages = PlannerMessages(Frames())
    running = Decision(STOP, plan=np.zeros((2, 2)))
    blocked = Decision(STOP, PlannerStatus.BLOCKED)
    assert set(messages_of(messages, running, 0.0)) == VIEWS | {"plan", "diagnostics"}
    assert set(messages_of(messages, running, 0.45)) == set()
    assert set(messages_of(messages, running, 0.5)) == VIEWS | {"plan"}
    assert set(messages_of(messages, blocked, 0.55)) == {"diagnostics"}
    assert set(messages_of(messages, blocked, 0.9)) == set()
    assert set(messages_of(messages, blocked, 1.5)) == VIEWS
    assert set(messages_of(messages, running, 1.52)) == {"plan", "diagnostics"}
    messages.reset()
    assert set(messages_of(messages, running, 0.1)) == VIEWS | {"plan", "diagnostics"}


def test_a_plan_is_published_when_due_or_changed():
    messages = PlannerMessages(Frames(), view_period_s=1.0)
    planned = Decision(STOP, plan=np.zeros((2, 2)))
    assert "plan" not in messages_of(messages, Decision(STOP), 0.0)
    assert "plan" in messages_of(messages, planned, 0.3)
    assert "plan" not in messages_of(messages, planned, 1.25)
    assert "plan" in messages_of(messages, planned, 1.3)


def test_a_cycle_without_a_command_tells_no_status():
    assert "diagnostics" not in messages_of(
        PlannerMessages(Frames()), Decision(None), 0.0
    )


def test_warming_up_leaves_nothing_behind():
    messages = PlannerMessages(Frames())
    planner = Shower()
    messages.warm_up(planner)
    assert planner.requests == 1
    assert set(
        messages_of(messages, Decision(STOP, plan=np.zeros((2, 2))), 0.1)
    ) == VIEWS | {
        "plan",
        "diagnostics",
    }


def test_only_what_is_wanted_is_made():
    messages = PlannerMessages(Frames())
    planner = Shower()
    planned = Decision(STOP, plan=np.zeros((2, 2)))
    assert messages_of(messages, planned, 0.0, lambda _: False, planner) == {}
    assert planner.requests == 0
    # a plan that nobody wanted has not been shown; views are looked at again after their period
    assert set(messages_of(messages, planned, 0.1, planner=planner)) == {"plan"}
    assert set(
        messages_of(messages, planned, 0.5, lambda topic: topic is topics.BAND, planner)
    ) == {"band"}
    assert planner.requests == 1


def test_frames_are_those_of_the_planner():
    frames = messages_of(
        PlannerMessages(Frames(odom="wheels", planning="world")),
        Decision(STOP, plan=np.zeros((2, 2))),
        0.0,
    )
    assert {
        name: decode.header(frames[name]).frame
        for name in ("plan", "local_plan", "local_costmap/costmap")
    } == {
        "plan": "world",
        "local_plan": "wheels",
        "local_costmap/costmap": "wheels",
    }
    assert {decode.markers(frames[name]).frame for name in ("band", "candidates")} == {
        "wheels"
    }


def test_commands_of_either_type():
    velocity = Velocity2D(0.5, -0.25)
    topic, data = PlannerMessages(Frames()).command(velocity, STAMP)
    assert (topic, decode.twist(data)) == (topics.CMD_VEL, velocity)
    topic, data = PlannerMessages(Frames(base="robot"), stamped=True).command(
        velocity, STAMP
    )
    assert (topic, decode.twist_stamped(data)) == (topics.CMD_VEL_STAMPED, velocity)
    assert decode.header(data) == (STAMP, "robot")
