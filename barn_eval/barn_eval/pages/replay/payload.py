"""What the replay page draws from: a recorded trial as small arrays in one frame."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_eval.bags.movers import LONGEST_BEYOND_S, TRAIL_S
from barn_eval.bags.recorded import Recorded, Shown
from barn_eval.experiments.track import pack
from barn_eval.pages.shape_arrays import in_millimetres, shape_array
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import OccupancyMap, Pose2D

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
        "outline": recorded.outline.plain(),
        "lidar": [recorded.lidar.x, recorded.lidar.y, recorded.lidar.yaw],
        "bounds": bounds(recorded),
        "goal": _goal(recorded),
        "frame": recorded.frame,
        "start": _start(recorded),
        "goal_distance": recorded.scene.goal_distance_m if recorded.scene else 0.0,
        "scene": _scene(recorded, arrays),
        "moving": _moving(recorded, arrays),
        "recoveries": list(recorded.recoveries_s),
    }
    along_m = progress_m(recorded)
    content["along_path"] = along_m is not None
    arrays["progress"] = (np.empty(0) if along_m is None else along_m).astype("f4")
    arrays["clearance"] = recorded.clearance_m.astype("f4")
    arrays["score_times"] = np.array([shown.time_s for shown in recorded.scores], "f4")
    arrays["scores"] = np.array([shown.content for shown in recorded.scores], "f4")
    content["outcomes"] = [[shown.time_s, shown.content] for shown in recorded.outcomes]
    if recorded.map is not None:
        content["map"] = _grid(recorded.map, Pose2D(0.0, 0.0, 0.0))
        arrays["map"] = (recorded.map.data.ravel() >= 50).astype("u1") + 2 * (recorded.map.data.ravel() < 0).astype(
            "u1"
        )
    content["scan"] = _scans(recorded, arrays)
    for name, shown in line_layers(recorded).items():
        _lines(recorded, name, shown, arrays)
    _discs(recorded, arrays)
    content["costmaps"] = _costmaps(recorded, arrays)
    return content | {"packed": pack(arrays)}


def bounds(recorded: Recorded) -> list[float]:
    """Return x_min, y_min, x_max, y_max of what is to be seen, metres: world, map, start, goal and trail."""
    known, scene = recorded.map, recorded.scene
    margin_m = 1.0 if known is None and scene is None else 0.5
    low, high = recorded.poses[:, :2].min(axis=0) - margin_m, recorded.poses[:, :2].max(axis=0) + margin_m
    reach_m = scene.goal_distance_m + 0.1 if scene is not None else 0.5
    ends = [recorded.goal_pose(), scene.start if scene is not None else None]
    seen = [(np.array([[pose.x, pose.y]]), max(0.5, reach_m)) for pose in ends if pose is not None]
    if scene is not None and len(scene.cylinders_m):
        seen.append((scene.cylinders_m, 2.0 * scene.radius_m))
    if recorded.moving is not None and len(recorded.moving.walls.poses):
        seen.append((np.concatenate(recorded.moving.walls.outlines()), 0.25))
    for points, room_m in seen:
        low, high = np.minimum(low, points.min(axis=0) - room_m), np.maximum(high, points.max(axis=0) + room_m)
    if known is not None:
        size = np.array(known.data.shape[::-1]) * known.resolution
        corner = np.array([known.origin_x, known.origin_y])
        low, high = np.minimum(low, corner), np.maximum(high, corner + size)
    return [*low.tolist(), *high.tolist()]


def progress_m(recorded: Recorded) -> Floats | None:
    """Return how far along the path from start over world to goal the robot has come by each time, (n,) metres.

    That is the arc length of the path's nearest point, the largest so far. None where the path is not known.
    """
    scene = recorded.scene
    if scene is None or not len(scene.path_m):
        return None
    first, last = ([[pose.x, pose.y]] if pose else np.empty((0, 2)) for pose in (scene.start, scene.goal))
    path = np.vstack([first, scene.path_m, last])
    steps = np.diff(path, axis=0)
    whole = np.hypot(*steps.T) > 0.0
    origins, steps = path[:-1][whole], steps[whole]
    if not len(steps):
        return None
    lengths = np.hypot(*steps.T)
    offsets = recorded.poses[:, None, :2] - origins
    shares = np.clip((offsets * steps).sum(axis=2) / lengths**2, 0.0, 1.0)
    nearest = np.linalg.norm(offsets - shares[..., None] * steps, axis=2).argmin(axis=1)
    share = shares[np.arange(len(nearest)), nearest]
    furthest: Floats = np.maximum.accumulate(np.cumsum(lengths)[nearest] - lengths[nearest] * (1.0 - share))
    return furthest


def _start(recorded: Recorded) -> list[float] | None:
    start = recorded.scene.start if recorded.scene else None
    return None if start is None else [start.x, start.y, start.yaw]


def _scene(recorded: Recorded, arrays: dict[str, npt.NDArray[Any]]) -> dict[str, float] | None:
    """Add the centres of obstacles, walls and of what has been pushed by the end, and the path; return their radius."""
    scene = recorded.scene
    if scene is None:
        return None
    arrays["obstacles"] = scene.obstacles_m.astype("f4")
    arrays["walls"] = scene.walls_m.astype("f4")
    arrays["pushed"] = recorded.pushed_m.astype("f4")
    arrays["path"] = scene.path_m.astype("f4")
    return {"radius": scene.radius_m}


def _moving(recorded: Recorded, arrays: dict[str, npt.NDArray[Any]]) -> dict[str, Any] | None:
    """Add shapes and places of moving obstacles, and of walls between them; return what describes them."""
    moving = recorded.moving
    if moving is None:
        return None
    there = len(moving.bodies.poses) > 0
    arrays["mover_shapes"], arrays["box_walls"] = shape_array(moving.bodies), shape_array(moving.walls)
    arrays["mover_times"] = moving.times_s.astype("f4")
    arrays["mover_places"], step_m = in_millimetres(moving.places)
    arrays["mover_jumps"] = moving.jumps.astype("u1")
    return {"there": there, "step": step_m, "trail": TRAIL_S, "beyond": LONGEST_BEYOND_S}


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


def line_layers(recorded: Recorded) -> dict[str, Sequence[Shown]]:
    """Return what a planner shows as lines, by the name of the layer."""
    return {
        "plan": recorded.plans,
        "local_plan": recorded.local_plans,
        "candidates": recorded.candidates,
        "band": recorded.bands,
    }


def placed_lines(recorded: Recorded, shown: Shown) -> list[Floats]:
    """Return the lines (k, 2) that were shown, in the frame of the trial's poses."""
    where = recorded.to_frame(shown)
    lines = getattr(shown.content, "lines", [shown.content])  # a plan is a line itself
    return [where.transform(line) for line in lines if len(line)]


def placed_discs(recorded: Recorded, shown: Shown) -> Floats:
    """Return the discs (k, 3) of a band, x, y and radius, in the frame of the trial's poses."""
    found = shown.content.discs
    return np.column_stack([recorded.to_frame(shown).transform(found[:, :2]), found[:, 2]])


def _lines(recorded: Recorded, name: str, shown: Sequence[Shown], arrays: dict[str, npt.NDArray[Any]]) -> None:
    """Add polylines: points, where each line begins among them, and which lines are shown from which time on."""
    points: list[Floats] = []
    first_line = [0]
    for one in shown:
        points += map(_thinned, placed_lines(recorded, one))
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
        discs.append(placed_discs(recorded, one))
        ends.append(ends[-1] + len(discs[-1]))
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
