"""Selecting the part of the global plan that a local planner needs."""

import numpy as np

from barn_planners.interface import FloatArray
from barn_worlds.types import Pose2D


def moved_plan(plan: FloatArray, frame: Pose2D) -> FloatArray:
    """Return a plan (n, 3), which is relative to `frame`, in the frame that `frame` is given in."""
    moved = np.empty_like(plan)
    moved[:, :2] = frame.transform(plan[:, :2])
    moved[:, 2] = (plan[:, 2] + frame.yaw + np.pi) % (2.0 * np.pi) - np.pi
    return moved


def visible_slice(plan: FloatArray, pose: Pose2D, radius_m: float) -> slice:
    """Return the part of a plan (n, 2 or more) that is within the radius of the pose, up to where it leaves it."""
    near = np.hypot(plan[:, 0] - pose.x, plan[:, 1] - pose.y) <= radius_m
    if not near.any():
        return slice(0, 0)
    first = int(np.argmax(near))
    beyond = ~near[first:]
    return slice(first, first + int(np.argmax(beyond)) if beyond.any() else len(plan))


def passed_points(plan: FloatArray, pose: Pose2D, keep_m: float) -> int:
    """Return the number of points before the first one nearer than `keep_m` to the pose; all if there is none."""
    near = np.hypot(plan[:, 0] - pose.x, plan[:, 1] - pose.y) < keep_m
    return int(np.argmax(near)) if near.any() else len(plan)
