"""What reward and referee need of many episodes, in arrays: most steps decide nothing."""

from typing import TYPE_CHECKING

import numpy as np

from barn_eval.learning.episode import Episode, way_left
from barn_eval.trials import rules
from barn_sim.motion.batch import Readings
from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.errors import ConfigError

if TYPE_CHECKING:
    from barn_eval.learning.environment import JackalEnv


class Episodes:
    """Episodes of n environments that advance in a batch.

    running (n,): whether an episode runs; worlds (n,): their numbers; goals (n, 2): in the planning frame; left_m (n,):
    way left.
    """

    def __init__(self, count: int, readings: Readings) -> None:
        self.running = np.zeros(count, np.bool_)
        self.worlds = np.zeros(count, np.int64)
        self.goals = np.zeros((count, 2))
        self.left_m = np.zeros(count)
        self._readings = readings
        self._episodes: list[Episode | None] = [None] * count
        self._ways, self._points = np.zeros((count, 0, 3)), np.zeros(count, np.int64)
        self._states = np.zeros(count, rules.STATE)

    def put(self, index: int, env: "JackalEnv") -> None:
        """Take up the episode that an environment begins; ConfigError if its distances differ from the others'."""
        episode = env.episode
        other = next((one for one in self._episodes if one is not None), episode)
        if other.spec.rules is not episode.spec.rules and other.spec.rules != episode.spec.rules:
            names = f"{episode.spec.world.name} and {other.spec.world.name}"
            raise ConfigError(f"worlds {names}: robots that advance together need worlds with cells of one size")
        self._episodes[index] = episode
        self.running[index], self.worlds[index] = True, episode.spec.index
        goal = episode.spec.goal
        self.goals[index] = goal.x, goal.y
        episode.trial.referee.move_to(self._states[index : index + 1])
        self._put_way(index, env.way.points)

    def _put_way(self, index: int, points: Floats) -> None:
        missing = len(points) - self._ways.shape[1]
        if missing > 0:
            self._ways = np.pad(self._ways, ((0, 0), (0, missing), (0, 0)))
        self._ways[index, : len(points)], self._points[index] = points, len(points)

    def follow(self, which: Integers) -> Floats:
        """Look how far it is to the goal for those that have moved or begun; return how far it was for all (n,)."""
        before_m: Floats = self.left_m.copy()
        way_left(self._ways, self._points, self._readings.truths, which, self.left_m)
        return before_m

    def judge(self, which: Integers) -> list[int]:
        """Judge the last readings of those that have moved or begun; return which of them have ended."""
        readings = self._readings
        rules.observe(self._states, which, readings.stamps_ns, readings.odometry, readings.truths, readings.collisions)
        ended: list[int] = which[self._states["code"][which] != rules.RUNNING].tolist()
        self.running[ended] = False
        return ended
