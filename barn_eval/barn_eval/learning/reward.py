"""Rewards, and the distance left to the goal that they are computed from.

The reward for progress is a difference of potentials. That leaves the best policy as it
is (Ng, Harada and Russell, "Policy invariance under reward transformations", ICML
1999); exactly so for discount factors near 1.
"""

import math
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from barn_eval.learning.config import STRAIGHT, RewardConfig
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.protocol import Course
from barn_planners.policy.space import Vector
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.kernel import kernel
from barn_worlds.datasets.dataset import MAX_CACHED_WORLDS
from barn_worlds.worlds.world import World

# More than the relative error of a squared distance.
_ROUNDING = 1.0 + 1e-12
# Rewards per m of progress, per s, per s at an obstacle; range in m from which on
# nothing is near; reward per s in which the collision check changes the command.
RewardWeights: TypeAlias = tuple[float, float, float, float, float]


# Learners meet the same worlds again and again, as long as their data set keeps them.
@lru_cache(maxsize=MAX_CACHED_WORLDS)
def path_points(world: World, course: Course, along: str) -> Floats:
    """Return points (n, 3) of the path to the goal: x, y and the length left, in m.

    Args:
        world: World of the episode.
        course: Start and goal in it.
        along: "straight" for the goal alone, "path" for the world's own path to it.

    Returns:
        Points (n, 3): x and y in the map frame, and the length of the path from there
        to the goal, all in m.
    """
    points = np.array([[course.goal.x, course.goal.y]])
    if along != STRAIGHT:
        points = np.vstack([world.path_m(), points])
    sides = np.hypot(*np.diff(points, axis=0).T)
    # From each point to the goal, so the sum begins at the end.
    lengths = np.append(np.cumsum(sides[::-1])[::-1], 0.0)
    return np.column_stack([points, lengths])


@kernel
def measure_distances_left(
    points: Floats,
    counts: Integers,
    positions: Floats,
    rows: Integers,
    distances_m: Floats,
) -> None:
    """Fill in each robot's distance to its nearest path point plus the path left, in m.

    Args:
        points: Points (n, k, 3) of each robot's path, as of `path_points`.
        counts: How many of them a path has, (n,).
        positions: Positions (n, 2 or more) of the robots in the map frame, in m.
        rows: Robots to measure.
        distances_m: Distances (n,), changed in place.
    """
    for row in rows:
        x = positions[row, 0]
        y = positions[row, 1]
        nearest_square = np.inf
        for k in range(counts[row]):
            dx = points[row, k, 0] - x
            dy = points[row, k, 1] - y
            nearest_square = min(nearest_square, dx * dx + dy * dy)

        # Squares are fast, but points at nearly equal distance need the exact distance
        # to tell which is first.
        nearest_m = np.inf
        for k in range(counts[row]):
            dx = points[row, k, 0] - x
            dy = points[row, k, 1] - y
            if dx * dx + dy * dy <= nearest_square * _ROUNDING:
                distance_m = math.hypot(dx, dy)
                if distance_m < nearest_m:
                    nearest_m = distance_m
                    distances_m[row] = distance_m + points[row, k, 2]


def reward_weights(config: RewardConfig) -> RewardWeights:
    """Return the five weights of `reward_steps`, in the order of `RewardWeights`."""
    return (
        config.progress_per_m,
        config.per_second,
        config.near_per_second,
        config.near_m,
        config.shielded_per_second,
    )


@kernel
def reward_steps(
    weights: RewardWeights,
    before_m: Floats,
    after_m: Floats,
    period_s: float,
    shares: Vector,
    range_m: float,
    is_changed: Bools,
    rewards: Floats,
) -> None:
    """Fill `rewards` for one step of all robots, without what an episode's end adds.

    Args:
        weights: As of `reward_weights`.
        before_m: Distances (n,) to the goal before the step.
        after_m: Distances (n,) after it.
        period_s: Time of the step.
        shares: Nearest returns (n, beams) as shares of `range_m`.
        range_m: Range limit of the observation.
        is_changed: Whether the collision check changed the command, (n,).
        rewards: Rewards (n,), filled.
    """
    progress_per_m, per_second, near_per_second, near_m, changed_per_second = weights
    for i in range(len(rewards)):
        nearest = shares[i, 0]
        for beam in range(1, shares.shape[1]):
            nearest = min(nearest, shares[i, beam])
        # Observations are of 32 bits, in which the product would be rounded.
        nearness = max(0.0, 1.0 - np.float64(nearest) * range_m / near_m)
        rate = (
            per_second + near_per_second * nearness + changed_per_second * is_changed[i]
        )
        rewards[i] = progress_per_m * (before_m[i] - after_m[i]) + rate * period_s


def final_reward(config: RewardConfig, verdict: Verdict) -> float:
    """Return what the end of an episode adds to the reward of its last step.

    Args:
        config: Rewards by kind of end.
        verdict: The referee's verdict about the trial.
    """
    if verdict.outcome is Outcome.SUCCESS:
        return config.success
    if verdict.outcome in (Outcome.COLLISION, Outcome.INVALID_COMMAND):
        return config.collision
    return config.out_of_time
