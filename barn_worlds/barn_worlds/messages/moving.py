"""Moving obstacles at an instant, for those who look at a bag: markers with their recent trails, and plain poses."""

from typing import Any

import numpy as np

from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import quaternion_from_yaw, yaw_from_quaternion
from barn_worlds.geometry.bodies import Bodies, moving_bodies, wall_bodies
from barn_worlds.messages import decode
from barn_worlds.messages.cdr import deserialise, make, serialise
from barn_worlds.messages.encode import header
from barn_worlds.messages.markers import CUBE, CYLINDER, LINE_LIST, marker
from barn_worlds.messages.topics import FRAMES, MOVING, MOVING_POSES
from barn_worlds.moving.motion import MOST_MOVING, MOST_WALLS
from barn_worlds.worlds.world import World

TRAIL_S = 1.0
_TRAIL_STEP_S = 0.1
_TRAIL_M = 0.05
_OBSTACLES, _TRAILS, _WALLS = "obstacles", "trails", "walls"
_COLOURS = {_OBSTACLES: (0.84, 0.37, 0.0, 1.0), _TRAILS: (0.84, 0.37, 0.0, 0.6), _WALLS: (0.55, 0.57, 0.6, 1.0)}


def encode_moving(world: World, time_s: float, stamp_ns: int) -> bytes:
    """Return visualization_msgs/MarkerArray of a world's moving obstacles and their trails, and of its walls.

    time_s: into their motions. A marker keeps its namespace and number from message to message.
    """
    found = _markers(_OBSTACLES, moving_bodies(world.tracks, time_s), stamp_ns)
    found += _markers(_WALLS, wall_bodies(world.walls), stamp_ns)
    line = marker(FRAMES.of(MOVING), _TRAILS, LINE_LIST, colour=_COLOURS[_TRAILS], stamp_ns=stamp_ns)
    line.scale.x = _TRAIL_M
    line.points = [make("geometry_msgs/msg/Point", x=x, y=y) for x, y in trail_segments(world, time_s).tolist()]
    return serialise(make(MOVING.type_name, markers=[*found, line]))


def decode_moving(data: bytes) -> tuple[Bodies, Bodies]:
    """Return the obstacles, in their order, and the walls that `encode_moving` has written; MessageError if not."""
    try:
        markers = deserialise(data, MOVING.type_name).markers
    except Exception as error:  # the library raises errors of any kind for malformed bytes
        raise MessageError(f"not a message of type {MOVING.type_name} ({error})") from None
    kinds: dict[str, list[Any]] = {name: [] for name in _COLOURS}
    for one in markers:
        if one.ns not in kinds or one.header.frame_id != FRAMES.map:
            raise MessageError(f"a marker of the namespace {one.ns[:40]!r} in the frame {one.header.frame_id[:40]!r}")
        kinds[one.ns].append(one)
    limits = {_OBSTACLES: MOST_MOVING, _WALLS: MOST_WALLS}
    obstacles, walls = (_bodies(name, kinds[name], most) for name, most in limits.items())
    return obstacles, walls


def encode_moving_poses(world: World, time_s: float, stamp_ns: int) -> bytes:
    """Return geometry_msgs/PoseArray of a world's moving obstacles in their order there; time_s: into their motions."""
    places = world.tracks.at(time_s)[0].tolist()
    message = make(MOVING_POSES.type_name, header=header(FRAMES.of(MOVING_POSES), stamp_ns))
    for (x, y), yaw in zip(places, world.tracks.yaw_rad.tolist(), strict=True):
        pose = make("geometry_msgs/msg/Pose")
        pose.position.x, pose.position.y = x, y
        pose.orientation.z, pose.orientation.w = quaternion_from_yaw(yaw)
        message.poses.append(pose)
    return serialise(message)


def decode_moving_poses(data: bytes) -> Floats:
    """Return the places (n, 2) in m that `encode_moving_poses` has written; MessageError for anything else."""
    places = decode.poses(data)[:, :2]
    if len(places) > MOST_MOVING or not np.isfinite(places).all() or decode.header(data).frame != FRAMES.map:
        raise MessageError(f"more than {MOST_MOVING} poses, poses that are not finite, or not in the map frame")
    return places


def trail_segments(world: World, time_s: float) -> Floats:
    """Return the ends (2 n, 2) of the pieces of the ways of the last `TRAIL_S`, jumps left out."""
    steps = round(TRAIL_S / _TRAIL_STEP_S)
    positions = world.tracks.over(time_s - _TRAIL_STEP_S * np.arange(steps + 1.0))[0]
    lengths = np.hypot(*np.moveaxis(np.diff(positions, axis=0), 2, 0))
    moved = lengths <= world.tracks.fastest_mps * _TRAIL_STEP_S * 1.001
    pairs = np.stack([positions[:-1], positions[1:]], axis=2)[moved]
    segments: Floats = pairs.reshape(-1, 2)
    return segments


def _markers(name: str, bodies: Bodies, stamp_ns: int) -> list[Any]:
    """Return the markers of bodies, numbered in their order."""
    found = []
    for index, ((x, y, yaw), radius, size, height) in enumerate(zip(*(part.tolist() for part in bodies), strict=True)):
        kind = CYLINDER if radius else CUBE
        made = marker(FRAMES.of(MOVING), name, kind, index=index, colour=_COLOURS[name], stamp_ns=stamp_ns)
        made.pose.position.x, made.pose.position.y, made.pose.position.z = x, y, 0.5 * height
        made.pose.orientation.z, made.pose.orientation.w = quaternion_from_yaw(yaw)
        made.scale.x, made.scale.y = (2.0 * radius, 2.0 * radius) if radius else size
        made.scale.z = height
        found.append(made)
    return found


def _bodies(name: str, markers: list[Any], most: int) -> Bodies:
    """Return the bodies of markers of one namespace, which must be numbered in their order."""
    numbers = [one.id for one in markers]
    if len(markers) > most or numbers != list(range(len(markers))):
        raise MessageError(f"markers of {name} are more than {most}, or their numbers are not 0, 1, 2, ...")
    rows = []
    for one in markers:
        at, turn, scale = one.pose.position, one.pose.orientation, one.scale
        if one.type not in (CYLINDER, CUBE) or (one.type == CYLINDER and scale.x != scale.y):
            raise MessageError(f"marker {one.id} of {name} is neither an upright cylinder nor a box")
        sizes = (0.5 * scale.x, 0.0, 0.0) if one.type == CYLINDER else (0.0, scale.x, scale.y)
        rows.append((at.x, at.y, yaw_from_quaternion(turn.x, turn.y, turn.z, turn.w), *sizes, scale.z))
    table = np.array(rows, np.float64).reshape(-1, 7)
    if not (np.isfinite(table).all() and (table[:, 3:] >= 0.0).all() and table[:, 3:6].any(axis=1).all()):
        raise MessageError(f"markers of {name} have values that are not finite, or no size")
    return Bodies(table[:, :3], table[:, 3], table[:, 4:6], table[:, 6])
