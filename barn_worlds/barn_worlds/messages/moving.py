"""Moving obstacles at an instant, for those who look at a bag: markers with their recent trails, and plain poses."""

import numpy as np

from barn_worlds.arrays import Floats
from barn_worlds.messages.cdr import make, serialise
from barn_worlds.messages.encode import header
from barn_worlds.messages.markers import CUBE, CYLINDER, LINE_LIST, marker
from barn_worlds.messages.topics import FRAMES, MOVING, MOVING_POSES
from barn_worlds.types import quaternion_from_yaw
from barn_worlds.world import World

TRAIL_S = 1.0
_TRAIL_STEP_S = 0.1
_TRAIL_M = 0.05
_OBSTACLES, _TRAILS, _WALLS = "obstacles", "trails", "walls"
_COLOURS = {_OBSTACLES: (0.84, 0.37, 0.0, 1.0), _TRAILS: (0.84, 0.37, 0.0, 0.6), _WALLS: (0.55, 0.57, 0.6, 1.0)}


def encode_moving(world: World, time_s: float, stamp_ns: int) -> bytes:
    """Return visualization_msgs/MarkerArray of a world's moving obstacles and their trails, and of its walls.

    time_s: into their motions. A marker keeps its namespace and number from message to message.
    """
    tracks, frame = world.tracks, FRAMES.of(MOVING)
    places = tracks.at(time_s)[0]
    shapes = [(*size, yaw) for size, yaw in zip(tracks.size_m.tolist(), tracks.yaw_rad.tolist(), strict=True)]
    found = [
        _body(_OBSTACLES, index, (x, y), shape, 2.0 * tracks.radius_m[index], tracks.height_m[index], stamp_ns)
        for index, ((x, y), shape) in enumerate(zip(places.tolist(), shapes, strict=True))
    ]
    found += [
        _body(_WALLS, index, (one.x_m, one.y_m), (one.size_x_m, one.size_y_m, one.yaw_rad), 0.0, one.height_m, stamp_ns)
        for index, one in enumerate(world.walls)
    ]
    line = marker(frame, _TRAILS, LINE_LIST, colour=_COLOURS[_TRAILS], stamp_ns=stamp_ns)
    line.scale.x = _TRAIL_M
    line.points = [make("geometry_msgs/msg/Point", x=x, y=y) for x, y in trail_segments(world, time_s).tolist()]
    return serialise(make(MOVING.type_name, markers=[*found, line]))


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


def trail_segments(world: World, time_s: float) -> Floats:
    """Return the ends (2 n, 2) of the pieces of the ways of the last `TRAIL_S`, jumps left out."""
    steps = round(TRAIL_S / _TRAIL_STEP_S)
    positions = world.tracks.over(time_s - _TRAIL_STEP_S * np.arange(steps + 1.0))[0]
    lengths = np.hypot(*np.moveaxis(np.diff(positions, axis=0), 2, 0))
    moved = lengths <= world.tracks.fastest_mps * _TRAIL_STEP_S * 1.001
    pairs = np.stack([positions[:-1], positions[1:]], axis=2)[moved]
    segments: Floats = pairs.reshape(-1, 2)
    return segments


def _body(
    name: str,
    index: int,
    place: tuple[float, float],
    shape: tuple[float, float, float],
    diameter_m: float,
    height_m: float,
    stamp_ns: int,
) -> object:
    """Return the marker of a cylinder with a diameter, or of a box of a length, width and heading."""
    kind = CYLINDER if diameter_m else CUBE
    made = marker(FRAMES.of(MOVING), name, kind, index=index, colour=_COLOURS[name], stamp_ns=stamp_ns)
    made.pose.position.x, made.pose.position.y = place
    made.pose.position.z = 0.5 * height_m
    made.pose.orientation.z, made.pose.orientation.w = quaternion_from_yaw(shape[2])
    made.scale.x, made.scale.y = (diameter_m, diameter_m) if diameter_m else shape[:2]
    made.scale.z = height_m
    return made
