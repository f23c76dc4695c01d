"""The publishers of the simulator node: transforms only where tf2_msgs is installed, and the quality of the scans."""

from unittest.mock import Mock

import pytest

pytest.importorskip("rclpy")

from barn_sim.config import SimulatorConfig, SimulatorNodeConfig
from barn_sim.messages import SimulatorMessages
from barn_sim.ros.topics import Outputs
from barn_worlds.base.types import ORIGIN
from barn_worlds.messages.topics import TF
from barn_worlds.ros import topics


def test_without_tf2_msgs_transforms_are_off_and_that_is_said(monkeypatch):
    def find_message_class(name):
        return None if name == TF.type_name else object

    monkeypatch.setattr(topics, "find_message_class", find_message_class)
    node = Mock()
    messages = SimulatorMessages(SimulatorConfig())
    transforms = messages.transforms(ORIGIN, 5)
    outputs = Outputs(node, SimulatorNodeConfig())
    outputs.publish([*messages.constant(), transforms])
    paths = {call.args[1] for call in node.create_publisher.call_args_list}
    assert not {"/tf", "/tf_static"} & paths
    (_, description), _ = messages.constant()
    node.create_publisher().publish.assert_called_once_with(description)
    assert "tf2_msgs" in str(node.get_logger().info.mock_calls)


@pytest.mark.parametrize(
    "config, reliable",
    [
        (SimulatorNodeConfig(lockstep=True), True),
        (SimulatorNodeConfig(), True),
        (SimulatorNodeConfig(lockstep=True, scan_reliability="best_effort"), False),
    ],
)
def test_scans_are_reliable_unless_said_otherwise(config, reliable):
    node = Mock()
    Outputs(node, config)
    calls = [call.args for call in node.create_publisher.call_args_list]
    reliabilities = {topic: profile.reliability.name for _, topic, profile in calls}
    assert (reliabilities["scan"] == "RELIABLE") is reliable
    assert reliabilities["odom"] == "RELIABLE"
