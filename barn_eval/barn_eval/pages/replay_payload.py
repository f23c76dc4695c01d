"""What the replay page draws from: a recorded trial as small arrays in one frame."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_eval.bags.recorded import Floats, Recorded, Shown
from barn_eval.experiments.track import pack
from barn_worlds.types import OccupancyMap, Pose2D

MOST_BEAMS = 240
MOST_POINTS = 120
MOST_COSTMAPS = 120
_NO_RANGE = 65535
_COST_LEVELS = 12


def payload(recorded: Recorded) -> dict[str, Any]:
    """Return the data of a replay page: `pack`ed arrays and what describes them."""
    arrays: dict[str, npt.NDArray[Any]] = {
        "times": recorded.times_s.astype("f4"),
        "poses": recorded.poses.astype("f4"),
        "speeds": recorded.speeds.astype("f4"),
        "commands": recorded.commands.astype("f4"),
        "contact": recorded.contact.astype("u1"),
    }
    content: dict[str, Any] = {
        "extent": recorded.extent.tolist(),
        "lidar": [recorded.lidar.x, recorded.lidar.y, recorded.lidar.yaw],
        "bounds": bounds(recorded),
        "goal": _goal(recorded),
        "frame": recorded.frame,
    }
    arrays["score_times"] = np.array([shown.time_s for shown in recorded.scores], "f4")
    arrays["scores"] = np.array([shown.content for shown in recorded.scores], "f4")
    content["outcomes"] = [[shown.time_s, shown.content] for shown in recorded.outcomes]
    if recorded.map is not None:
        content["map"] = _grid(recorded.map, Pose2D(0.0, 0.0, 0.0))
        arrays["map"] = (recorded.map.data.ravel() >= 50).astype("u1") + 2 * (recorded.map.data.ravel() < 0).astype(
            "u1"
        )
    content["scan"] = _scans(recorded, arrays)
    _lines(recorded, "plan", recorded.plans, lambda content: [content], arrays)
    _lines(recorded, "local_plan", recorded.local_plans, lambda content: [content], arrays)
    _lines(recorded, "candidates", recorded.candidates, lambda content: content.lines, arrays)
    _lines(recorded, "band", recorded.bands, lambda content: content.lines, arrays)
    _discs(recorded, arrays)
    content["costmaps"] = _costmaps(recorded, arrays)
    return content | {"packed": pack(arrays)}


def bounds(recorded: Recorded) -> list[float]:
    """Return x_min, y_min, x_max, y_max of what is to be seen, metres: the map, or the trail with a margin."""
    known, goal = recorded.map, _goal(recorded)
    margin_m = 1.0 if known is None else 0.5
    low, high = recorded.poses[:, :2].min(axis=0) - margin_m, recorded.poses[:, :2].max(axis=0) + margin_m
    if goal is not None:
        low, high = np.minimum(low, np.array(goal[:2]) - 0.5), np.maximum(high, np.array(goal[:2]) + 0.5)
    if known is not None:
        size = np.array(known.data.shape[::-1]) * known.resolution
        corner = np.array([known.origin_x, known.origin_y])
        low, high = np.minimum(low, corner), np.maximum(high, corner + size)
    return [*low.tolist(), *high.tolist()]


def _goal(recorded: Recorded) -> list[float] | None:
    goal = recorded.goal_pose()
    return None if goal is None else [goal.x, goal.y, goal.yaw]


def _grid(grid: OccupancyMap, where: Pose2D) -> list[float]:
    """Return width, height, resolution, corner and the pose of the frame it is in."""
    rows, columns = grid.data.shape
    return [columns, rows, grid.resolution, grid.origin_x, grid.origin_y, where.x, where.y, where.yaw]


def _scans(recorded: Recorded, arrays: dict[str, npt.NDArray[Any]]) -> dict[str, float] | None:
    """Add the ranges of evenly chosen beams in centimetres; scans of another shape than the first are left out."""
    if not recorded.scans:
        return None
    first = recorded.scans[0].content
    stride = -(-len(first.ranges) // MOST_BEAMS)
    alike = [shown for shown in recorded.scans if len(shown.content.ranges) == len(first.ranges)]
    ranges = np.array([shown.content.ranges[::stride] for shown in alike], np.float64)
    seen = np.isfinite(ranges) & (ranges >= first.range_min) & (ranges < _NO_RANGE / 100.0)
    arrays["scan_times"] = np.array([shown.time_s for shown in alike], "f4")
    arrays["scan_ranges"] = np.where(seen, np.round(np.where(seen, ranges, 0.0) * 100.0), _NO_RANGE).astype("u2")
    return {
        "beams": ranges.shape[1],
        "angle_min": first.angle_min,
        "angle_step": first.angle_increment * stride,
        "no_range": _NO_RANGE,
    }


def _lines(
    recorded: Recorded,
    name: str,
    shown: Sequence[Shown],
    lines_of: Callable[[Any], Sequence[Floats]],
    arrays: dict[str, npt.NDArray[Any]],
) -> None:
    """Add polylines: points, where each line begins among them, and which lines are shown from which time on."""
    points: list[Floats] = []
    first_line = [0]
    for one in shown:
        where = recorded.to_frame(one)
        points += [where.transform(_thinned(line)) for line in lines_of(one.content) if len(line)]
        first_line.append(len(points))
    ends = np.cumsum([0, *(len(line) for line in points)])
    arrays[f"{name}_times"] = np.array([one.time_s for one in shown], "f4")
    arrays[f"{name}_lines"] = np.array(first_line, "i4")
    arrays[f"{name}_ends"] = ends.astype("i4")
    arrays[f"{name}_points"] = np.concatenate([*points, np.empty((0, 2))]).astype("f4")


def _discs(recorded: Recorded, arrays: dict[str, npt.NDArray[Any]]) -> None:
    """Add the bubbles of bands; their times are those of the band's lines."""
    discs, ends = [np.empty((0, 3))], [0]
    for one in recorded.bands:
        where = recorded.to_frame(one)
        found = one.content.discs
        discs.append(np.column_stack([where.transform(found[:, :2]), found[:, 2]]))
        ends.append(ends[-1] + len(found))
    arrays["bubble_ends"] = np.array(ends, "i4")
    arrays["bubbles"] = np.concatenate(discs).astype("f4")


def _costmaps(recorded: Recorded, arrays: dict[str, npt.NDArray[Any]]) -> list[list[float]]:
    """Add costs in a few levels, 0 free and unknown, and return what describes each grid."""
    stride = max(1, -(-len(recorded.costmaps) // MOST_COSTMAPS))
    chosen = recorded.costmaps[::stride]
    levels = [np.ceil(np.clip(one.content.data, 0, 100) * (_COST_LEVELS / 100.0)).astype("u1") for one in chosen]
    arrays["costmap_cells"] = np.concatenate([np.empty(0, "u1"), *(level.ravel() for level in levels)])
    arrays["costmap_times"] = np.array([one.time_s for one in chosen], "f4")
    return [_grid(one.content, recorded.to_frame(one)) for one in chosen]


def _thinned(line: Floats) -> Floats:
    """Return at most `MOST_POINTS` points of a line, both ends among them."""
    if len(line) <= MOST_POINTS:
        return line
    thinned: Floats = line[np.linspace(0, len(line) - 1, MOST_POINTS).round().astype(int)]
    return thinned
