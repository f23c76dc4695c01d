"""The publishers of the simulator node: transforms only where tf2_msgs is installed, and the quality of the scans."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from barn_sim.config import SimulatorConfig, SimulatorNodeConfig
from barn_sim.messages import SimulatorMessages
from barn_sim.ros.topics import Outputs
from barn_worlds.base.types import Pose2D
from barn_worlds.messages.topics import TF
from barn_worlds.ros import topics


class RecordingNode:
    """Keeps what is published."""

    def __init__(self) -> None:
        self.sent: dict[str, list[bytes]] = {}
        self.profiles: dict[str, object] = {}
        self.said: list[str] = []

    def create_publisher(self, _kind, topic, profile):
        self.profiles[topic] = profile
        return SimpleNamespace(publish=self.sent.setdefault(topic, []).append)

    def get_logger(self):
        return SimpleNamespace(info=self.said.append)


@pytest.fixture
def node() -> RecordingNode:
    return RecordingNode()


def without_transforms(type_name: str):
    return None if type_name == TF.type_name else SimpleNamespace


def test_without_tf2_msgs_transforms_are_off_and_that_is_said(node, monkeypatch) -> None:
    monkeypatch.setattr(topics, "message_class", without_transforms)
    messages = SimulatorMessages(SimulatorConfig())
    Outputs(node, SimulatorNodeConfig()).publish([*messages.constant(), messages.transforms(Pose2D(0.0, 0.0, 0.0), 5)])
    assert not {"/tf", "/tf_static"} & set(node.sent)
    assert len(node.sent["robot_description"]) == 1
    assert any("tf2_msgs" in line for line in node.said)


@pytest.mark.parametrize(
    ("config", "reliable"),
    [
        (SimulatorNodeConfig(lockstep=True), True),
        (SimulatorNodeConfig(), False),
        (SimulatorNodeConfig(scan_reliability="reliable"), True),
        (SimulatorNodeConfig(lockstep=True, scan_reliability="best_effort"), False),
    ],
)
def test_scans_are_reliable_in_lockstep_unless_said_otherwise(
    node, config: SimulatorNodeConfig, reliable: bool
) -> None:
    Outputs(node, config)
    assert (node.profiles["scan"].reliability.name == "RELIABLE") is reliable
    assert node.profiles["odom"].reliability.name == "RELIABLE"
