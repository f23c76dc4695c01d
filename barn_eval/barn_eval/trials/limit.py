"""The least time in which a robot could have driven a course: a lower bound of every time on the clock.

docs/efficiency.md has the proof. From the reading before the one that starts the clock to the one that ends the trial,
the robot goes from the disc around its start in which no clock starts to the disc around the goal in which it has
arrived, without a contact where that ends the trial. So it drives at least the shortest way between the two that a disc
inside its outline could take, at no more than its speed.
"""

from functools import lru_cache

import numpy as np

from barn_eval.trials.protocol import Course, Protocol
from barn_sim.config import SimulatorConfig
from barn_worlds.geometry.footprint import contact_of
from barn_worlds.geometry.shortest import shortest_way_m
from barn_worlds.robots.robot import Chassis
from barn_worlds.worlds.world import World

# By how much of the commanded speed base_link may go faster on average: the wheels of a skid-steered robot slide where
# it turns, and its weight shifts to the outer ones.
SLIP = {"skid_steer": 0.02, "differential": 0.005}


def top_speed_mps(simulator: SimulatorConfig, speed_cap_mps: float) -> float:
    """Return the highest speed that a robot takes from a planner with this cap, 0 for one that declares none."""
    limit = simulator.drive.max_speed_m_s
    return min(speed_cap_mps, limit) if speed_cap_mps > 0.0 else limit


def least_time_s(rules: Protocol, course: Course, world: World, simulator: SimulatorConfig, speed_mps: float) -> float:
    """Return a time on the clock that no trial on this course falls below.

    Args:
        rules: the protocol in the size of the world.
        course: start and goal in it.
        world: of which only the cylinders count, where a contact ends the trial and truth is what decides.
        simulator: whose robot drives.
        speed_mps: the highest that is commanded.
    """
    fastest = speed_mps * (1.0 + SLIP[simulator.chassis.kind])
    length_m = _least_way_m(rules, course, world, simulator.chassis)
    return max(0.0, length_m / fastest - rules.control_period_s) if fastest > 0.0 else 0.0


@lru_cache(maxsize=64)
def _least_way_m(rules: Protocol, course: Course, world: World, chassis: Chassis) -> float:
    """Return a lower bound of the way in m from the one disc to the other."""
    near_m, goal_m = rules.clock_start_distance_m, rules.goal_distance_m
    start, goal = (np.array([pose.x, pose.y]) for pose in (course.start, course.goal))
    centres, radius_m = np.empty((0, 2)), 0.0
    if rules.collision_ends_trial and rules.clock_start_source == rules.goal_source == "truth":
        inside_m = -float(contact_of(chassis).distances(np.zeros(1), np.zeros(1))[0])
        radius_m = world.cylinder_radius_m + max(0.0, inside_m)
        # a straight line in either disc completes the way to one from start to goal, which must not be barred
        from_start, from_goal = (np.hypot(*(world.cylinders_m - point).T) - radius_m for point in (start, goal))
        centres = world.cylinders_m[(from_start >= near_m) & (from_goal >= goal_m)]
    return max(0.0, shortest_way_m(start, goal, centres, radius_m) - near_m - goal_m)
