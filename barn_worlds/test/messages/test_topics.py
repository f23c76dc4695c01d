"""The catalog of topics: what it says can be had, and rclpy is given just that."""

import pytest

from barn_worlds.messages import topics
from barn_worlds.messages.cdr import jazzy_types
from barn_worlds.messages.topics import (
    BEST_EFFORT,
    FRAMES,
    LATCHED,
    RELIABLE,
    Frames,
    Topic,
)

ALL = {name: value for name, value in vars(topics).items() if isinstance(value, Topic)}


@pytest.mark.parametrize("topic", ALL.values(), ids=list(ALL))
def test_types_are_known_and_latched_topics_keep_one_message(topic):
    assert topic.type_name in jazzy_types().fielddefs
    assert FRAMES.of(topic) in {"map", "odom", "base_link", "lidar_link", ""}
    assert bool(topic.frame) is bool(FRAMES.of(topic))
    assert (topic.qos.durability == "transient_local") is (topic.qos == LATCHED)
    assert topic.path.startswith("/") and topic.path.endswith(topic.name)


def test_a_name_has_two_entries_only_where_type_or_sender_differ():
    shared = {
        topic.path: [entry for entry in ALL.values() if entry.path == topic.path]
        for topic in ALL.values()
    }
    assert {path for path, both in shared.items() if len(both) > 1} == {
        "/cmd_vel",
        "/plan",
        "/diagnostics",
    }
    assert len(shared) == len(ALL) - 3


def test_frames_are_those_of_the_node():
    frames = Frames("world", "wheels", "robot", "laser", planning="world")
    fixed = (topics.GROUND_TRUTH, topics.PLAN)
    moving = (topics.ODOM, topics.SCAN, topics.CMD_VEL_STAMPED, topics.CLOCK)
    assert [frames.of(topic) for topic in (*fixed, *moving)] == [
        "world",
        "world",
        "wheels",
        "laser",
        "robot",
        "",
    ]


def test_qualities_of_service_in_rclpy():
    rclpy_qos = pytest.importorskip("rclpy.qos", reason="ROS 2 is not installed")
    from barn_worlds.ros.topics import qos_profile  # noqa: PLC0415

    assert qos_profile(BEST_EFFORT) == rclpy_qos.qos_profile_sensor_data
    assert qos_profile(RELIABLE) == rclpy_qos.QoSProfile(depth=10)
    latched = qos_profile(LATCHED)
    assert latched.durability is rclpy_qos.DurabilityPolicy.TRANSIENT_LOCAL
    assert (latched.reliability, latched.depth) == (
        rclpy_qos.ReliabilityPolicy.RELIABLE,
        1,
    )


def test_every_type_has_its_class_or_none():
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from barn_worlds.ros.topics import find_message_class  # noqa: PLC0415

    for topic in ALL.values():
        kind = find_message_class(topic.type_name)
        if kind is None:
            assert topic.type_name == "tf2_msgs/msg/TFMessage"
        else:
            assert kind.__name__ == topic.type_name.rpartition("/")[2]
    assert find_message_class("no_such_msgs/msg/Thing") is None
