"""Encounters of a robot with moving obstacles: distances, times, the first hit."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from barn_eval.trials.protocol import Protocol
from barn_eval.trials.trajectory import Trajectory, compute_clearances
from barn_worlds.base.arrays import Floats, side_lengths
from barn_worlds.base.types import NANOSECONDS_PER_SECOND
from barn_worlds.geometry.bodies import moving_bodies, wall_bodies
from barn_worlds.geometry.footprint import Footprint
from barn_worlds.worlds.world import World

NEAR_M = 0.5  # from a moving obstacle
# A robot this slow is at rest; one with no more than this share of the closing speed
# has not caused the contact.
AT_REST_MPS = 0.05
INNOCENT_SHARE = 0.1


@dataclass(frozen=True)
class Encounters:
    """Figures of a trial among moving obstacles; None where they do not apply.

    Ratios to the straight run, from the start to arrival, exist only for a success.
    Values of a hit are from the last reading before the first contact.
    """

    phase_s: float  # time into their motions at the start
    # Smallest distance from the robot's outline, 0 in contact.
    moving_clearance_m: float | None
    # The shortest at any reading, if all obstacles kept their velocities and the robot
    # its heading. A box counts as the disc around it.
    time_to_collision_s: float | None
    near_s: float  # within `NEAR_M` of one
    path_over_straight: float | None  # driven length over that of the run
    # Time on the clock over that of the run at the protocol's reference speed.
    time_over_straight: float | None
    touched: str = ""  # name of the moving obstacle of the first contact
    hit_robot_mps: float | None = None  # the robot's speed
    hit_closing_mps: float | None = None  # at which the two approached each other
    # The robot's share in that: 1 against an obstacle at rest, 0 if it was run over.
    hit_robot_share: float | None = None

    @property
    def hit_at_rest(self) -> bool:
        """Whether a moving obstacle hit the robot while that drove below 0.05 m/s."""
        return self.hit_robot_mps is not None and self.hit_robot_mps < AT_REST_MPS

    @property
    def not_at_fault(self) -> bool:
        """Whether a hit robot was at rest or had below a tenth of the closing speed.

        False without a contact.
        """
        share = self.hit_robot_share
        return self.hit_at_rest or (share is not None and share < INNOCENT_SHARE)


def measure_encounters(
    trajectory: Trajectory,
    world: World,
    phase_s: float,
    outline: Footprint,
    protocol: Protocol,
    traversal_s: float | None,
) -> Encounters | None:
    """Return a trial's distances and times to moving obstacles, None if none move.

    Args:
        trajectory: What the robot did, in the map frame.
        world: World with the obstacles' motions.
        phase_s: How far into their motions they were at the start.
        outline: What can touch of the robot, in base_link.
        protocol: Rules of the trial, in the size of its world.
        traversal_s: Time on the clock of a success, None for any other outcome.
    """
    if not world.moving:
        return None
    since_start_ns = trajectory.stamps_ns - trajectory.stamps_ns[:1]
    times_s = since_start_ns / NANOSECONDS_PER_SECOND + phase_s
    positions, velocities = world.tracks.over(times_s)
    gaps = np.empty(positions.shape[:2])
    waits = np.empty_like(gaps)
    # Obstacles move without turning, so only the centers of their shapes change.
    shapes = moving_bodies(world.tracks, phase_s).shapes()
    for k, (x, y, yaw) in enumerate(trajectory.truth.tolist()):
        speed = trajectory.velocity[k, 0]
        shapes[:, :2] = positions[k]
        gaps[k] = outline.gaps(shapes, x, y, yaw)
        waits[k] = outline.times_to_contact(shapes, velocities[k], x, y, yaw, speed)

    # No time has passed at the first reading.
    periods_s = np.diff(times_s, prepend=times_s[:1])
    shortest_s = float(waits.min(initial=math.inf))
    path_ratio = None
    time_ratio = None
    if traversal_s is not None:
        course = protocol.course(world)
        straight_m = course.start.distance(course.goal) - protocol.goal_distance_m
        path_ratio = float(side_lengths(trajectory.truth).sum()) / straight_m
        time_ratio = traversal_s * protocol.reference_speed_mps / straight_m
    return Encounters(
        phase_s=phase_s,
        moving_clearance_m=float(gaps.min()) if gaps.size else None,
        time_to_collision_s=shortest_s if math.isfinite(shortest_s) else None,
        near_s=float(periods_s[(gaps <= NEAR_M).any(axis=1)].sum()),
        path_over_straight=path_ratio,
        time_over_straight=time_ratio,
        **_first_hit(trajectory, world, times_s, gaps, outline),
    )


def _first_hit(
    trajectory: Trajectory,
    world: World,
    times_s: Floats,
    gaps: Floats,
    outline: Footprint,
) -> dict[str, Any]:
    """Return `Encounters` fields of the first contact, {} unless a moving body was hit.

    `times_s` (n,) counts from the start of the motions; `gaps` (n, k) has the distance
    in m to each of k obstacles.

    Contact lies between two readings; the obstacle is the one that is nearest at either
    of them. Speeds are those along the line from the robot's outline to it at the
    earlier reading.
    """
    contacts = np.flatnonzero(trajectory.contact)
    if not len(contacts):
        return {}
    contact = int(contacts[0])
    before = max(contact - 1, 0)
    readings = slice(before, contact + 1)
    nearest = gaps[readings].min(axis=0)
    obstacle = int(nearest.argmin())
    if _standing_gap(trajectory.truth[readings], world, outline) < nearest[obstacle]:
        return {}

    time_s = float(times_s[before])
    _, velocities = world.tracks.at(time_s)
    shape = moving_bodies(world.tracks, time_s).shapes()[obstacle]
    position = shape[:2]
    x, y, yaw = trajectory.truth[before].tolist()
    speed, yaw_rate = trajectory.velocity[before].tolist()
    base = np.array([x, y])
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    left = np.array([-math.sin(yaw), math.cos(yaw)])

    # The point of the obstacle that is nearest to the robot; of a cylinder, its center.
    target = position
    if not shape[2]:
        side = shape[5:]
        across = np.array([-shape[6], shape[5]])
        offset = base - position
        along = np.array([offset @ side, offset @ across])
        along = along.clip(-shape[3:5], shape[3:5])
        target = position + along[0] * side + along[1] * across

    # The point of the robot that is nearest to the target moves as a rigid body does.
    reach = target - base
    local = outline.nearest(reach @ ahead, reach @ left)
    lever = local[0] * ahead + local[1] * left
    line = target - base - lever
    # If the two touch, no line leads from one to the other, and speeds along it
    # count as 0.
    length = float(np.hypot(*line)) or math.inf
    robot_velocity = speed * ahead + yaw_rate * np.array([-lever[1], lever[0]])
    robot_mps = float(robot_velocity @ line) / length
    obstacle_mps = float(-velocities[obstacle] @ line) / length

    # Whoever moves away has no share in the collision.
    approach_mps = max(robot_mps, 0.0) + max(obstacle_mps, 0.0)
    robot_share = None
    if approach_mps > 0.0:
        robot_share = max(robot_mps, 0.0) / approach_mps
    return {
        "touched": world.tracks.names[obstacle],
        "hit_robot_mps": abs(speed),
        "hit_closing_mps": robot_mps + obstacle_mps,
        "hit_robot_share": robot_share,
    }


def _standing_gap(poses: Floats, world: World, outline: Footprint) -> float:
    """Return the least distance in m from poses to cylinders and walls, 0 to infinity.

    Poses (n, 3) are x, y m, yaw rad in the map frame.
    """
    cylinder_gaps = compute_clearances(
        poses, world.cylinders_m, world.cylinder_radius_m, outline
    )
    # Clearances go below 0 in an overlap. The gaps that this is compared with do not.
    gap = max(float(cylinder_gaps.min(initial=math.inf)), 0.0)
    walls = wall_bodies(world.walls).shapes()
    for x, y, yaw in poses.tolist():
        gap = min(gap, float(outline.gaps(walls, x, y, yaw).min(initial=math.inf)))
    return gap
