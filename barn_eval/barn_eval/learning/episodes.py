"""What reward and referee need of many episodes, in arrays: most steps decide nothing."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from barn_eval.learning.episode import Episode, way_left
from barn_eval.trials.referee import Reading, Referee
from barn_sim.batch import Readings
from barn_worlds.arrays import Floats, Integers
from barn_worlds.errors import ConfigError
from barn_worlds.types import Pose2D, Velocity2D, nanoseconds

if TYPE_CHECKING:
    from barn_eval.learning.environment import JackalEnv

_CLOSE_M = 1e-6  # of a threshold, where the referee itself has to decide
_NEVER_NS = 2**62


class Episodes:
    """Episodes of n environments that advance in a batch.

    running (n,): whether an episode runs; worlds (n,): their numbers; goals (n, 2): in the planning frame; left_m (n,):
    way left.
    """

    def __init__(self, count: int, readings: Readings, period_s: float) -> None:
        self.running = np.zeros(count, np.bool_)
        self.worlds = np.zeros(count, np.int64)
        self.goals = np.zeros((count, 2))
        self.left_m = np.zeros(count)
        self._readings = readings
        self._period_ns = nanoseconds(period_s)
        self._episodes: list[Episode | None] = [None] * count
        self._ways = np.full((count, 0, 3), np.inf)
        self._firsts = np.zeros((count, 2))  # positions by the source of the clock
        self._judged = np.full((count, 2, 2), np.inf)  # goals by the source of the protocol, two at most
        self._started_ns = np.full(count, _NEVER_NS)

    def put(self, index: int, env: "JackalEnv") -> None:
        """Take up the episode that an environment has begun; ConfigError if its distances differ from the others'."""
        episode = env.episode
        other = next((one for one in self._episodes if one is not None), episode)
        if other.spec.rules != episode.spec.rules:
            names = f"{episode.spec.world.name} and {other.spec.world.name}"
            raise ConfigError(f"worlds {names}: robots that advance together need worlds with cells of one size")
        sensors, readings, protocol = episode.sensors, self._readings, episode.spec.protocol
        self._episodes[index] = episode
        self.running[index], self.worlds[index] = episode.verdict is None, episode.spec.index
        self.goals[index] = episode.goal.x, episode.goal.y
        truth, odometry = sensors.truth.pose, sensors.odometry.pose
        readings.stamps_ns[index], readings.collisions[index] = sensors.stamp_ns, sensors.collision
        readings.truths[index] = truth.x, truth.y, truth.yaw
        readings.odometry[index] = odometry.x, odometry.y, odometry.yaw
        velocity = sensors.odometry.velocity
        readings.velocities[index], readings.ranges[index] = (velocity.linear, velocity.angular), sensors.scan.ranges
        self._firsts[index] = self._positions(protocol.clock_start_source)[index]
        self._judged[index] = np.inf
        for k, goal in enumerate(episode.referee.goals):
            self._judged[index, k] = goal.x, goal.y
        self._started_ns[index] = _NEVER_NS
        self._put_way(index, env.way.points)
        self.left_m[index] = self._way_left(np.array([index]))[0]

    def _put_way(self, index: int, points: Floats) -> None:
        missing = len(points) - self._ways.shape[1]
        if missing > 0:
            self._ways = np.pad(self._ways, ((0, 0), (0, missing), (0, 0)), constant_values=np.inf)
        self._ways[index] = np.inf
        self._ways[index, : len(points)] = points

    def _way_left(self, which: Integers) -> Floats:
        left_m: Floats = way_left(self._ways[which], self._readings.truths[which])
        return left_m

    def _positions(self, source: str) -> Floats:
        readings = self._readings
        positions: Floats = (readings.truths if source == "truth" else readings.odometry)[:, :2]
        return positions

    def progress(self, moved: Integers) -> Floats:
        """Return how much of the way has gone in a step (n,), in which these have moved."""
        before_m = self.left_m.copy()
        self.left_m[moved] = self._way_left(moved)
        progress_m: Floats = before_m - self.left_m
        return progress_m

    def judge(self, moved: Integers) -> list[int]:
        """Judge those that have moved; return which of them have ended."""
        return [index for index in moved[self._doubtful(moved)].tolist() if self._settle(index)]

    def _doubtful(self, moved: Integers) -> Integers:
        """Start clocks; return the places in `moved` of those that may have ended, or whose clock may have started."""
        if not len(moved):
            return moved
        readings, some = self._readings, self._episodes[moved[0]]
        assert some is not None
        protocol = some.spec.rules
        stamps_ns = readings.stamps_ns[moved]
        away = self._positions(protocol.clock_start_source)[moved] - self._firsts[moved]
        beyond_m = np.hypot(away[:, 0], away[:, 1]) - protocol.clock_start_distance_m
        waiting = self._started_ns[moved] == _NEVER_NS
        doubtful = readings.collisions[moved] | (waiting & (np.abs(beyond_m) < _CLOSE_M))
        self._started_ns[moved[waiting & (beyond_m >= _CLOSE_M)]] = stamps_ns[waiting & (beyond_m >= _CLOSE_M)]
        started_ns = self._started_ns[moved]
        waiting = started_ns == _NEVER_NS
        doubtful |= waiting & (stamps_ns >= nanoseconds(protocol.first_motion_limit_s))
        doubtful |= ~waiting & (stamps_ns - started_ns >= nanoseconds(protocol.limit_s))
        to_goal = self._judged[moved] - self._positions(protocol.goal_source)[moved][:, None]
        left_m = np.hypot(to_goal[:, :, 0], to_goal[:, :, 1]).min(axis=1)
        doubtful |= ~(left_m > protocol.goal_distance_m + _CLOSE_M)  # so is what is not a number
        return np.flatnonzero(doubtful)

    def refuse(self, index: int, command: Velocity2D) -> None:
        """Let the referee of an episode refuse a command that is not finite."""
        self._resume(index, self._reading(index)).command(command)

    def _settle(self, index: int) -> bool:
        """Let the referee of an episode judge the last reading; return whether it has ended."""
        reading = self._reading(index)
        before = replace(reading, stamp_ns=reading.stamp_ns - self._period_ns, collision=False)
        referee = self._resume(index, before)
        verdict = referee.observe(reading)
        self._started_ns[index] = _NEVER_NS if referee.clock_start_ns is None else referee.clock_start_ns
        return verdict is not None

    def _resume(self, index: int, last: Reading) -> Referee:
        """Return the referee of an episode, who knows of all up to a reading."""
        episode, started_ns = self._episodes[index], int(self._started_ns[index])
        assert episode is not None
        episode.referee.resume(last, None if started_ns > last.stamp_ns else started_ns)
        return episode.referee

    def _reading(self, index: int) -> Reading:
        readings = self._readings
        odometry, truth = (Pose2D(*row[index].tolist()) for row in (readings.odometry, readings.truths))
        return Reading(int(readings.stamps_ns[index]), odometry, truth, bool(readings.collisions[index]))
