"""Clouds of points as arrays of numpy, and back."""

import sys

import numpy as np
from numpy.lib.recfunctions import (
    structured_to_unstructured,
    unstructured_to_structured,
)
from sensor_msgs.msg import PointCloud2, PointField

_KINDS = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}
DUMMY_FIELD_PREFIX = "unnamed_field"


def dtype_from_fields(fields, point_step=None):
    """Return the structured dtype of a cloud's points."""
    names = []
    formats = []
    offsets = []
    for place, field in enumerate(fields):
        name = field.name or f"{DUMMY_FIELD_PREFIX}_{place}"
        for number in range(max(1, field.count)):
            kind = np.dtype(_KINDS[field.datatype])
            names.append(name if field.count <= 1 else f"{name}_{number}")
            formats.append(kind)
            offsets.append(field.offset + number * kind.itemsize)
    content = {"names": names, "formats": formats, "offsets": offsets}
    if point_step is not None:
        content["itemsize"] = point_step
    return np.dtype(content)


def read_points(
    cloud, field_names=None, skip_nans=False, uvs=None, reshape_organized_cloud=False
):
    """Return a cloud's points as a structured array.

    Args:
        cloud: PointCloud2.
        field_names: Which fields, by default all.
        skip_nans: Leave out points of which a number is NaN.
        uvs: Which points, by number.
        reshape_organized_cloud: Keep rows and columns of the cloud.
    """
    dtype = dtype_from_fields(cloud.fields, cloud.point_step)
    points = np.ndarray(cloud.width * cloud.height, dtype, buffer=cloud.data)
    if bool(cloud.is_bigendian) != (sys.byteorder == "big"):
        points = points.byteswap()
    if field_names is not None:
        points = points[list(field_names)]
    if skip_nans and not cloud.is_dense:
        is_whole = np.ones(len(points), dtype=bool)
        for name in points.dtype.names:
            is_whole &= ~np.isnan(points[name])
        points = points[is_whole]
    if uvs is not None:
        points = points[np.asarray(list(uvs))]
    if reshape_organized_cloud and cloud.height > 1:
        points = points.reshape(cloud.width, cloud.height)
    return points


def read_points_numpy(
    cloud, field_names=None, skip_nans=False, uvs=None, reshape_organized_cloud=False
):
    """Return a cloud's points as a plain array, a row for each; fields of one type."""
    points = read_points(cloud, field_names, skip_nans, uvs, reshape_organized_cloud)
    return structured_to_unstructured(points)


def read_points_list(cloud, field_names=None, skip_nans=False, uvs=None):
    """Return a cloud's points as a list of tuples."""
    return read_points(cloud, field_names, skip_nans, uvs).tolist()


def create_cloud(header, fields, points, step=None):
    """Return a PointCloud2 of an array, or of a list of points.

    Args:
        header: Header of the message.
        fields: PointField of each number.
        points: Structured or plain array, or a list of tuples.
        step: Bytes of a point, by default as the fields need.
    """
    dtype = dtype_from_fields(fields, step)
    points = np.asarray(points) if len(points) else np.empty(0, dtype)
    if points.dtype.names is None:
        points = unstructured_to_structured(points, dtype)
    points = np.ascontiguousarray(points.astype(dtype))
    height, width = (1, len(points)) if points.ndim < 2 else points.shape[:2]
    cloud = PointCloud2(header=header, height=height, width=width, fields=fields)
    cloud.is_bigendian = sys.byteorder == "big"
    cloud.point_step = dtype.itemsize
    cloud.row_step = dtype.itemsize * width
    cloud.data = points.tobytes()
    return cloud


def create_cloud_xyz32(header, points, step=None):
    """Return a PointCloud2 of x, y, z as floats of 32 bits."""
    fields = []
    for place, name in enumerate("xyz"):
        fields.append(
            PointField(
                name=name, offset=4 * place, datatype=PointField.FLOAT32, count=1
            )
        )
    return create_cloud(header, fields, points, step)
