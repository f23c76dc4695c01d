"""The true scene of a trial, for its bag: obstacles, walls, path, start and goal, whatever the planner is told."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from barn_eval.trials.protocol import Protocol
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trajectory import Floats
from barn_sim.config import chassis_in
from barn_worlds.base.config import from_dict
from barn_worlds.base.errors import BarnError
from barn_worlds.base.types import nanoseconds, seconds
from barn_worlds.messages.moving import encode_moving, encode_moving_poses
from barn_worlds.messages.scene import encode_scene
from barn_worlds.messages.topics import MOVING, MOVING_POSES, WORLD, Outgoing
from barn_worlds.worlds.dataset import open_dataset
from barn_worlds.worlds.scene import TrialScene, scene_of

TRUE_TOPICS = (WORLD, MOVING, MOVING_POSES)  # which nobody publishes
MOVED_M = 0.01  # by which an obstacle has been pushed and does not only tremble


def trial_scene(spec: TrialSpec) -> TrialScene:
    """Return the scene in which a trial begins."""
    return scene_of(spec.world, spec.course.start, spec.course.goal, spec.rules.goal_distance_m)


def first_scene(spec: TrialSpec, stamp_ns: int) -> Outgoing:
    """Return the scene in which a trial begins, as a message."""
    return Outgoing(WORLD, encode_scene(trial_scene(spec), stamp_ns))


def last_scene(spec: TrialSpec, cylinders_m: Floats, stamp_ns: int) -> Outgoing | None:
    """Return the scene with cylinders at centres (k, 2), in the order of `World.cylinders_m`; None if none moved."""
    if not (np.hypot(*(cylinders_m - spec.world.cylinders_m).T) > MOVED_M).any():
        return None
    return Outgoing(WORLD, encode_scene(trial_scene(spec).moved(cylinders_m), stamp_ns))


def moving_scene(spec: TrialSpec, since_start_ns: int, stamp_ns: int) -> list[Outgoing]:
    """Return moving obstacles and walls so long after the start of a trial; nothing without any, or if none is due."""
    some = spec.world.moving or spec.world.walls
    if not some or since_start_ns % nanoseconds(MOVING.period_s):
        return []
    time_s = spec.phase_s + seconds(since_start_ns)
    return [
        Outgoing(MOVING, encode_moving(spec.world, time_s, stamp_ns)),
        Outgoing(MOVING_POSES, encode_moving_poses(spec.world, time_s, stamp_ns)),
    ]


def found_scene(trial: Mapping[str, Any]) -> TrialScene | None:
    """Return the scene of a trial whose bag has none, from its specification: its world by data set and checksum.

    None where the data set is not at hand, or its world is another by now.
    """
    try:
        about, protocol = trial["world"], from_dict(Protocol, trial["protocol"], "protocol")
        world = open_dataset(str(trial["dataset"])).load(int(about["index"]))
        if world.checksum != about["checksum"]:
            return None
        rules = protocol.sized(world, chassis_in(trial.get("simulator")))
        course = rules.course(world)
        return scene_of(world, course.start, course.goal, rules.goal_distance_m)
    except (BarnError, OSError, KeyError, TypeError, ValueError, OverflowError):
        return None
