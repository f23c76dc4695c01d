"""What planners of others import, in plain Python: transforms, rotations, clouds."""

import importlib
import importlib.util
import math
import sys

import numpy as np
import pytest
import yaml
from repository import ROOT

pytest.importorskip("rclpy", reason="ROS 2 is not installed")
sys.path.insert(0, str(ROOT / "ros_stand_ins"))
import tf2_py
import tf_transformations
from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.duration import Duration
from rclpy.time import Time
from sensor_msgs.msg import PointField
from sensor_msgs_py import point_cloud2
from std_msgs.msg import Header

needs_types = pytest.mark.skipif(
    importlib.util.find_spec("tf2_msgs") is None, reason="tf2_msgs is not built"
)


def transform(parent, child, seconds, x=0.0, yaw=0.0):
    message = TransformStamped(child_frame_id=child)
    message.header = Header(frame_id=parent, stamp=Time(seconds=seconds).to_msg())
    message.transform.translation.x = float(x)
    message.transform.rotation.z = math.sin(yaw / 2.0)
    message.transform.rotation.w = math.cos(yaw / 2.0)
    return message


@pytest.fixture
def buffer():
    """A robot that drives 2 m and turns by 90 degrees in 2 s, with a lidar ahead."""
    core = tf2_py.BufferCore(Duration(seconds=10.0))
    core.set_transform(transform("odom", "base", 10.0), "test")
    core.set_transform(transform("odom", "base", 12.0, 2.0, math.pi / 2.0), "test")
    core.set_transform_static(transform("base", "lidar", 0.0, 1.0), "test")
    core.set_transform_static(transform("house", "door", 0.0, 5.0), "test")
    return core


def test_a_transform_is_interpolated_and_goes_both_ways(buffer):
    there = buffer.lookup_transform_core("odom", "lidar", Time(seconds=11.0))
    shift = there.transform.translation
    corner = math.sqrt(0.5)
    assert [shift.x, shift.y] == pytest.approx([1.0 + corner, corner])
    assert there.transform.rotation.z == pytest.approx(math.sin(math.pi / 8.0))
    assert (there.header.frame_id, there.child_frame_id) == ("odom", "lidar")
    back = buffer.lookup_transform_core("lidar", "odom", Time(seconds=11.0))
    shift = back.transform.translation
    assert [shift.x, shift.y] == pytest.approx([-1.0 - corner, corner])


def test_time_0_is_the_latest_that_frames_have_in_common(buffer):
    buffer.set_transform(transform("map", "odom", 11.0, 7.0), "test")
    latest = buffer.lookup_transform_core("odom", "lidar", Time())
    assert latest.header.stamp.sec == 12
    common = buffer.lookup_transform_core("map", "base", Time())
    assert common.header.stamp.sec == 11
    assert common.transform.translation.x == pytest.approx(8.0)
    fixed = buffer.lookup_transform_core("house", "door", Time())
    assert (fixed.header.stamp.sec, fixed.transform.translation.x) == (0, 5.0)


def test_between_two_times_a_frame_stands_still(buffer):
    where = ("base", Time(seconds=12.0), "base", Time(seconds=10.0), "odom")
    moved = buffer.lookup_transform_full_core(*where).transform
    # Where the robot was, as it sees it after 2 m and a turn to the left.
    assert [moved.translation.x, moved.translation.y] == pytest.approx([0.0, 2.0])


UNKNOWN = r"""
- [odom, lidar, 13.0, Extrapolation, 'into the future.*13\.0.*at time 12\.0']
- [odom, lidar, 9.0, Extrapolation, 'into the past.*9\.0.*at time 10\.0']
- [lidar, odom, 9.0, Extrapolation, 'from frame .odom. to frame .lidar.']
- [odom, door, 11.0, Connectivity, two or more unconnected trees]
- [odom, camera, 11.0, Lookup, '\"camera\" passed to .* does not exist']
- [odom, /base, 11.0, InvalidArgument, "cannot start with a '/'"]
- ["", base, 11.0, InvalidArgument, cannot be empty]
"""


@pytest.mark.parametrize("target, source, seconds, kind, text", yaml.safe_load(UNKNOWN))
def test_what_is_not_known_is_an_error_of_its_kind(
    buffer, target, source, seconds, kind, text
):
    error = getattr(tf2_py, f"{kind}Exception")
    with pytest.raises(error, match=text):
        buffer.lookup_transform_core(target, source, Time(seconds=seconds))
    is_known, reason = buffer.can_transform_core(target, source, Time(seconds=seconds))
    assert not is_known
    assert reason


def test_a_single_entry_is_of_its_time_only():
    core = tf2_py.BufferCore()
    core.set_transform(transform("odom", "base", 10.0, 3.0), "test")
    assert core.can_transform_core("odom", "base", Time(seconds=10.0))[0]
    with pytest.raises(tf2_py.ExtrapolationException, match=r"only time 10\.0"):
        core.lookup_transform_core("odom", "base", Time(seconds=10.5))


def test_old_and_invalid_entries_are_not_kept(buffer):
    buffer.set_transform(transform("odom", "base", 30.0), "test")
    assert not buffer.can_transform_core("odom", "base", Time(seconds=11.0))[0]
    buffer.set_transform(transform("odom", "base", 5.0), "test")
    assert not buffer.can_transform_core("odom", "base", Time(seconds=5.0))[0]
    buffer.set_transform(transform("base", "base", 5.0), "test")
    buffer.set_transform(transform("odom", "arm", 5.0, math.nan), "test")
    assert "arm" not in buffer.all_frames_as_string()
    buffer.clear()
    assert not buffer.can_transform_core("odom", "base", Time())[0]
    assert buffer.can_transform_core("base", "lidar", Time())[0]


def test_a_loop_of_frames_is_an_error():
    core = tf2_py.BufferCore()
    for parent, child in (("a", "b"), ("b", "c"), ("c", "a")):
        core.set_transform(transform(parent, child, 1.0), "test")
    core.set_transform(transform("x", "d", 1.0), "test")
    with pytest.raises(tf2_py.LookupException, match="loop"):
        core.lookup_transform_core("d", "a", Time())


@needs_types
def test_messages_are_transformed_by_their_type():
    tf2_ros = importlib.import_module("tf2_ros")
    importlib.import_module("tf2_geometry_msgs")
    tf_buffer = tf2_ros.Buffer()
    tf_buffer.set_transform(transform("odom", "base", 1.0, 2.0, math.pi / 2.0), "test")
    pose = PoseStamped(header=Header(frame_id="base", stamp=Time(seconds=1.0).to_msg()))
    pose.pose.position.x = 1.0
    pose.pose.orientation.w = 1.0
    moved = tf_buffer.transform(pose, "odom", timeout=Duration(seconds=0.1))
    position = moved.pose.position
    assert [position.x, position.y] == pytest.approx([2.0, 1.0])
    assert moved.pose.orientation.z == pytest.approx(math.sqrt(0.5))
    assert moved.header.frame_id == "odom"
    assert not tf_buffer.can_transform(
        "odom", "base", Time(seconds=2.0), timeout=Duration(seconds=0.05)
    )


@pytest.mark.parametrize("axes", ["sxyz", "rxyz", "rzyx", "szyz"])
def test_angles_about_axes_are_those_of_a_matrix(axes):
    angles = (0.3, 0.5, -0.7)
    steps = []
    for angle, axis in zip(angles, axes[1:], strict=True):
        steps.append(
            tf_transformations.rotation_matrix(angle, np.eye(3)["xyz".index(axis)])
        )
    if axes[0] == "s":
        steps.reverse()
    product = tf_transformations.concatenate_matrices(*steps)
    assert tf_transformations.euler_matrix(*angles, axes) == pytest.approx(product)
    assert tf_transformations.euler_from_matrix(product, axes) == pytest.approx(angles)


def test_quaternions_are_x_y_z_w():
    left = tf_transformations.quaternion_from_euler(0.0, 0.0, math.pi / 2.0)
    assert left == pytest.approx([0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])
    twice = tf_transformations.quaternion_multiply(left, left)
    assert tf_transformations.euler_from_quaternion(twice)[2] == pytest.approx(math.pi)
    same = tf_transformations.quaternion_multiply(
        left, tf_transformations.quaternion_inverse(left)
    )
    assert same == pytest.approx([0.0, 0.0, 0.0, 1.0])


def test_a_cloud_comes_back_as_it_was_made():
    points = np.array([[1.0, 2.0, 3.0], [4.0, math.nan, 6.0]], dtype=np.float32)
    cloud = point_cloud2.create_cloud_xyz32(Header(frame_id="lidar"), points)
    assert (cloud.width, cloud.height, cloud.point_step) == (2, 1, 12)
    assert point_cloud2.read_points_list(cloud, ("x", "z")) == [(1.0, 3.0), (4.0, 6.0)]
    whole = point_cloud2.read_points_numpy(cloud, skip_nans=True)
    assert whole.tolist() == [[1.0, 2.0, 3.0]]
    fields = [
        PointField(name="ring", offset=0, datatype=PointField.UINT16, count=1),
        PointField(name="range", offset=4, datatype=PointField.FLOAT32, count=1),
    ]
    rings = point_cloud2.create_cloud(Header(), fields, [(1, 2.5), (3, 4.5)])
    assert point_cloud2.read_points_list(rings) == [(1, 2.5), (3, 4.5)]


def test_what_is_installed_wins(tmp_path, monkeypatch):
    finder = importlib.import_module("barn_ros_stand_ins").StandInFinder
    assert sys.meta_path[-1] is finder
    assert finder.find_spec("tf2_geometry_msgs").origin.endswith("__init__.py")
    assert finder.find_spec("json") is None
    monkeypatch.delitem(sys.modules, "tf2_geometry_msgs", raising=False)
    (tmp_path / "tf2_geometry_msgs.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    spec = importlib.util.find_spec("tf2_geometry_msgs")
    assert spec.origin == str(tmp_path / "tf2_geometry_msgs.py")
