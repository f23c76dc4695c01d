"""Messages keep what they are given: to the bit where doubles carry it, to float32 where the message does."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from barn_worlds.ros import conversions as convert
from barn_worlds.types import OccupancyMap, Odometry, Pose2D, Scan, Velocity2D

metres = st.floats(-1e3, 1e3)
yaws = st.floats(-math.pi, math.pi)


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_return_exactly(stamp_ns):
    assert convert.from_time(convert.to_time(stamp_ns)) == stamp_ns


@given(metres, metres, yaws)
def test_pose_returns_as_through_quaternion(x, y, yaw):
    pose = Pose2D(x, y, yaw)
    back = convert.from_pose(convert.to_pose(pose))
    assert back == pose.through_quaternion()
    assert math.isclose(math.cos(back.yaw - yaw), 1.0, abs_tol=1e-12)


@given(metres, metres, yaws, metres, metres)
def test_odometry_returns(x, y, yaw, v, w):
    odometry = Odometry(1_234_567_890, Pose2D(x, y, yaw), Velocity2D(v, w))
    back = convert.from_odometry(convert.to_odometry(odometry, "odom", "base_link"))
    assert back == Odometry(1_234_567_890, odometry.pose.through_quaternion(), Velocity2D(v, w))


def test_scan_keeps_infinities_and_nan():
    ranges = np.array([1.5, np.inf, -np.inf, np.nan], np.float32)
    message = convert.to_scan(Scan(5, ranges, -1.0, 0.5, 0.1, 30.0), "laser", 0.05)
    back = convert.from_scan(message)
    np.testing.assert_array_equal(back.ranges, ranges)
    assert message.angle_max == pytest.approx(0.5)
    assert back.stamp_ns == 5


def test_either_kind_of_command_is_read():
    velocity = Velocity2D(0.4, -1.1)
    assert convert.from_twist(convert.to_twist(velocity)) == velocity
    assert convert.from_twist(convert.to_twist_stamped(velocity, 7, "base_link")) == velocity


def test_map_returns_and_a_wrong_size_is_refused():
    grid = OccupancyMap(np.arange(6, dtype=np.int8).reshape(2, 3), 0.25, -4.5, 0.0)
    message = convert.to_occupancy_grid(grid, 0, "map")
    back = convert.from_occupancy_grid(message)
    np.testing.assert_array_equal(back.data, grid.data)
    assert (message.info.width, message.info.height, back.origin_x) == (3, 2, -4.5)
    message.info.width = 4
    with pytest.raises(ValueError, match="6 cells"):
        convert.from_occupancy_grid(message)


def test_path_takes_points_and_poses():
    path = convert.to_path(np.array([[0.0, 1.0], [2.0, 3.0]]), 9, "map")
    assert [pose.pose.position.y for pose in path.poses] == [1.0, 3.0]
    turned = convert.to_path(np.array([[0.0, 0.0, 1.0]]), 9, "map")
    assert convert.from_pose(turned.poses[0].pose).yaw == pytest.approx(1.0)
