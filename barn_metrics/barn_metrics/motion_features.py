"""What may make a world difficult whose obstacles move, from their tracks alone.

All are means over phases: a trial begins at any time into the motions, up to their longest period.
"""

from dataclasses import dataclass, fields

import numpy as np

from barn_metrics.motion import crossings, mean_speed, occupied, reach_m, straight_line
from barn_worlds.base.arrays import Floats
from barn_worlds.base.errors import WorldError
from barn_worlds.moving.tracks import jumps
from barn_worlds.robots.files import load_robot
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import World

_STEP_S = 0.1
_PHASES = 16
_WINDOW_S = 40.0  # what a robot at 0.5 m/s needs for DynaBARN's 20 m
_STRAIGHT_MPS = 0.5
_NEAR_M = 1.0


@dataclass(frozen=True)
class MotionFeatures:
    """Features of one world; lengths in m, the straight line is that from the begin of the path to its end.

    obstacles: how many. reach_m: mean radius of the circles around them. mean_speed_mps, fastest_mps: mean and largest
    of their mean speeds. crossings_per_s: how often a centre goes over the straight line. corridor_share: share of the
    line, over time, at which the robot's half width would touch an obstacle. appearing_per_s: how often one jumps to
    within 1 m of the line. straight_hits: share of phases in which a robot that drives along the line at 0.5 m/s and
    looks at nothing is touched. straight_share: share of the line that it has driven by then, 1 if it is not.
    count_times_speed: obstacles times mean speed, which every model must beat.
    """

    obstacles: float
    reach_m: float
    mean_speed_mps: float
    fastest_mps: float
    crossings_per_s: float
    corridor_share: float
    appearing_per_s: float
    straight_hits: float
    straight_share: float
    count_times_speed: float


FEATURES = tuple(item.name for item in fields(MotionFeatures))


def motion_features(world: World, robot: Robot | None = None) -> MotionFeatures:
    """Return the features of a world for a robot [the Jackal], which counts as the rectangle around it.

    WorldError where nothing moves or there is no straight line.
    """
    if not world.moving:
        raise WorldError(f"{world.name}: nothing moves in it")
    line, reach = straight_line(world), reach_m(world.tracks)
    driven_by = robot or load_robot("jackal")
    wide = reach + driven_by.width_m / 2.0
    speeds = [mean_speed(one) for one in world.moving]
    longest_s = max(one.motion.period_s for one in world.moving)
    counted, share, appeared, driven = [], [], [], []
    for begin_s in np.arange(_PHASES) / _PHASES * longest_s:
        times_s = np.arange(0.0, _WINDOW_S, _STEP_S)
        positions, velocities = world.tracks.over(begin_s + times_s)
        on_line, beside = line.place(positions)
        jumped = jumps(positions, velocities, _STEP_S)
        counted.append(crossings(on_line, beside, jumped, line.length_m) / _WINDOW_S)
        share.append(occupied(on_line[::2], beside[::2], wide, line.length_m))
        near = (np.abs(beside[1:]) < _NEAR_M) & (on_line[1:] > -_NEAR_M) & (on_line[1:] < line.length_m + _NEAR_M)
        appeared.append((jumped & near).sum() / _WINDOW_S)
        driven.append(_straight_share(on_line, beside, times_s, reach, line.length_m, driven_by))
    return MotionFeatures(
        obstacles=len(speeds),
        reach_m=float(reach.mean()),
        mean_speed_mps=float(np.mean(speeds)),
        fastest_mps=max(speeds),
        crossings_per_s=float(np.mean(counted)),
        corridor_share=float(np.mean(share)),
        appearing_per_s=float(np.mean(appeared)),
        straight_hits=float(np.mean(np.array(driven) < 1.0)),
        straight_share=float(np.mean(driven)),
        count_times_speed=len(speeds) * float(np.mean(speeds)),
    )


def _straight_share(
    on_line: Floats, beside: Floats, times_s: Floats, reach: Floats, length_m: float, robot: Robot
) -> float:
    """Return the share of the line that a robot has driven at a steady speed when an obstacle first touches it."""
    at_m = _STRAIGHT_MPS * times_s
    x_min, y_min, x_max, y_max = robot.chassis.extent_m
    from_robot = on_line - at_m[:, None]
    ahead = np.maximum(np.maximum(from_robot - x_max, x_min - from_robot), 0.0)
    aside = np.maximum(np.maximum(beside - y_max, y_min - beside), 0.0)
    touched = (np.hypot(ahead, aside) < reach).any(axis=1) & (at_m <= length_m)
    return float(at_m[touched.argmax()] / length_m) if touched.any() else 1.0
