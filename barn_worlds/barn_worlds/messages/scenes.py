"""What truly stands and moves in a trial, as markers and poses for those who look at its bag, never for a planner."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from barn_worlds.base.arrays import Floats, Points
from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import Pose2D, quaternion_from_yaw, yaw_from_quaternion
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
)
from barn_worlds.messages.topics import FRAMES, MOVING, MOVING_POSES, WORLD
from barn_worlds.moving.motion import MOST_MOVING, MOST_WALLS
from barn_worlds.worlds.scene import TrialScene
from barn_worlds.worlds.world import World

MOST_CYLINDERS = 1_000_000
Colours = Mapping[str, tuple[float, float, float, float]]
TRAIL_S = 1.0
_TRAIL_STEP_S = 0.1
_LINE_M, _START_M, _DISC_M, _TRAIL_M = 0.02, 0.2, 0.01, 0.05
_OBSTACLES, _WALLS, _PATH, _START, _GOAL, _TRAILS = (
    "obstacles",
    "walls",
    "path",
    "start",
    "goal",
    "trails",
)
# Red, green, blue, opacity by namespace, of what stands and of what moves.
_STANDING = {
    _OBSTACLES: (0.2, 0.22, 0.24, 1.0),
    _WALLS: (0.55, 0.57, 0.6, 1.0),
    _PATH: (0.55, 0.57, 0.6, 0.8),
    _START: (0.0, 0.45, 0.7, 1.0),
    _GOAL: (0.0, 0.62, 0.45, 0.5),
}
_MOVING = {
    _OBSTACLES: (0.84, 0.37, 0.0, 1.0),
    _TRAILS: (0.84, 0.37, 0.0, 0.6),
    _WALLS: (0.55, 0.57, 0.6, 1.0),
}


def encode_scene(scene: TrialScene, stamp_ns: int) -> bytes:
    """Return visualization_msgs/MarkerArray: a cylinder per obstacle, the path, start and goal.

    Every marker keeps its namespace and number, so that a later scene takes the place of an earlier one.
    """
    found = []
    for name, centres_m in ((_OBSTACLES, scene.obstacles_m), (_WALLS, scene.walls_m)):
        zeros, boxes = np.zeros(len(centres_m)), np.zeros((len(centres_m), 2))
        pillars = (
            np.column_stack([centres_m, zeros]),
            zeros + scene.radius_m,
            boxes,
            zeros + scene.height_m,
        )
        found += _solid(_STANDING, name, Bodies(*pillars), stamp_ns)
    if len(scene.path_m):
        found.append(
            _line(_STANDING, _PATH, LINE_STRIP, _LINE_M, scene.path_m, stamp_ns)
        )
    ends = (
        (_START, SPHERE, scene.start, _START_M),
        (_GOAL, CYLINDER, scene.goal, 2.0 * scene.goal_distance_m),
    )
    for name, kind, pose, size_m in ends:
        if pose is not None:
            disc = _marker(_STANDING, name, kind, stamp_ns)
            disc.scale.x, disc.scale.y, disc.scale.z = size_m, size_m, _DISC_M
            disc.pose.position.x, disc.pose.position.y = pose.x, pose.y
            disc.pose.orientation.z, disc.pose.orientation.w = quaternion_from_yaw(
                pose.yaw
            )
            found.append(disc)
    return serialize(make_message(WORLD.type_name, markers=found))


def decode_scene(data: bytes) -> TrialScene:
    """Return what `encode_scene` has written; MessageError for anything else."""
    kinds = _by_namespace(data, _STANDING)
    obstacles, walls = (
        _bodies(name, kinds[name], MOST_CYLINDERS) for name in (_OBSTACLES, _WALLS)
    )
    sizes = set(
        zip(
            *(
                np.concatenate([one[k] for one in (obstacles, walls)]).tolist()
                for k in (1, 3)
            ),
            strict=True,
        )
    )
    if len(sizes) > 1:
        raise MessageError("cylinders of different sizes")
    start, goal = (_poses(kinds[name]) for name in (_START, _GOAL))
    path = np.array(
        [(point.x, point.y) for line in kinds[_PATH] for point in line.points],
        np.float64,
    ).reshape(-1, 2)
    reached_m = 0.5 * kinds[_GOAL][0].scale.x if len(goal) else 0.0
    if not all(np.isfinite(part).all() for part in (path, start, goal, reached_m)):
        raise MessageError("a scene with values that are not finite")
    ends = [
        Pose2D(*poses[0].tolist()) if len(poses) else None for poses in (start, goal)
    ]
    radius_m, height_m = next(iter(sizes), (0.0, 0.0))
    return TrialScene(
        obstacles.poses[:, :2],
        walls.poses[:, :2],
        radius_m,
        height_m,
        path,
        ends[0],
        ends[1],
        reached_m,
    )


def encode_moving(world: World, time_s: float, stamp_ns: int) -> bytes:
    """Return visualization_msgs/MarkerArray of a world's moving obstacles and their trails, and of its walls.

    time_s: into their motions. A marker keeps its namespace and number from message to message.
    """
    found = _solid(_MOVING, _OBSTACLES, moving_bodies(world.tracks, time_s), stamp_ns)
    found += _solid(_MOVING, _WALLS, wall_bodies(world.walls), stamp_ns)
    trails = _line(
        _MOVING, _TRAILS, LINE_LIST, _TRAIL_M, trail_segments(world, time_s), stamp_ns
    )
    return serialize(make_message(MOVING.type_name, markers=[*found, trails]))


def decode_moving(data: bytes) -> tuple[Bodies, Bodies]:
    """Return the obstacles, in their order, and the walls that `encode_moving` has written; MessageError if not."""
    kinds = _by_namespace(data, _MOVING)
    return _bodies(_OBSTACLES, kinds[_OBSTACLES], MOST_MOVING), _bodies(
        _WALLS, kinds[_WALLS], MOST_WALLS
    )


def encode_moving_poses(world: World, time_s: float, stamp_ns: int) -> bytes:
    """Return geometry_msgs/PoseArray of a world's moving obstacles in their order there; time_s: into their motions."""
    places = world.tracks.at(time_s)[0].tolist()
    message = make_message(
        MOVING_POSES.type_name, header=make_header(FRAMES.of(MOVING_POSES), stamp_ns)
    )
    for (x, y), yaw in zip(places, world.tracks.yaw_rad.tolist(), strict=True):
        pose = make_message("geometry_msgs/msg/Pose")
        pose.position.x, pose.position.y = x, y
        pose.orientation.z, pose.orientation.w = quaternion_from_yaw(yaw)
        message.poses.append(pose)
    return serialize(message)


def decode_moving_poses(data: bytes) -> Floats:
    """Return the places (n, 2) in m that `encode_moving_poses` has written; MessageError for anything else."""
    places = decode.poses(data)[:, :2]
    if (
        len(places) > MOST_MOVING
        or not np.isfinite(places).all()
        or decode.header(data).frame != FRAMES.map
    ):
        raise MessageError(
            f"more than {MOST_MOVING} poses, poses that are not finite, or not in the map frame"
        )
    return places


def trail_segments(world: World, time_s: float) -> Points:
    """Return the ends (2 n, 2) of the pieces of the ways of the last `TRAIL_S`, jumps left out."""
    steps = round(TRAIL_S / _TRAIL_STEP_S)
    positions = world.tracks.over(time_s - _TRAIL_STEP_S * np.arange(steps + 1.0))[0]
    lengths = np.hypot(*np.moveaxis(np.diff(positions, axis=0), 2, 0))
    moved = lengths <= world.tracks.fastest_mps * _TRAIL_STEP_S * 1.001
    segments: Points = np.stack([positions[:-1], positions[1:]], axis=2)[moved].reshape(
        -1, 2
    )
    return segments


def _marker(colours: Colours, name: str, kind: int, stamp_ns: int) -> Message:
    return make_marker(FRAMES.map, name, kind, color=colours[name], stamp_ns=stamp_ns)


def _line(
    colours: Colours,
    name: str,
    kind: int,
    width_m: float,
    points_m: Points,
    stamp_ns: int,
) -> Message:
    line = _marker(colours, name, kind, stamp_ns)
    line.scale.x = width_m
    line.points = [
        make_message("geometry_msgs/msg/Point", x=x, y=y) for x, y in points_m.tolist()
    ]
    return line


def _solid(colours: Colours, name: str, bodies: Bodies, stamp_ns: int) -> list[Message]:
    """Return the markers of bodies, numbered in their order: copies of one."""
    found, first = [], _marker(colours, name, CYLINDER, stamp_ns)
    where, turn = first.pose.position, first.pose.orientation
    for index, ((x, y, yaw), radius, size, height) in enumerate(
        zip(*(part.tolist() for part in bodies), strict=True)
    ):
        z, w = quaternion_from_yaw(yaw)
        place, heading = (
            replace(where, x=x, y=y, z=0.5 * height),
            replace(turn, z=z, w=w),
        )
        pose = replace(first.pose, position=place, orientation=heading)
        long, wide = (2.0 * radius, 2.0 * radius) if radius else size
        scale = replace(first.scale, x=long, y=wide, z=height)
        found.append(
            replace(
                first,
                id=index,
                type=CYLINDER if radius else CUBE,
                pose=pose,
                scale=scale,
            )
        )
    return found


def _by_namespace(data: bytes, names: Iterable[str]) -> dict[str, list[Message]]:
    """Return the markers of a message in the map frame by these namespaces; MessageError for any other."""
    kinds: dict[str, list[Message]] = {name: [] for name in names}
    for one in decode.decode_message(data, WORLD.type_name).markers:
        if one.ns not in kinds or one.header.frame_id != FRAMES.map:
            raise MessageError(
                f"a marker of the namespace {one.ns[:40]!r} in the frame {one.header.frame_id[:40]!r}"
            )
        kinds[one.ns].append(one)
    return kinds


def _poses(markers: Iterable[Message]) -> Floats:
    """Return x, y and yaw (n, 3) of markers."""
    found = [(one.pose.position, one.pose.orientation) for one in markers]
    rows = [
        (at.x, at.y, yaw_from_quaternion(turn.x, turn.y, turn.z, turn.w))
        for at, turn in found
    ]
    return np.array(rows, np.float64).reshape(-1, 3)


def _bodies(name: str, markers: list[Message], most: int) -> Bodies:
    """Return the bodies of markers of one namespace, which must be numbered in their order."""
    if len(markers) > most or [one.id for one in markers] != list(range(len(markers))):
        raise MessageError(
            f"markers of {name} are more than {most}, or their numbers are not 0, 1, 2, ..."
        )
    rows = []
    for one in markers:
        scale = one.scale
        if one.type not in (CYLINDER, CUBE) or (
            one.type == CYLINDER and scale.x != scale.y
        ):
            raise MessageError(
                f"marker {one.id} of {name} is neither an upright cylinder nor a box"
            )
        rows.append(
            (0.5 * scale.x, 0.0, 0.0, scale.z)
            if one.type == CYLINDER
            else (0.0, scale.x, scale.y, scale.z)
        )
    table, poses = np.array(rows, np.float64).reshape(-1, 4), _poses(markers)
    finite = np.isfinite(table).all() and np.isfinite(poses).all()
    if not (finite and (table >= 0.0).all() and table[:, :3].any(axis=1).all()):
        raise MessageError(
            f"markers of {name} have values that are not finite, or no size"
        )
    return Bodies(poses, table[:, 0], table[:, 1:3], table[:, 3])
