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


def marker(namespace, kind, index=0, color=(0.0, 0.0, 0.0, 0.0), **fields):
    rgba = ColorRGBA(**dict(zip("rgba", color, strict=True)))
    return Marker(
        header=HEADER, ns=namespace, id=index, type=kind, color=rgba, **fields
    )


def cleared(namespace, *markers):
    """Return a message that takes the place of all markers before."""
    clear = Marker(header=HEADER, ns=namespace, action=Marker.DELETEALL)
    return MarkerArray(markers=[clear, *markers])


def to_band(band):
    discs = [
        marker(
            "bubbles",
            Marker.CYLINDER,
            index,
            (0.1, 0.5, 0.9, 0.3),
            pose=Pose(position=Point(x=x, y=y)),
            scale=Vector3(x=2.0 * radius, y=2.0 * radius, z=0.01),
        )
        for index, (x, y, radius) in enumerate(band.tolist())
    ]
    line = marker("band", Marker.LINE_STRIP, 0, (0.9, 0.3, 0.1, 1.0))
    line.scale.x = 0.02
    line.points = [Point(x=x, y=y) for x, y, _ in band.tolist()]
    return cleared("band", *discs, line)


def to_candidates(selection):
    lines = []
    for points, color in zip(
        selection.points.tolist(), selection.colors.tolist(), strict=True
    ):
        line = marker("candidates", Marker.LINE_STRIP, len(lines), color)
        line.scale.x = 0.01
        line.points = [Point(x=x, y=y) for x, y in points]
        lines.append(line)
    return cleared("candidates", *lines)


def to_diagnostics(decision, name):
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


def as_read(message, length, type_name):
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
    expected = to_candidates(selection)
    assert ours == as_read(expected, len(ours), topics.CANDIDATES.type_name)
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
    now_ns = round(time_s * NANOSECONDS_PER_SECOND)
    shown = messages.display(planner or Shower(), decision, now_ns, accepts)
    return {topic.name: data for topic, data in shown}


@pytest.mark.parametrize("status", list(PlannerStatus))
@pytest.mark.parametrize("reason", ["", "no way through"])
def test_diagnostics(status, reason):
    figures = {"cost": 12.3456789, "samples": 20.0, "unknown": np.nan}
    decision = Decision(STOP, status, reason, diagnostics=figures)
    ours = messages_of(PlannerMessages(Frames(), "dwa"), decision, 3.25)["diagnostics"]
    expected = to_diagnostics(decision, "dwa")
    assert ours == as_read(expected, len(ours), topics.DIAGNOSTICS.type_name)
    assert decode.diagnostics(ours)[0]["status"] == status.value


VIEWS = {"local_plan", "local_costmap/costmap", "band", "candidates"}
PLANNED = Decision(STOP, plan=np.zeros((2, 2)))


def test_views_come_twice_a_second_diagnostics_on_change():
    messages = PlannerMessages(Frames())
    blocked = Decision(STOP, PlannerStatus.BLOCKED)
    for decision, time_s, names in (
        (PLANNED, 0.0, VIEWS | {"plan", "diagnostics"}),
        (PLANNED, 0.45, set()),
        (PLANNED, 0.5, VIEWS | {"plan"}),
        (blocked, 0.55, {"diagnostics"}),
        (blocked, 0.9, set()),
        (blocked, 1.5, VIEWS),
        (PLANNED, 1.52, {"plan", "diagnostics"}),
    ):
        assert set(messages_of(messages, decision, time_s)) == names, time_s
    messages.reset()
    assert set(messages_of(messages, PLANNED, 0.1)) == VIEWS | {"plan", "diagnostics"}


def test_a_plan_is_published_when_due_or_changed():
    messages = PlannerMessages(Frames(), view_period_s=1.0)
    assert "plan" not in messages_of(messages, Decision(STOP), 0.0)
    assert "plan" in messages_of(messages, PLANNED, 0.3)
    assert "plan" not in messages_of(messages, PLANNED, 1.25)
    assert "plan" in messages_of(messages, PLANNED, 1.3)


def test_a_cycle_without_a_command_tells_no_status():
    names = set(messages_of(PlannerMessages(Frames()), Decision(None), 0.0))
    assert "diagnostics" not in names


def test_warming_up_leaves_nothing_behind():
    messages = PlannerMessages(Frames())
    planner = Shower()
    messages.warm_up(planner)
    assert planner.requests == 1
    assert set(messages_of(messages, PLANNED, 0.1)) == VIEWS | {"plan", "diagnostics"}


def test_only_what_is_wanted_is_made():
    messages = PlannerMessages(Frames())
    planner = Shower()
    assert messages_of(messages, PLANNED, 0.0, lambda _: False, planner) == {}
    assert planner.requests == 0
    # a plan that nobody wanted has not been shown; views are looked at again after their period
    assert set(messages_of(messages, PLANNED, 0.1, planner=planner)) == {"plan"}

    def is_band(topic):
        return topic is topics.BAND

    assert set(messages_of(messages, PLANNED, 0.5, is_band, planner)) == {"band"}
    assert planner.requests == 1


def test_frames_are_those_of_the_planner():
    messages = PlannerMessages(Frames(odom="wheels", planning="world"))
    data = messages_of(messages, PLANNED, 0.0)
    assert decode.header(data["plan"]).frame == "world"
    for name in ("local_plan", "local_costmap/costmap"):
        assert decode.header(data[name]).frame == "wheels"
    for name in ("band", "candidates"):
        assert decode.markers(data[name]).frame == "wheels"


def test_commands_of_either_type():
    velocity = Velocity2D(0.5, -0.25)
    topic, data = PlannerMessages(Frames()).command(velocity, STAMP)
    assert (topic, decode.twist(data)) == (topics.CMD_VEL, velocity)
    messages = PlannerMessages(Frames(base="robot"), stamped=True)
    topic, data = messages.command(velocity, STAMP)
    assert (topic, decode.twist_stamped(data)) == (topics.CMD_VEL_STAMPED, velocity)
    assert decode.header(data) == (STAMP, "robot")
