"""The reward of a step: progress towards the goal, time, nearness of obstacles, and how the episode ended.

Progress is a difference of potentials, which does not change what the best policy is (Ng, Harada and Russell, "Policy
invariance under reward transformations", ICML 1999; exactly so for discount factors near 1).
"""

import numpy as np

from barn_eval.learning.config import RewardConfig
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.protocol import Course
from barn_worlds.types import Pose2D
from barn_worlds.world import World


class WayLeft:
    """How far it is to the goal: straight, or to the nearest cell of the world's path and on along it."""

    def __init__(self, world: World, course: Course, along: str) -> None:
        goal = np.array([[course.goal.x, course.goal.y]])
        points = goal if along == "straight" else np.vstack([world.path_m(), goal])
        lengths = np.hypot(*np.diff(points, axis=0).T)
        self._x, self._y = points[:, 0].copy(), points[:, 1].copy()
        self._rest = np.append(np.cumsum(lengths[::-1])[::-1], 0.0)

    def metres(self, pose: Pose2D) -> float:
        """Return the way left from a true pose in the map frame."""
        away = np.hypot(self._x - pose.x, self._y - pose.y)
        nearest = int(away.argmin())
        return float(away[nearest] + self._rest[nearest])


def step_reward(
    config: RewardConfig, progress_m: float, period_s: float, nearest_m: float, shielded: bool, verdict: Verdict | None
) -> float:
    """Return the reward of a step of `period_s`.

    progress_m: change of the way left; nearest_m: nearest return of the lidar at its end; shielded: whether the shield
    has changed the command.
    """
    nearness = max(0.0, 1.0 - nearest_m / config.near_m)
    rate = config.per_second + config.near_per_second * nearness + config.shielded_per_second * shielded
    reward = config.progress_per_m * progress_m + rate * period_s
    if verdict is None:
        return reward
    if verdict.outcome is Outcome.SUCCESS:
        return reward + config.success
    ended_by_itself = verdict.outcome in (Outcome.COLLISION, Outcome.INVALID_COMMAND)
    return reward + (config.collision if ended_by_itself else config.out_of_time)
