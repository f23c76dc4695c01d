"""Messages of geometry in another frame, as tf2_geometry_msgs offers them."""

import numpy as np
import tf2_ros
from geometry_msgs.msg import (
    Point,
    Point32,
    PointStamped,
    PolygonStamped,
    Pose,
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    Vector3,
    Vector3Stamped,
)
from tf2_py import multiply, rotate


def _turn(transform):
    turn = transform.transform.rotation
    return (turn.x, turn.y, turn.z, turn.w)


def _move(point, transform):
    """Return x, y, z of a point in the target frame."""
    x, y, z = rotate(_turn(transform), (point.x, point.y, point.z))
    shift = transform.transform.translation
    return {"x": x + shift.x, "y": y + shift.y, "z": z + shift.z}


def do_transform_point(point, transform):
    """Return a PointStamped in the target frame."""
    moved = Point(**_move(point.point, transform))
    return PointStamped(header=transform.header, point=moved)


def do_transform_vector3(vector3, transform):
    """Return a Vector3Stamped in the target frame, which only turns it."""
    vector = vector3.vector
    x, y, z = rotate(_turn(transform), (vector.x, vector.y, vector.z))
    return Vector3Stamped(header=transform.header, vector=Vector3(x=x, y=y, z=z))


def do_transform_pose(pose, transform):
    """Return a Pose in the target frame."""
    turn = pose.orientation
    product = multiply(_turn(transform), (turn.x, turn.y, turn.z, turn.w))
    # Of the two quaternions of a rotation, the original gives that with w above 0.
    x, y, z, w = product if product[3] >= 0.0 else [-value for value in product]
    return Pose(
        position=Point(**_move(pose.position, transform)),
        orientation=Quaternion(x=x, y=y, z=z, w=w),
    )


def do_transform_pose_stamped(pose, transform):
    """Return a PoseStamped in the target frame."""
    return PoseStamped(
        header=transform.header, pose=do_transform_pose(pose.pose, transform)
    )


def transform_covariance(cov_in, transform):
    """Return a 6 x 6 covariance, as 36 numbers, in the target frame."""
    columns = [rotate(_turn(transform), axis) for axis in np.eye(3)]
    turn = np.kron(np.eye(2), np.array(columns).T)
    covariance = turn @ np.reshape(cov_in, (6, 6)) @ turn.T
    return covariance.ravel()


def do_transform_pose_with_covariance_stamped(pose, transform):
    """Return a PoseWithCovarianceStamped in the target frame."""
    result = PoseWithCovarianceStamped(header=transform.header)
    result.pose.pose = do_transform_pose(pose.pose.pose, transform)
    result.pose.covariance = transform_covariance(pose.pose.covariance, transform)
    return result


def do_transform_polygon_stamped(polygon, transform):
    """Return a PolygonStamped in the target frame."""
    result = PolygonStamped(header=transform.header)
    for point in polygon.polygon.points:
        result.polygon.points.append(Point32(**_move(point, transform)))
    return result


for _type, _function in (
    (PointStamped, do_transform_point),
    (Vector3Stamped, do_transform_vector3),
    (PoseStamped, do_transform_pose_stamped),
    (PoseWithCovarianceStamped, do_transform_pose_with_covariance_stamped),
    (PolygonStamped, do_transform_polygon_stamped),
):
    tf2_ros.TransformRegistration().add(_type, _function)
    tf2_ros.ConvertRegistration().add_to_msg(_type, lambda message: message)
    tf2_ros.ConvertRegistration().add_from_msg(_type, lambda message: message)
