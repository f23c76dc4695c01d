"""The true scene of a trial as one visualization_msgs/MarkerArray, for those who look at it and never for a planner."""

import math
from dataclasses import replace

import numpy as np

from barn_worlds.base.errors import MessageError
from barn_worlds.base.types import Pose2D, quaternion_from_yaw, yaw_from_quaternion
from barn_worlds.messages.cdr import Message, deserialise, make, serialise
from barn_worlds.messages.markers import CYLINDER, LINE_STRIP, SPHERE, marker
from barn_worlds.messages.topics import FRAMES, WORLD
from barn_worlds.worlds.scene import SceneCylinders, TrialScene

MOST_CYLINDERS = 1_000_000
_OBSTACLE, _WALL, _PATH, _START, _GOAL = "obstacles", "walls", "path", "start", "goal"
_COLOURS = {
    _OBSTACLE: (0.2, 0.22, 0.24, 1.0),
    _WALL: (0.55, 0.57, 0.6, 1.0),
    _PATH: (0.55, 0.57, 0.6, 0.8),
    _START: (0.0, 0.45, 0.7, 1.0),
    _GOAL: (0.0, 0.62, 0.45, 0.5),
}
_LINE_M, _START_M, _DISC_M = 0.02, 0.2, 0.01


def encode_scene(scene: TrialScene, stamp_ns: int) -> bytes:
    """Return visualization_msgs/MarkerArray: a cylinder per obstacle, the path, start and goal.

    Every marker keeps its namespace and number, so that a later scene takes the place of an earlier one.
    """
    found = [*_cylinders(_OBSTACLE, scene.obstacles, stamp_ns), *_cylinders(_WALL, scene.walls, stamp_ns)]
    if len(scene.path_m):
        line = _marker(_PATH, LINE_STRIP, stamp_ns)
        line.scale.x = _LINE_M
        line.points = [make("geometry_msgs/msg/Point", x=x, y=y) for x, y in scene.path_m.tolist()]
        found.append(line)
    if scene.start is not None:
        found.append(_disc(_START, SPHERE, scene.start, _START_M, stamp_ns))
    if scene.goal is not None:
        found.append(_disc(_GOAL, CYLINDER, scene.goal, 2.0 * scene.goal_distance_m, stamp_ns))
    return serialise(make(WORLD.type_name, markers=found))


def decode_scene(data: bytes) -> TrialScene:
    """Return what `encode_scene` has written; MessageError for anything else."""
    try:
        markers = deserialise(data, WORLD.type_name).markers
    except Exception as error:  # the library raises errors of any kind for malformed bytes
        raise MessageError(f"not a message of type {WORLD.type_name} ({error})") from None
    kinds: dict[str, list[Message]] = {name: [] for name in _COLOURS}
    for one in markers:
        if one.ns not in kinds or one.header.frame_id != FRAMES.map:
            raise MessageError(f"a marker of the namespace {one.ns[:40]!r} in the frame {one.header.frame_id[:40]!r}")
        kinds[one.ns].append(one)
    path = [(point.x, point.y) for line in kinds[_PATH] for point in line.points]
    goal = kinds[_GOAL][0] if kinds[_GOAL] else None
    scene = TrialScene(
        _standing(kinds[_OBSTACLE]),
        _standing(kinds[_WALL]),
        np.array(path, np.float64).reshape(-1, 2),
        _pose(kinds[_START][0]) if kinds[_START] else None,
        _pose(goal) if goal else None,
        0.5 * goal.scale.x if goal else 0.0,
    )
    poses = [(pose.x, pose.y, pose.yaw) for pose in (scene.start, scene.goal) if pose]
    if not all(np.isfinite(part).all() for part in (scene.cylinders_m, scene.path_m, poses, scene.goal_distance_m)):
        raise MessageError("a scene with values that are not finite")
    return scene


def _cylinders(name: str, cylinders: SceneCylinders, stamp_ns: int) -> list[Message]:
    """Return a marker per cylinder: copies of one, in which number and position differ."""
    first = _marker(name, CYLINDER, stamp_ns)
    first.scale.x = first.scale.y = 2.0 * cylinders.radius_m
    first.scale.z = cylinders.height_m
    where = first.pose.position
    places = (
        replace(first.pose, position=replace(where, x=x, y=y, z=0.5 * cylinders.height_m))
        for x, y in cylinders.centres_m.tolist()
    )
    return [replace(first, id=index, pose=pose) for index, pose in enumerate(places)]


def _disc(name: str, kind: int, pose: Pose2D, size_m: float, stamp_ns: int) -> Message:
    disc = _marker(name, kind, stamp_ns)
    disc.scale.x = disc.scale.y = size_m
    disc.scale.z = _DISC_M
    disc.pose.position.x, disc.pose.position.y = pose.x, pose.y
    disc.pose.orientation.z, disc.pose.orientation.w = quaternion_from_yaw(pose.yaw)
    return disc


def _marker(name: str, kind: int, stamp_ns: int) -> Message:
    return marker(FRAMES.of(WORLD), name, kind, colour=_COLOURS[name], stamp_ns=stamp_ns)


def _standing(markers: list[Message]) -> SceneCylinders:
    if len(markers) > MOST_CYLINDERS or len({(one.scale.x, one.scale.z) for one in markers}) > 1:
        raise MessageError(f"{len(markers)} cylinders of one namespace, of different sizes or too many")
    centres = np.array([(one.pose.position.x, one.pose.position.y) for one in markers], np.float64).reshape(-1, 2)
    radius_m, height_m = (0.5 * markers[0].scale.x, markers[0].scale.z) if markers else (0.0, 0.0)
    if not (math.isfinite(radius_m) and math.isfinite(height_m)):
        raise MessageError("cylinders of a size that is not finite")
    return SceneCylinders(centres, radius_m, height_m)


def _pose(one: Message) -> Pose2D:
    where, turn = one.pose.position, one.pose.orientation
    return Pose2D(where.x, where.y, yaw_from_quaternion(turn.x, turn.y, turn.z, turn.w))
