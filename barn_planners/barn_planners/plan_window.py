"""Cutting the stretch of the global plan that concerns a local planner."""

from __future__ import annotations

import numpy as np

from barn_planners.interface import FloatArray
from barn_worlds.types import Pose2D


def moved_plan(plan: FloatArray, frame: Pose2D) -> FloatArray:
    """Return a plan (n, 3) given in `frame` in the frame that `frame` is given in."""
    moved = np.empty_like(plan)
    moved[:, :2] = frame.transform(plan[:, :2])
    moved[:, 2] = (plan[:, 2] + frame.yaw + np.pi) % (2.0 * np.pi) - np.pi
    return moved


def visible_slice(plan: FloatArray, pose: Pose2D, radius_m: float) -> slice:
    """Return where the plan (n, 2 or more) first comes within the radius of the pose until where it leaves it again."""
    near = np.hypot(plan[:, 0] - pose.x, plan[:, 1] - pose.y) <= radius_m
    if not near.any():
        return slice(0, 0)
    first = int(np.argmax(near))
    beyond = ~near[first:]
    return slice(first, first + int(np.argmax(beyond)) if beyond.any() else len(plan))


def passed_points(plan: FloatArray, pose: Pose2D, keep_m: float) -> int:
    """Return how many points lead the plan before the first one nearer than `keep_m` to the pose; all if none is."""
    near = np.hypot(plan[:, 0] - pose.x, plan[:, 1] - pose.y) < keep_m
    return int(np.argmax(near)) if near.any() else len(plan)
