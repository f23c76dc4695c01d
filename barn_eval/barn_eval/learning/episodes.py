"""What reward and referee need of many episodes, in arrays: most steps decide nothing."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from barn_eval.learning.episode import Episode, way_left
from barn_eval.trials.referee import Reading, Referee
from barn_sim.body.nearness import Bools
from barn_sim.motion.batch import Readings
from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import Pose2D, Velocity2D, nanoseconds

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
        self._ways, self._points = np.zeros((count, 0, 3)), np.zeros(count, np.int64)
        self._firsts = np.zeros((count, 2))  # positions by the source of the clock
        self._judged = np.full((count, 2, 2), np.inf)  # goals by the source of the protocol, two at most
        self._started_ns = np.full(count, _NEVER_NS)

    def put(self, index: int, env: "JackalEnv") -> None:
        """Take up the episode that an environment begins; ConfigError if its distances differ from the others'."""
        episode = env.episode
        other = next((one for one in self._episodes if one is not None), episode)
        if other.spec.rules is not episode.spec.rules and other.spec.rules != episode.spec.rules:
            names = f"{episode.spec.world.name} and {other.spec.world.name}"
            raise ConfigError(f"worlds {names}: robots that advance together need worlds with cells of one size")
        self._episodes[index] = episode
        self.running[index], self.worlds[index] = True, episode.spec.index
        self.goals[index] = episode.goal.x, episode.goal.y
        self._judged[index] = np.inf
        for k, goal in enumerate(episode.referee.goals):
            self._judged[index, k] = goal.x, goal.y
        self._started_ns[index] = _NEVER_NS
        self._put_way(index, env.way.points)

    def _put_way(self, index: int, points: Floats) -> None:
        missing = len(points) - self._ways.shape[1]
        if missing > 0:
            self._ways = np.pad(self._ways, ((0, 0), (0, missing), (0, 0)))
        self._ways[index, : len(points)], self._points[index] = points, len(points)

    def _positions(self, source: str) -> Floats:
        readings = self._readings
        positions: Floats = (readings.truths if source == "truth" else readings.odometry)[:, :2]
        return positions

    def begin(self, index: int) -> bool:
        """Judge the first reading of an episode; return whether that has ended it."""
        episode = self._episodes[index]
        assert episode is not None
        self._firsts[index] = self._positions(episode.spec.rules.clock_start_source)[index]
        self.running[index] = episode.referee.observe(self._reading(index)) is None
        return not self.running[index]

    def follow(self, which: Integers) -> Floats:
        """Look how far it is to the goal for those that have moved or begun; return how far it was for all (n,)."""
        before_m: Floats = self.left_m.copy()
        way_left(self._ways, self._points, self._readings.truths, which, self.left_m)
        return before_m

    def judge(self, moved: Integers) -> list[int]:
        """Judge those that have moved; return which of them have ended."""
        return [index for index in self._doubtful(moved).tolist() if self._settle(index)]

    def _doubtful(self, moved: Integers) -> Integers:
        """Start clocks; return those that may have ended, or whose clock may have started."""
        if not len(moved):
            return moved
        readings, some = self._readings, self._episodes[moved[0]]
        assert some is not None
        protocol = some.spec.rules
        found: Integers = doubtful(
            moved, readings.stamps_ns, readings.collisions, self._positions(protocol.clock_start_source), self._firsts,
            self._positions(protocol.goal_source), self._judged, self._started_ns,
            (protocol.clock_start_distance_m, protocol.goal_distance_m),
            (nanoseconds(protocol.first_motion_limit_s), nanoseconds(protocol.limit_s)),
        )  # fmt: skip
        return found

    def refuse(self, index: int, command: Velocity2D) -> None:
        """Let the referee of an episode refuse a command that is not finite."""
        self._resume(index, self._reading(index)).command(command)

    def _settle(self, index: int) -> bool:
        """Let the referee of an episode judge the last reading; return whether it has ended."""
        reading = self._reading(index)
        before = Reading(reading.stamp_ns - self._period_ns, reading.odometry, reading.truth, False)
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


@njit(cache=True)
def doubtful(
    moved: Integers,
    stamps_ns: Integers,
    collisions: Bools,
    positions: Floats,
    firsts: Floats,
    places: Floats,
    goals: Floats,
    started_ns: Integers,
    distances_m: tuple[float, float],
    limits_ns: tuple[int, int],
) -> Integers:
    """Return those of `moved` whose referee has to look: they may have ended, or their clock may have started.

    Of n episodes: positions, firsts: x, y now and at first, by the source of the clock; places: by that of the goals
    (n, 2, 2); started_ns: start of the clock, which is filled in where it surely starts. distances_m: at which the
    clock starts and the goal is reached; limits_ns: for the first motion and on the clock.
    """
    found, count = np.empty(len(moved), np.int64), 0
    for i in moved:
        look = collisions[i]
        if started_ns[i] == _NEVER_NS:
            beyond_m = math.hypot(positions[i, 0] - firsts[i, 0], positions[i, 1] - firsts[i, 1]) - distances_m[0]
            look = look or abs(beyond_m) < _CLOSE_M
            if beyond_m >= _CLOSE_M:
                started_ns[i] = stamps_ns[i]
        if started_ns[i] == _NEVER_NS:
            look = look or stamps_ns[i] >= limits_ns[0]
        else:
            look = look or stamps_ns[i] - started_ns[i] >= limits_ns[1]
        for k in range(goals.shape[1]):
            left_m = math.hypot(goals[i, k, 0] - places[i, 0], goals[i, k, 1] - places[i, 1])
            look = look or not left_m > distances_m[1] + _CLOSE_M  # so is what is not a number
        if look:
            found[count] = i
            count += 1
    return found[:count]
