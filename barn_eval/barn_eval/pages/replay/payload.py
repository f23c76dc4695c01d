"""Make the data of the replay page: a recorded trial as small arrays in one frame."""

from typing import Any

import numpy as np
import numpy.typing as npt

from barn_eval.results.bags.movers import MAX_EXTRAPOLATION_S, TRAIL_S
from barn_eval.results.bags.recorded import RecordedTrial
from barn_eval.results.tracks import pack_arrays
from barn_worlds.base.arrays import Floats
from barn_worlds.base.types import ORIGIN, OccupancyMap, Pose2D
from barn_worlds.geometry.bodies import Bodies, moving_bodies, wall_bodies
from barn_worlds.messages import topics
from barn_worlds.worlds.world import World

Packable = npt.NDArray[Any]
Arrays = dict[str, Packable]

# Topics whose content is lines.
_LINES = (topics.PLAN, topics.LOCAL_PLAN, topics.CANDIDATES, topics.BAND)
_MAX_BEAMS = 240
_MAX_POINTS = 120
_MAX_COSTMAPS = 120
_COST_LEVELS = 12
# Ranges are whole centimeters of two bytes; the largest number stands for no range.
_NO_RANGE = 65535
# Whole millimeters of two bytes reach this far.
MAX_MILLIMETERS_M = 32.0
# A motion that ends so close to its start is closed.
_CLOSED_M = 0.01
_OCCUPIED = 50
# A page shows no more digits than these have. Other types stay as they are.
_SMALL_TYPES = {"f8": "f4", "i8": "i4", "b1": "u1"}


def make_payload(recorded: RecordedTrial) -> dict[str, Any]:
    """Return a replay page's JSON data: packed arrays and what describes them."""
    scene = recorded.scene
    items = recorded.items
    progress = progress_m(recorded)
    arrays: Arrays = {
        "times": recorded.times_s,
        "poses": recorded.poses,
        "speeds": recorded.speeds,
        "commands": recorded.commands,
        "contact": recorded.contact,
    }
    content: dict[str, Any] = {
        "outline": recorded.outline.plain(),
        "lidar": _pose_list(recorded.lidar),
        "bounds": bounds(recorded),
        "goal": _pose_list(recorded.goal_pose()),
        "frame": recorded.frame,
        "start": _pose_list(scene.start if scene else None),
        "goal_distance": scene.goal_distance_m if scene else 0.0,
        "scene": _add_scene(recorded, arrays),
        "moving": _add_moving(recorded, arrays),
        "recoveries": list(recorded.recoveries_s),
        "along_path": progress is not None,
        "outcomes": [[item.time_s, item.content] for item in items[topics.OUTCOME]],
    }
    arrays["progress"] = np.empty(0) if progress is None else progress
    arrays["clearance"] = recorded.clearance_m
    arrays["score_times"] = np.array([item.time_s for item in items[topics.SCORE]])
    arrays["scores"] = np.array([item.content for item in items[topics.SCORE]], "f4")
    if recorded.map is not None:
        content["map"] = _grid_list(recorded.map, ORIGIN)
        cells = recorded.map.data.ravel()
        # One byte for each cell: 0 is free, 1 occupied, and 2 unknown, which messages
        # have as -1.
        occupied = (cells >= _OCCUPIED).astype("u1")
        unknown = (cells < 0).astype("u1")
        arrays["map"] = occupied + 2 * unknown

    content["scan"] = _add_scans(recorded, arrays)
    for topic in _LINES:
        _add_lines(recorded, topic, arrays)
    _add_bubbles(recorded, arrays)
    content["costmaps"] = _add_costmaps(recorded, arrays)
    content["packed"] = pack_small(arrays)
    return content


def pack_small(arrays: Arrays) -> dict[str, Any]:
    """Return arrays packed for JSON: four bytes a number at most, one a truth value."""
    small_arrays = {}
    for name, array in arrays.items():
        kind = _SMALL_TYPES.get(array.dtype.str[1:], array.dtype)
        small_arrays[name] = array.astype(kind)
    return pack_arrays(small_arrays)


def bounds(recorded: RecordedTrial) -> list[float]:
    """Return x_min, y_min, x_max, y_max [m] of all that the page shows, with margins."""
    grid = recorded.map
    scene = recorded.scene
    trail = recorded.poses[:, :2]
    # Without a world there is little else to see around the trail.
    margin_m = 1.0 if grid is None and scene is None else 0.5
    # Points, and the room around them.
    areas = [(trail, margin_m)]
    reach_m = 0.5 if scene is None else scene.goal_distance_m + 0.1
    for pose in (recorded.goal_pose(), scene.start if scene else None):
        if pose is not None:
            areas.append((np.array([pose.position]), max(0.5, reach_m)))
    if scene is not None and len(scene.cylinders_m):
        areas.append((scene.cylinders_m, 2.0 * scene.radius_m))
    if recorded.moving is not None and len(recorded.moving.walls.poses):
        areas.append((np.concatenate(recorded.moving.walls.outlines()), 0.25))
    if grid is not None:
        corner = np.array(grid.origin)
        size = np.array(grid.data.shape[::-1]) * grid.resolution
        areas.append((np.stack([corner, corner + size]), 0.0))

    low = np.full(2, np.inf)
    high = np.full(2, -np.inf)
    for points, room_m in areas:
        low = np.minimum(low, points.min(axis=0) - room_m)
        high = np.maximum(high, points.max(axis=0) + room_m)
    if scene is not None:
        low, high = scene.view_m(low, high, trail)
    return [*low.tolist(), *high.tolist()]


def progress_m(recorded: RecordedTrial) -> Floats | None:
    """Return the farthest progress along the path by each time (n,) [m]; None if no path.

    The path leads from the start through the world to the goal. Progress is the arc
    length of its nearest point, the largest so far. None if the path is unknown.
    """
    scene = recorded.scene
    # Without a path there is no along.
    if scene is None or not len(scene.path_m):
        return None
    ends = []
    for pose in (scene.start, scene.goal):
        ends.append([pose.position] if pose else np.empty((0, 2)))
    path = np.vstack([ends[0], scene.path_m, ends[1]])
    steps = np.diff(path, axis=0)
    # Repeated points make steps of no length, by which nothing can be divided.
    is_step = np.hypot(*steps.T) > 0.0
    origins = path[:-1][is_step]
    steps = steps[is_step]
    if not len(steps):
        return None

    # The nearest point of every step to every pose, then the nearest of these.
    lengths = np.hypot(*steps.T)
    offsets = recorded.poses[:, None, :2] - origins
    shares = np.clip((offsets * steps).sum(axis=2) / lengths**2, 0.0, 1.0)
    distances = np.linalg.norm(offsets - shares[..., None] * steps, axis=2)
    nearest = distances.argmin(axis=1)
    share = shares[np.arange(len(nearest)), nearest]
    arc = np.cumsum(lengths)[nearest] - lengths[nearest] * (1.0 - share)
    # A robot that backs up has still come as far as it was.
    return np.maximum.accumulate(arc)


def _pose_list(pose: Pose2D | None) -> list[float] | None:
    """Return x, y [m], yaw [rad] of a pose as a list; None without a pose."""
    return None if pose is None else [*pose.numbers]


def _add_scene(recorded: RecordedTrial, arrays: Arrays) -> dict[str, float] | None:
    """Add a world's obstacles, walls and path to `arrays`; return their radius or None.

    Obstacles that were pushed are added, too. Nothing is added without a world.
    """
    scene = recorded.scene
    if scene is None:
        return None
    arrays["obstacles"] = scene.obstacles_m
    arrays["walls"] = scene.walls_m
    arrays["pushed"] = recorded.pushed_m
    arrays["path"] = scene.path_m
    return {"radius": scene.radius_m}


def _add_moving(recorded: RecordedTrial, arrays: Arrays) -> dict[str, Any] | None:
    """Add moving obstacles and box walls to `arrays`; return how to read them or None.

    Nothing is added without such obstacles.
    """
    moving = recorded.moving
    if moving is None:
        return None
    arrays["mover_shapes"] = shape_array(moving.bodies)
    arrays["box_walls"] = shape_array(moving.walls)
    arrays["mover_times"] = moving.times_s
    arrays["mover_places"], step_m = to_millimeters(moving.places)
    arrays["mover_jumps"] = moving.jumps
    return {
        "there": len(moving.bodies.poses) > 0,
        "step": step_m,
        "trail": TRAIL_S,
        "beyond": MAX_EXTRAPOLATION_S,
    }


def _grid_list(grid: OccupancyMap, frame: Pose2D) -> list[float]:
    """Return columns, rows, resolution, origin x, y and frame x, y, yaw of a grid."""
    rows, columns = grid.data.shape
    return [columns, rows, grid.resolution, *grid.origin, *frame.numbers]


def _add_scans(recorded: RecordedTrial, arrays: Arrays) -> dict[str, float] | None:
    """Add up to 240 beams [cm] to `arrays`; return their angles, None without scans.

    Scans with another number of beams than the first are left out.
    """
    scans = recorded.items[topics.SCAN]
    if not scans:
        return None
    first = scans[0].content
    # Rounded up, so that there are never more beams than the page draws quickly.
    stride = -(-len(first.ranges) // _MAX_BEAMS)
    scans = [item for item in scans if len(item.content.ranges) == len(first.ranges)]
    # One array needs scans of one length.
    ranges = np.array([item.content.ranges[::stride] for item in scans], np.float64)
    is_near = (ranges >= first.range_min) & (ranges < _NO_RANGE / 100.0)
    is_hit = np.isfinite(ranges) & is_near
    centimeters = np.round(np.where(is_hit, ranges, 0.0) * 100.0)
    arrays["scan_times"] = np.array([item.time_s for item in scans])
    arrays["scan_ranges"] = np.where(is_hit, centimeters, _NO_RANGE).astype("u2")
    return {
        "beams": ranges.shape[1],
        "angle_min": first.angle_min,
        "angle_step": first.angle_increment * stride,
        "no_range": _NO_RANGE,
    }


def _add_lines(recorded: RecordedTrial, topic: topics.Topic, arrays: Arrays) -> None:
    """Add lines of a topic, of at most 120 points each, to `arrays` by its name.

    They are in the replay's frame: times, points, where each line begins, and which
    lines show when.
    """
    name = topic.name
    items = recorded.items[topic]
    points = [np.empty((0, 2))]
    lengths = [0]
    line_counts = [0]
    for item in items:
        frame = recorded.to_frame(item)
        # A plan is a line itself; other messages have several.
        lines = getattr(item.content, "lines", [item.content])
        lines = [frame.transform(line) for line in lines if len(line)]
        for line in lines:
            count = min(len(line), _MAX_POINTS)
            # Evenly spaced, both ends among them.
            positions = np.linspace(0, len(line) - 1, count).round().astype(int)
            points.append(line[positions])
            lengths.append(count)
        line_counts.append(len(lines))
    arrays[f"{name}_times"] = np.array([item.time_s for item in items])
    arrays[f"{name}_lines"] = np.cumsum(line_counts)
    arrays[f"{name}_ends"] = np.cumsum(lengths)
    arrays[f"{name}_points"] = np.concatenate(points)


def _add_bubbles(recorded: RecordedTrial, arrays: Arrays) -> None:
    """Add x, y and radius [m] of elastic bands' bubbles to `arrays`.

    Their times are those of the bands' lines.
    """
    discs = [np.empty((0, 3))]
    counts = [0]
    for item in recorded.items[topics.BAND]:
        centers = recorded.to_frame(item).transform(item.content.discs[:, :2])
        discs.append(np.column_stack([centers, item.content.discs[:, 2]]))
        counts.append(len(centers))
    arrays["bubble_ends"] = np.cumsum(counts)
    arrays["bubbles"] = np.concatenate(discs)


def _add_costmaps(recorded: RecordedTrial, arrays: Arrays) -> list[list[float]]:
    """Add at most 120 costmaps in 12 levels to `arrays`; return each one's grid.

    Level 0 is free or unknown.
    """
    costmaps = recorded.items[topics.COSTMAP]
    # The division is rounded up, so that there are never more than the limit.
    stride = max(1, -(-len(costmaps) // _MAX_COSTMAPS))
    costmaps = costmaps[::stride]
    cells = [np.empty(0, "u1")]
    grids = []
    for item in costmaps:
        costs = np.clip(item.content.data, 0, 100)
        # Rounded up, so that the lowest cost does not look free.
        levels = np.ceil(costs * (_COST_LEVELS / 100.0)).astype("u1")
        cells.append(levels.ravel())
        grids.append(_grid_list(item.content, recorded.to_frame(item)))
    arrays["costmap_cells"] = np.concatenate(cells)
    arrays["costmap_times"] = np.array([item.time_s for item in costmaps])
    return grids


def shape_array(bodies: Bodies) -> Packable:
    """Return x, y, yaw, radius and both sizes of each body as a row, for motion.js."""
    columns = [bodies.poses, bodies.radius_m, bodies.size_m]
    return np.column_stack(columns)


def to_millimeters(values_m: Floats) -> tuple[Packable, float]:
    """Return meters as whole millimeters (int16), or unchanged from 32 m on.

    Returns:
        The values, and what one of them is in meters: 0.001 or 1.
    """
    if np.abs(values_m).max(initial=0.0) < MAX_MILLIMETERS_M:
        return np.round(1000.0 * values_m).astype("i2"), 0.001
    return values_m, 1.0


def motion_arrays(world: World, arrays: Arrays) -> dict[str, float]:
    """Add walls and polynomial motions to `arrays`; return how to read them.

    Args:
        world: Has the motions of its obstacles as polynomials.
        arrays: Arrays of the page, which get new ones.

    Returns:
        Number of coefficients, what a number is in meters, and length of trails [s].
    """
    arrays["box_walls"] = shape_array(wall_bodies(world.walls))
    arrays["mover_shapes"] = shape_array(moving_bodies(world.tracks, 0.0))
    first, begin, duration, coefficients, period, phase = world.tracks.table
    arrays["mover_first"] = first
    arrays["mover_begin"] = begin
    arrays["mover_duration"] = duration
    arrays["mover_coefficients"], step_m = to_millimeters(coefficients)
    arrays["mover_periods"] = period
    arrays["mover_phases"] = phase
    # Where the last piece of each motion ends, minus where its first begins.
    ends = coefficients[first[1:] - 1].sum(axis=2) - coefficients[first[:-1], :, 0]
    arrays["mover_closed"] = np.hypot(*ends.T) < _CLOSED_M
    return {"powers": coefficients.shape[2], "step": step_m, "trail": TRAIL_S}
