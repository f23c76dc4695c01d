"""The true obstacles of a trial, as markers and poses in its bag.

They are for people and pages that look at the bag. A planner never gets them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.errors import MessageError
from barn_worlds.base.files import read_package_yaml
from barn_worlds.base.types import Pose2D, quaternion_from_yaw
from barn_worlds.geometry.bodies import Bodies, moving_bodies, wall_bodies
from barn_worlds.messages import decode
from barn_worlds.messages.cdr import Message, make_message, serialize
from barn_worlds.messages.encode import (
    CUBE,
    CYLINDER,
    LINE_LIST,
    LINE_STRIP,
    SPHERE,
    make_header,
    make_marker,
    place,
)
from barn_worlds.messages.topics import FRAMES, MOVING, MOVING_POSES, WORLD
from barn_worlds.moving.motion import MOST_MOVING, MOST_WALLS
from barn_worlds.worlds.scene import TrialScene
from barn_worlds.worlds.world import World

MOST_CYLINDERS = 1_000_000
TRAIL_S = 1.0
_TRAIL_STEP_S = 0.1

# Sizes of markers in meters.
_PATH_WIDTH_M = 0.02
_TRAIL_WIDTH_M = 0.05
_START_SIZE_M = 0.2
_DISC_HEIGHT_M = 0.01

# Namespaces of markers.
_OBSTACLES = "obstacles"
_WALLS = "walls"
_PATH = "path"
_START = "start"
_GOAL = "goal"
_TRAILS = "trails"

# Colors by namespace. A message has no other namespaces than those with a color.
Colors = Mapping[str, Sequence[float]]
_COLORS: Mapping[str, Colors] = read_package_yaml("barn_worlds", "marker_colors.yaml")
_STATIC_COLORS = _COLORS["static"]
_MOVING_COLORS = _COLORS["moving"]


def encode_scene(scene: TrialScene, stamp_ns: int) -> bytes:
    """Return serialized MarkerArray of a scene's cylinders, path, start and goal.

    Boxes, the straight walls of arenas, are in `encode_moving` instead.

    Markers keep namespace and number, so a later scene replaces an earlier one.

    Args:
        scene: Cylinders of the world, path, start and goal.
        stamp_ns: Stamp of all markers.
    """
    markers = []
    for name, centers_m in ((_OBSTACLES, scene.obstacles_m), (_WALLS, scene.walls_m)):
        zeros = np.zeros(len(centers_m))
        cylinders = Bodies(
            np.column_stack([centers_m, zeros]),
            zeros + scene.radius_m,
            np.zeros((len(centers_m), 2)),
            zeros + scene.height_m,
        )
        markers += _body_markers(_STATIC_COLORS, name, cylinders, stamp_ns)

    if len(scene.path_m):
        path = _make_marker(_STATIC_COLORS, _PATH, LINE_STRIP, stamp_ns)
        _add_points(path, _PATH_WIDTH_M, scene.path_m)
        markers.append(path)

    for name, kind, pose, size_m in (
        (_START, SPHERE, scene.start, _START_SIZE_M),
        (_GOAL, CYLINDER, scene.goal, 2.0 * scene.goal_distance_m),
    ):
        if pose is not None:
            disc = _make_marker(_STATIC_COLORS, name, kind, stamp_ns)
            disc.scale.x = size_m
            disc.scale.y = size_m
            # Flat, so that a robot on it stays visible.
            disc.scale.z = _DISC_HEIGHT_M
            place(disc.pose, *pose.numbers)
            markers.append(disc)
    return serialize(make_message(WORLD.type_name, markers=markers))


def decode_scene(data: bytes) -> TrialScene:
    """Return the scene that `encode_scene` wrote; MessageError for anything else."""
    markers = _read_namespaces(data, _STATIC_COLORS)
    obstacles = _read_bodies(_OBSTACLES, markers[_OBSTACLES], MOST_CYLINDERS)
    walls = _read_bodies(_WALLS, markers[_WALLS], MOST_CYLINDERS)

    # All cylinders of a scene have one radius and height.
    sizes: set[tuple[float, float]] = set()
    for bodies in (obstacles, walls):
        radii = bodies.radius_m.tolist()
        sizes.update(zip(radii, bodies.height_m.tolist(), strict=True))
    if len(sizes) > 1:
        raise MessageError("cylinders of different sizes")
    radius_m, height_m = next(iter(sizes), (0.0, 0.0))

    path_points = [point for line in markers[_PATH] for point in line.points]
    path = decode.planar_points(path_points)
    start = _read_poses(markers[_START])
    goal = _read_poses(markers[_GOAL])
    goal_distance_m = 0.5 * markers[_GOAL][0].scale.x if len(goal) else 0.0
    # Bags come from anyone, and pages draw what they hold.
    if not all(
        np.isfinite(part).all() for part in (path, start, goal, goal_distance_m)
    ):
        raise MessageError("a scene with values that are not finite")
    return TrialScene(
        obstacles.poses[:, :2],
        walls.poses[:, :2],
        radius_m,
        height_m,
        path,
        _first_pose(start),
        _first_pose(goal),
        goal_distance_m,
    )


def encode_moving(world: World, time_s: float, stamp_ns: int) -> bytes:
    """Return serialized MarkerArray of moving obstacles, trails and straight walls.

    Markers keep namespace and number from message to message.

    Args:
        world: World with moving obstacles.
        time_s: Time in the motions of the obstacles.
        stamp_ns: Stamp of all markers.
    """
    obstacles = moving_bodies(world.tracks, time_s)
    walls = wall_bodies(world.walls)
    markers = _body_markers(_MOVING_COLORS, _OBSTACLES, obstacles, stamp_ns)
    markers += _body_markers(_MOVING_COLORS, _WALLS, walls, stamp_ns)
    trails = _make_marker(_MOVING_COLORS, _TRAILS, LINE_LIST, stamp_ns)
    _add_points(trails, _TRAIL_WIDTH_M, trail_segments(world, time_s))
    markers.append(trails)
    return serialize(make_message(MOVING.type_name, markers=markers))


def decode_moving(data: bytes) -> tuple[Bodies, Bodies]:
    """Return moving obstacles, in order, and walls as encoded, else MessageError.

    Raises:
        MessageError: If the message holds anything else.
    """
    markers = _read_namespaces(data, _MOVING_COLORS)
    obstacles = _read_bodies(_OBSTACLES, markers[_OBSTACLES], MOST_MOVING)
    walls = _read_bodies(_WALLS, markers[_WALLS], MOST_WALLS)
    return obstacles, walls


def encode_moving_poses(world: World, time_s: float, stamp_ns: int) -> bytes:
    """Return serialized PoseArray of moving obstacles, in their order in the world.

    Args:
        world: World with moving obstacles.
        time_s: Time in the motions of the obstacles.
        stamp_ns: Stamp of the header.
    """
    positions, _ = world.tracks.at(time_s)
    message = make_message(
        MOVING_POSES.type_name, header=make_header(FRAMES.of(MOVING_POSES), stamp_ns)
    )
    yaws = world.tracks.yaw_rad.tolist()
    for (x, y), yaw in zip(positions.tolist(), yaws, strict=True):
        pose = make_message("geometry_msgs/msg/Pose")
        place(pose, x, y, yaw)
        message.poses.append(pose)
    return serialize(message)


def decode_moving_poses(data: bytes) -> Points:
    """Return positions (n, 2) in m of a PoseArray; MessageError unless in map frame.

    Raises:
        MessageError: If the message holds anything else.
    """
    positions = decode.poses(data)[:, :2]
    if (
        len(positions) > MOST_MOVING
        or not np.isfinite(positions).all()
        or decode.header(data).frame != FRAMES.map
    ):
        raise MessageError(
            f"more than {MOST_MOVING} poses, poses that are not finite, "
            "or not in the map frame"
        )
    return positions


def trail_segments(world: World, time_s: float) -> Points:
    """Return segment ends (2 n, 2) in m of obstacles' last `TRAIL_S`, without jumps.

    Args:
        world: World with moving obstacles.
        time_s: Time in the motions of the obstacles.

    Returns:
        Start and end (2 n, 2) of each segment, in m. Jumps are left out.
    """
    steps = round(TRAIL_S / _TRAIL_STEP_S)
    # Backward from now, so that a trail begins at its obstacle.
    times_s = time_s - _TRAIL_STEP_S * np.arange(steps + 1.0)
    positions, _ = world.tracks.over(times_s)
    lengths_m = np.hypot(*np.moveaxis(np.diff(positions, axis=0), 2, 0))
    # Longer than the fastest obstacle drives in a step is a jump.
    is_driven = lengths_m <= world.tracks.fastest_mps * _TRAIL_STEP_S * 1.001
    segments = np.stack([positions[:-1], positions[1:]], axis=2)
    trails: Points = segments[is_driven].reshape(-1, 2)
    return trails


def _make_marker(colors: Colors, name: str, kind: int, stamp_ns: int) -> Message:
    """Return a marker object in the map frame, in the color of namespace `name`."""
    return make_marker(FRAMES.map, name, kind, color=colors[name], stamp_ns=stamp_ns)


def _add_points(line: Message, width_m: float, points_m: Points) -> None:
    """Set width and points (n, 2) of a line marker in place; replace old points."""
    line.scale.x = width_m
    line.points = [
        make_message("geometry_msgs/msg/Point", x=x, y=y) for x, y in points_m.tolist()
    ]


def _body_markers(
    colors: Colors, name: str, bodies: Bodies, stamp_ns: int
) -> list[Message]:
    """Return a CYLINDER or CUBE marker per body in namespace `name`, ids from 0."""
    # Copies of one marker: making each field by field would take far longer.
    sample = _make_marker(colors, name, CYLINDER, stamp_ns)
    sample_pose = sample.pose
    columns = [column.tolist() for column in bodies]
    rows = zip(*columns, strict=True)
    markers = []
    for index, ((x, y, yaw), radius, size, height) in enumerate(rows):
        z, w = quaternion_from_yaw(yaw)
        length, width = (2.0 * radius, 2.0 * radius) if radius else size
        pose = replace(
            sample_pose,
            position=replace(sample_pose.position, x=x, y=y, z=0.5 * height),
            orientation=replace(sample_pose.orientation, z=z, w=w),
        )
        marker = replace(
            sample,
            id=index,
            type=CYLINDER if radius else CUBE,
            pose=pose,
            scale=replace(sample.scale, x=length, y=width, z=height),
        )
        markers.append(marker)
    return markers


def _read_namespaces(data: bytes, names: Iterable[str]) -> dict[str, list[Message]]:
    """Return marker objects by namespace; MessageError for other names or frames."""
    markers: dict[str, list[Message]] = {name: [] for name in names}
    for marker in decode.decode_message(data, WORLD.type_name).markers:
        frame = marker.header.frame_id
        if marker.ns not in markers or frame != FRAMES.map:
            raise MessageError(
                f"a marker of the namespace {marker.ns[:40]!r} "
                f"in the frame {frame[:40]!r}"
            )
        markers[marker.ns].append(marker)
    return markers


def _read_poses(markers: Iterable[Message]) -> Floats:
    """Return x, y, yaw (n, 3) in m and rad of marker objects."""
    rows = [decode.planar_pose(marker.pose).numbers for marker in markers]
    return np.array(rows, np.float64).reshape(-1, 3)


def _first_pose(poses: Floats) -> Pose2D | None:
    """Return the first of poses (n, 3) as a `Pose2D`, None if there are none."""
    return Pose2D(*poses[0].tolist()) if len(poses) else None


def _read_bodies(name: str, markers: list[Message], most: int) -> Bodies:
    """Return the cylinders and boxes of one namespace; MessageError for other markers.

    Args:
        name: The namespace, for error messages.
        markers: Its markers, whose numbers must be their indices.
        most: How many there may be.
    """
    indices = [marker.id for marker in markers]
    if len(markers) > most or indices != list(range(len(markers))):
        raise MessageError(
            f"markers of {name} are more than {most}, "
            "or their numbers are not 0, 1, 2, ..."
        )
    rows = []  # radius of a cylinder, sides of a box, height
    for marker in markers:
        scale = marker.scale
        # An ellipse is no body of the suite.
        if marker.type == CYLINDER and scale.x == scale.y:
            rows.append((0.5 * scale.x, 0.0, 0.0, scale.z))
        elif marker.type == CUBE:
            rows.append((0.0, scale.x, scale.y, scale.z))
        else:
            raise MessageError(
                f"marker {marker.id} of {name} is neither an upright cylinder nor a box"
            )
    sizes = np.array(rows, np.float64).reshape(-1, 4)
    poses = _read_poses(markers)
    is_finite = np.isfinite(sizes).all() and np.isfinite(poses).all()
    has_size = (sizes >= 0.0).all() and sizes[:, :3].any(axis=1).all()
    if not (is_finite and has_size):
        raise MessageError(
            f"markers of {name} have values that are not finite, or no size"
        )
    return Bodies(poses, sizes[:, 0], sizes[:, 1:3], sizes[:, 3])
