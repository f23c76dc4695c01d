"""What does not need a second process: transforms (tf2_msgs may be missing) and what is published once."""

from __future__ import annotations

import copy
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from barn_sim.config import LidarConfig
from barn_sim.ros import outputs as module
from barn_sim.ros.node_config import RunConfig, SimulatorNodeConfig
from barn_worlds.ros.conversions import from_time
from barn_worlds.types import Pose2D, yaw_from_quaternion


class RecordingNode:
    """Keeps a copy of what is published."""

    def __init__(self) -> None:
        self.sent: dict[str, list] = {}
        self.profiles: dict[str, object] = {}
        self.said: list[str] = []

    def create_publisher(self, _kind, topic, profile):
        self.profiles[topic] = profile
        kept = self.sent.setdefault(topic, [])
        return SimpleNamespace(publish=lambda message: kept.append(copy.deepcopy(message)))

    def get_logger(self):
        return SimpleNamespace(info=self.said.append)


@pytest.fixture
def node() -> RecordingNode:
    return RecordingNode()


def pose_of(transform) -> Pose2D:
    t, q = transform.translation, transform.rotation
    return Pose2D(t.x, t.y, yaw_from_quaternion(q.x, q.y, q.z, q.w))


def test_transforms_lead_from_the_map_to_the_robot(node, monkeypatch) -> None:
    monkeypatch.setattr(module, "TFMessage", SimpleNamespace)
    outputs = module.Outputs(node, SimulatorNodeConfig(map_frame="world"))
    outputs.describe(RunConfig(lidar=LidarConfig(mount_x_m=0.12, mount_z_m=0.3)))
    outputs.stamp(3_500_000_000)
    believed, odometry = Pose2D(1.0, 2.0, 0.7), Pose2D(0.4, -0.1, -0.5)
    outputs.localisation(believed, odometry)
    outputs.transforms(odometry)

    first, second = node.sent["/tf"][0].transforms
    assert (first.header.frame_id, first.child_frame_id) == ("world", "odom")
    assert (second.header.frame_id, second.child_frame_id) == ("odom", "base_link")
    assert from_time(first.header.stamp) == from_time(second.header.stamp) == 3_500_000_000
    whole = pose_of(first.transform) @ pose_of(second.transform)
    assert (whole.x, whole.y, whole.yaw) == pytest.approx((believed.x, believed.y, believed.yaw))

    fixed = {t.child_frame_id: t.transform.translation for t in node.sent["/tf_static"][0].transforms}
    assert (fixed["lidar_link"].x, fixed["lidar_link"].z) == (0.12, 0.3)
    assert "base_footprint" in fixed


def test_without_tf2_msgs_transforms_are_off_and_that_is_said(node, monkeypatch) -> None:
    monkeypatch.setattr(module, "TFMessage", None)
    outputs = module.Outputs(node, SimulatorNodeConfig())
    outputs.describe(RunConfig())
    outputs.transforms(Pose2D(0.0, 0.0, 0.0))
    assert "/tf" not in node.sent
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
    module.Outputs(node, config)
    assert (node.profiles["scan"].reliability.name == "RELIABLE") is reliable
    assert node.profiles["odom"].reliability.name == "RELIABLE"


def test_while_time_stands_still_the_transforms_are_those_of_the_start(node, monkeypatch) -> None:
    monkeypatch.setattr(module, "TFMessage", SimpleNamespace)
    outputs = module.Outputs(node, SimulatorNodeConfig())
    outputs.describe(RunConfig(start_x_m=-3.0, start_y_m=4.075, start_yaw_rad=1.25))
    outputs.stamp(2_000_000_000)
    outputs.repeat_transforms()
    outputs.repeat_transforms()
    assert len(node.sent["/tf"]) == 2
    first, second = node.sent["/tf"][1].transforms
    assert from_time(second.header.stamp) == 2_000_000_000
    whole = pose_of(first.transform) @ pose_of(second.transform)
    assert (whole.x, whole.y, whole.yaw) == pytest.approx((-3.0, 4.075, 1.25))
