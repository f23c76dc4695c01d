"""Rewards, and the distance left to the goal from which they are computed.

Progress is a potential: the meters by which the robot is nearer to the goal than at the
start, and never below 0. A step earns the potential after it, discounted, less that
before it. A discounted sum of such differences depends only on where an episode ends,
so the best policy stays what it is (Ng, Harada and Russell, "Policy invariance under
reward transformations", ICML 1999). That holds only with the learner's own discount:
without it, driving to and fro would earn something, or resting would.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from barn_eval.learning.config import STRAIGHT, RewardConfig
from barn_eval.trials.protocol import Course
from barn_eval.trials.result import Outcome, Verdict
from barn_planners.policy.space import Vector
from barn_worlds.base.arrays import Floats, Integers, kernel, side_lengths
from barn_worlds.datasets.dataset import MAX_CACHED_WORLDS
from barn_worlds.worlds.world import World

# Outcomes that the learner's actions cause, beside success.
FAILURES = (Outcome.COLLISION, Outcome.LEFT_WORLD, Outcome.INVALID_COMMAND)

# More than the relative error of a squared distance.
_ROUNDING = 1.0 + 1e-12


class RewardWeights(NamedTuple):
    """Numbers of `RewardConfig` that compiled code reads."""

    discount: float
    progress_per_m: float
    per_second: float
    near_per_second: float
    near_m: float
    shielded_per_second: float
    shielded_limit: float


# Learners meet the same worlds again and again, as long as their data set keeps them.
@lru_cache(maxsize=MAX_CACHED_WORLDS)
def path_points(world: World, course: Course, along: str) -> Floats:
    """Return points (n, 3) of the path, or only the goal: x, y and length left, in m.

    Args:
        world: World of the episode.
        course: Start and goal in it.
        along: "straight" for the goal alone, "path" for the world's own path to it.

    Returns:
        Points (n, 3): x and y in the map frame, and the length of the path from there
        to the goal, all in m.
    """
    points = np.array([course.goal.position])
    if along != STRAIGHT:
        points = np.vstack([world.path_m(), points])
    sides = side_lengths(points)
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
        counts: Number of points (n,) of each path.
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
    """Return the weights that `reward_steps` takes from a configuration."""
    return RewardWeights(*[getattr(config, name) for name in RewardWeights._fields])


@kernel
def reward_steps(
    weights: RewardWeights,
    start_m: Floats,
    before_m: Floats,
    after_m: Floats,
    driven_s: Floats,
    changed_s: Floats,
    shares: Vector,
    range_m: float,
    shielded: Floats,
    rewards: Floats,
) -> None:
    """Fill `rewards` of a step, not of an end; add a check's capped cost to `shielded`.

    Args:
        weights: As of `reward_weights`.
        start_m: Distances (n,) to the goal at the start of the episodes.
        before_m: Distances (n,) before the step.
        after_m: Distances (n,) after it.
        driven_s: Time (n,) of the step.
        changed_s: How much of it (n,) the collision check changed the command.
        shares: Nearest returns (n, beams) after the step, as shares of `range_m`.
        range_m: Range limit of the observation.
        shielded: What the collision check has cost (n,) in the episodes so far, at
            least 0; changed in place.
        rewards: Rewards (n,), filled.
    """
    for i in range(len(rewards)):
        nearest = shares[i, 0]
        for beam in range(1, shares.shape[1]):
            nearest = min(nearest, shares[i, beam])
        # Observations are of 32 bits, in which the product would be rounded.
        nearness = max(0.0, 1.0 - np.float64(nearest) * range_m / weights.near_m)
        rate = weights.per_second + weights.near_per_second * nearness

        # A check that works all the time must not outweigh how the episode ends.
        changed = weights.shielded_per_second * changed_s[i]
        left = max(weights.shielded_limit - shielded[i], 0.0)
        changed = min(max(changed, -left), left)
        shielded[i] += abs(changed)

        before = max(start_m[i] - before_m[i], 0.0)
        after = max(start_m[i] - after_m[i], 0.0)
        progress = weights.progress_per_m * (weights.discount * after - before)
        rewards[i] = progress + rate * driven_s[i] + changed


def final_reward(config: RewardConfig, verdict: Verdict) -> float:
    """Return what the end of an episode adds to the reward of its last step.

    Args:
        config: Rewards by kind of end.
        verdict: The referee's verdict about the trial.
    """
    if verdict.outcome is Outcome.SUCCESS:
        return config.success
    if verdict.outcome in FAILURES:
        return config.collision
    return config.out_of_time
