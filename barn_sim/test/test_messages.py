"""What a simulated robot publishes: every reading, in order, at the time on the clock."""

from dataclasses import replace

import numpy as np
import pytest

from barn_sim.config import PRESETS, LidarConfig, LocalizationConfig, SimulatorConfig
from barn_sim.messages import SimulatorMessages
from barn_sim.sensors.readings import Joints, Sensors
from barn_worlds.base.types import ORIGIN, Odometry, Pose2D, Scan, Velocity2D
from barn_worlds.messages import decode
from barn_worlds.messages.cdr import deserialize
from barn_worlds.messages.topics import AMCL_POSE, JOINT_STATES, ODOM, SCAN, TF, Frames

STAMP = 3_500_000_000
BELIEVED = Pose2D(1.0, 2.0, 0.7)
MEASURED = Pose2D(0.4, -0.1, -0.5)
TRUE = Pose2D(1.1, 2.1, 0.75)
SENSORS = Sensors(
    stamp_ns=500_000_000,
    odometry=Odometry(500_000_000, MEASURED, Velocity2D(0.5, 0.1)),
    scan=Scan(
        500_000_000, np.linspace(0.5, 8.0, 16, dtype=np.float32), -1.5, 0.2, 0.125, 30.0
    ),
    truth=Odometry(500_000_000, TRUE, Velocity2D(0.4, 0.2)),
    localization=BELIEVED,
    collision=True,
    joints=Joints((1.0, 2.0, 3.0, 4.0), (5.0, 6.0, 7.0, 8.0)),
)


def test_an_instant_has_the_time_first_and_the_scan_last():
    sent = list(SimulatorMessages(SimulatorConfig()).sensors(SENSORS, STAMP))
    data = {topic.path: data for topic, data in sent}
    assert list(data) == [
        "/clock", "/odom", "/ground_truth/odom", "/amcl_pose", "/tf", "/collision", "/joint_states", "/scan",
    ]  # fmt: skip
    assert len(sent) == len(data)
    assert decode.clock(data["/clock"]) == STAMP
    frames = {
        "/odom": "odom",
        "/ground_truth/odom": "map",
        "/amcl_pose": "map",
        "/joint_states": "",
        "/scan": "lidar_link",
    }
    for path, frame in frames.items():
        assert decode.header(data[path]) == (STAMP, frame)
    assert deserialize(data["/odom"], ODOM.type_name).child_frame_id == "base_link"
    for path, pose, velocity in (
        ("/odom", MEASURED, Velocity2D(0.5, 0.1)),
        ("/ground_truth/odom", TRUE, Velocity2D(0.4, 0.2)),
    ):
        expected = Odometry(STAMP, pose.through_quaternion(), velocity)
        assert decode.odometry(data[path]) == expected
    believed = decode.pose_with_covariance(data["/amcl_pose"])
    assert believed == BELIEVED.through_quaternion()
    assert decode.boolean(data["/collision"]) is True
    ranges = decode.scan(data["/scan"]).ranges
    np.testing.assert_array_equal(ranges, SENSORS.scan.ranges)
    joints = deserialize(data["/joint_states"], JOINT_STATES.type_name)
    assert joints.position.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert joints.velocity.tolist() == [5.0, 6.0, 7.0, 8.0]
    assert joints.name[0] == "front_left_wheel_joint"


@pytest.mark.parametrize(
    "since", [ORIGIN, Pose2D(0.1, 0.0, 0.05)], ids=["at once", "later"]
)
def test_transforms_lead_to_the_robot_between_localizations(since):
    messages = SimulatorMessages(SimulatorConfig(), Frames(map="world"))
    messages.localization(BELIEVED, MEASURED, STAMP)
    _, data = messages.transforms(MEASURED @ since, STAMP)
    first, second = decode.transforms(data)
    assert (first.parent, first.child) == ("world", "odom")
    assert (second.parent, second.child) == ("odom", "base_link")
    found = first.pose @ second.pose
    assert found.numbers == pytest.approx((BELIEVED @ since).numbers)


def test_first_transforms_are_those_of_the_start():
    start = Pose2D(-3.0, 4.075, 1.25)
    messages = SimulatorMessages(SimulatorConfig(), start=start)
    for stamp_s in (1, 2):
        _, data = messages.last_transforms(stamp_s * 10**9)
        first, second = decode.transforms(data)
        assert (first.pose @ second.pose).numbers == pytest.approx(start.numbers)
        for transform in deserialize(data, TF.type_name).transforms:
            assert transform.header.stamp.sec == stamp_s


def test_what_stands_still_is_told_once():
    lidar = LidarConfig(mount_x_m=0.12, mount_z_m=0.3)
    config = replace(SimulatorConfig(), lidar=lidar)
    messages = SimulatorMessages(config, Frames(base="robot", lidar="laser"))
    (description, text), (fixed, data) = messages.constant()
    assert (description.path, fixed.path) == ("/robot_description", "/tf_static")
    assert 'xyz="0.12 0 0.3"' in decode.text(text)
    transforms = deserialize(data, fixed.type_name).transforms
    by_child = {transform.child_frame_id: transform for transform in transforms}
    where = by_child["laser"].transform.translation
    assert (where.x, where.y, where.z) == (0.12, 0.0, 0.3)
    assert "base_footprint" in by_child and "lidar_link" not in by_child
    for transform in transforms:
        assert transform.header.frame_id == "robot"
        assert transform.header.stamp.sec == 0


@pytest.mark.parametrize(
    "mode, expected", [("exact", (0.0, 0.0)), ("amcl", (0.04, 0.01))]
)
def test_localization_variance_is_stated_unless_exact(mode, expected):
    localisation = LocalizationConfig(mode=mode, position_std_m=0.2, yaw_std_rad=0.1)
    config = replace(SimulatorConfig(), localisation=localisation)
    _, data = SimulatorMessages(config).localization(BELIEVED, MEASURED, STAMP)
    covariance = deserialize(data, AMCL_POSE.type_name).pose.covariance
    assert (covariance[0], covariance[35]) == pytest.approx(expected)
    assert covariance[7] == covariance[0]
    assert np.count_nonzero(covariance) == (0 if mode == "exact" else 3)


@pytest.mark.parametrize(
    "period_s, expected",
    [(None, PRESETS["paper2020"].control_period_s), (0.025, 0.025)],
)
def test_a_scan_says_how_long_it_is_to_the_next(period_s, expected):
    messages = SimulatorMessages(PRESETS["paper2020"], scan_period_s=period_s)
    _, data = messages.scan(SENSORS.scan, STAMP)
    assert deserialize(data, SCAN.type_name).scan_time == pytest.approx(expected)
