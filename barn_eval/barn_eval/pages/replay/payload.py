"""What the replay page draws from: a recorded trial as small arrays in one frame."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from barn_eval.results.bags.movers import MAX_EXTRAPOLATION_S, TRAIL_S
from barn_eval.results.bags.recorded import RecordedTrial, TimedItem
from barn_eval.results.tracks import pack_arrays
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import OccupancyMap, Pose2D
from barn_worlds.geometry.bodies import Bodies, moving_bodies, wall_bodies
from barn_worlds.worlds.world import World

Packable = npt.NDArray[Any]
_CLOSED_M = 0.01
_FARTHEST_M = 32.0  # that whole millimetres of two bytes reach
MOST_BEAMS = 240
MOST_POINTS = 120
MOST_COSTMAPS = 120
_NO_RANGE = 65535
_COST_LEVELS = 12


def payload(recorded: RecordedTrial) -> dict[str, Any]:
    """Return the data of a replay page: `pack`ed arrays and what describes them."""
    arrays: dict[str, Packable] = {
        "times": recorded.times_s.astype("f4"),
        "poses": recorded.poses.astype("f4"),
        "speeds": recorded.speeds.astype("f4"),
        "commands": recorded.commands.astype("f4"),
        "contact": recorded.contact.astype("u1"),
    }
    content: dict[str, Any] = {
        "outline": recorded.outline.plain(),
        "lidar": _plain(recorded.lidar),
        "bounds": bounds(recorded),
        "goal": _plain(recorded.goal_pose()),
        "frame": recorded.frame,
        "start": _plain(recorded.scene.start if recorded.scene else None),
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
        cells = recorded.map.data.ravel()
        arrays["map"] = (cells >= 50).astype("u1") + 2 * (cells < 0).astype("u1")
    content["scan"] = _scans(recorded, arrays)
    layers: dict[str, Sequence[TimedItem]] = {
        "plan": recorded.plans,
        "local_plan": recorded.local_plans,
    }
    for name, layer in (
        layers | {"candidates": recorded.candidates, "band": recorded.bands}
    ).items():
        _lines(recorded, name, layer, arrays)
    discs = [  # at the times of the bands' lines
        np.column_stack(
            [
                recorded.to_frame(one).transform(one.content.discs[:, :2]),
                one.content.discs[:, 2],
            ]
        )
        for one in recorded.bands
    ]
    arrays["bubble_ends"] = np.cumsum([0, *map(len, discs)]).astype("i4")
    arrays["bubbles"] = np.concatenate([np.empty((0, 3)), *discs]).astype("f4")
    content["costmaps"] = _costmaps(recorded, arrays)
    return content | {"packed": pack_arrays(arrays)}


def bounds(recorded: RecordedTrial) -> list[float]:
    """Return x_min, y_min, x_max, y_max of what is to be seen, metres: world, map, start, goal and trail."""
    known, scene = recorded.map, recorded.scene
    margin_m = 1.0 if known is None and scene is None else 0.5
    low, high = (
        recorded.poses[:, :2].min(axis=0) - margin_m,
        recorded.poses[:, :2].max(axis=0) + margin_m,
    )
    reach_m = scene.goal_distance_m + 0.1 if scene is not None else 0.5
    ends = [recorded.goal_pose(), scene.start if scene is not None else None]
    seen = [
        (np.array([[pose.x, pose.y]]), max(0.5, reach_m))
        for pose in ends
        if pose is not None
    ]
    if scene is not None and len(scene.cylinders_m):
        seen.append((scene.cylinders_m, 2.0 * scene.radius_m))
    if recorded.moving is not None and len(recorded.moving.walls.poses):
        seen.append((np.concatenate(recorded.moving.walls.outlines()), 0.25))
    for points, room_m in seen:
        low, high = (
            np.minimum(low, points.min(axis=0) - room_m),
            np.maximum(high, points.max(axis=0) + room_m),
        )
    if known is not None:
        size = np.array(known.data.shape[::-1]) * known.resolution
        corner = np.array([known.origin_x, known.origin_y])
        low, high = np.minimum(low, corner), np.maximum(high, corner + size)
    low, high = (
        scene.view_m(low, high, recorded.poses[:, :2])
        if scene is not None
        else (low, high)
    )
    return [*low.tolist(), *high.tolist()]


def progress_m(recorded: RecordedTrial) -> Floats | None:
    """Return how far along the path from start over world to goal the robot has come by each time, (n,) metres.

    That is the arc length of the path's nearest point, the largest so far. None where the path is not known.
    """
    scene = recorded.scene
    if scene is None or not len(scene.path_m):
        return None
    first, last = (
        [[pose.x, pose.y]] if pose else np.empty((0, 2))
        for pose in (scene.start, scene.goal)
    )
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
    furthest: Floats = np.maximum.accumulate(
        np.cumsum(lengths)[nearest] - lengths[nearest] * (1.0 - share)
    )
    return furthest


def _plain(pose: Pose2D | None) -> list[float] | None:
    return None if pose is None else [pose.x, pose.y, pose.yaw]


def _scene(
    recorded: RecordedTrial, arrays: dict[str, Packable]
) -> dict[str, float] | None:
    """Add the centres of obstacles, walls and of what has been pushed by the end, and the path; return their radius."""
    scene = recorded.scene
    if scene is None:
        return None
    arrays["obstacles"] = scene.obstacles_m.astype("f4")
    arrays["walls"] = scene.walls_m.astype("f4")
    arrays["pushed"] = recorded.pushed_m.astype("f4")
    arrays["path"] = scene.path_m.astype("f4")
    return {"radius": scene.radius_m}


def _moving(
    recorded: RecordedTrial, arrays: dict[str, Packable]
) -> dict[str, Any] | None:
    """Add shapes and places of moving obstacles, and of walls between them; return what describes them."""
    moving = recorded.moving
    if moving is None:
        return None
    there = len(moving.bodies.poses) > 0
    arrays["mover_shapes"], arrays["box_walls"] = (
        shape_array(moving.bodies),
        shape_array(moving.walls),
    )
    arrays["mover_times"] = moving.times_s.astype("f4")
    arrays["mover_places"], step_m = in_millimetres(moving.places)
    arrays["mover_jumps"] = moving.jumps.astype("u1")
    return {
        "there": there,
        "step": step_m,
        "trail": TRAIL_S,
        "beyond": MAX_EXTRAPOLATION_S,
    }


def _grid(grid: OccupancyMap, where: Pose2D) -> list[float]:
    """Return width, height, resolution, corner and the pose of the frame it is in."""
    rows, columns = grid.data.shape
    return [
        columns,
        rows,
        grid.resolution,
        grid.origin_x,
        grid.origin_y,
        where.x,
        where.y,
        where.yaw,
    ]


def _scans(
    recorded: RecordedTrial, arrays: dict[str, Packable]
) -> dict[str, float] | None:
    """Add the ranges of evenly chosen beams in centimetres; scans of another shape than the first are left out."""
    if not recorded.scans:
        return None
    first = recorded.scans[0].content
    stride = -(-len(first.ranges) // MOST_BEAMS)
    alike = [
        shown
        for shown in recorded.scans
        if len(shown.content.ranges) == len(first.ranges)
    ]
    ranges = np.array([shown.content.ranges[::stride] for shown in alike], np.float64)
    seen = (
        np.isfinite(ranges) & (ranges >= first.range_min) & (ranges < _NO_RANGE / 100.0)
    )
    arrays["scan_times"] = np.array([shown.time_s for shown in alike], "f4")
    arrays["scan_ranges"] = np.where(
        seen, np.round(np.where(seen, ranges, 0.0) * 100.0), _NO_RANGE
    ).astype("u2")
    angles = {
        "angle_min": first.angle_min,
        "angle_step": first.angle_increment * stride,
    }
    return {"beams": ranges.shape[1], **angles, "no_range": _NO_RANGE}


def _lines(
    recorded: RecordedTrial,
    name: str,
    shown: Sequence[TimedItem],
    arrays: dict[str, Packable],
) -> None:
    """Add polylines: points, where each line begins among them, and which lines are shown from which time on."""
    lines = []
    for one in shown:  # a plan is a line itself
        where, found = (
            recorded.to_frame(one),
            getattr(one.content, "lines", [one.content]),
        )
        lines.append([_thinned(where.transform(line)) for line in found if len(line)])
    points = [line for some in lines for line in some]
    arrays[f"{name}_times"] = np.array([one.time_s for one in shown], "f4")
    arrays[f"{name}_lines"] = np.cumsum([0, *map(len, lines)]).astype("i4")
    arrays[f"{name}_ends"] = np.cumsum([0, *map(len, points)]).astype("i4")
    arrays[f"{name}_points"] = np.concatenate([*points, np.empty((0, 2))]).astype("f4")


def _costmaps(
    recorded: RecordedTrial, arrays: dict[str, Packable]
) -> list[list[float]]:
    """Add costs in a few levels, 0 free and unknown, and return what describes each grid."""
    stride = max(1, -(-len(recorded.costmaps) // MOST_COSTMAPS))
    chosen = recorded.costmaps[::stride]
    levels = [
        np.ceil(np.clip(one.content.data, 0, 100) * (_COST_LEVELS / 100.0)).astype("u1")
        for one in chosen
    ]
    arrays["costmap_cells"] = np.concatenate(
        [np.empty(0, "u1"), *(level.ravel() for level in levels)]
    )
    arrays["costmap_times"] = np.array([one.time_s for one in chosen], "f4")
    return [_grid(one.content, recorded.to_frame(one)) for one in chosen]


def _thinned(line: Floats) -> Floats:
    """Return at most `MOST_POINTS` points of a line, both ends among them."""
    chosen = (
        np.linspace(0, len(line) - 1, min(len(line), MOST_POINTS)).round().astype(int)
    )
    thinned: Floats = line[chosen]
    return thinned


def shape_array(bodies: Bodies) -> Packable:
    """Return x, y, yaw, radius and both sizes of bodies, one after the other, as `Shapes` in motion.js reads them."""
    return np.column_stack([bodies.poses, bodies.radius_m, bodies.size_m]).astype("f4")


def in_millimetres(values_m: Floats) -> tuple[Packable, float]:
    """Return metres as whole millimetres of two bytes and the step 0.001, or as they are and 1 where they are large."""
    if np.abs(values_m).max(initial=0.0) < _FARTHEST_M:
        return np.round(1000.0 * values_m).astype("i2"), 0.001
    return values_m.astype("f4"), 1.0


def motion_arrays(world: World, arrays: dict[str, Packable]) -> dict[str, float]:
    """Add the motions of a world's obstacles as polynomials, their shapes and the walls; return what describes them."""
    arrays["box_walls"] = shape_array(wall_bodies(world.walls))
    arrays["mover_shapes"] = shape_array(moving_bodies(world.tracks, 0.0))
    first, begin, duration, coefficients, period, phase = world.tracks.table
    arrays["mover_first"] = first.astype("i4")
    arrays["mover_begin"], arrays["mover_duration"] = (
        begin.astype("f4"),
        duration.astype("f4"),
    )
    arrays["mover_coefficients"], step_m = in_millimetres(coefficients)
    arrays["mover_periods"], arrays["mover_phases"] = (
        period.astype("f4"),
        phase.astype("f4"),
    )
    ends = coefficients[first[1:] - 1].sum(axis=2) - coefficients[first[:-1], :, 0]
    arrays["mover_closed"] = (np.hypot(*ends.T) < _CLOSED_M).astype("u1")
    return {"powers": coefficients.shape[2], "step": step_m, "trail": TRAIL_S}
