"""Episodes that advance together, or one alone: trials as the benchmark runs them, what is seen, and the reward.

Progress in the reward is a difference of potentials, which does not change what the best policy is (Ng, Harada and
Russell, "Policy invariance under reward transformations", ICML 1999; exactly so for discount factors near 1).
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_eval.learning.config import EnvConfig, RewardConfig
from barn_eval.trials import rules
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.protocol import Course
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import RunningTrial
from barn_planners.policy.collision_check import CollisionCheckConfig, avoid_collision
from barn_planners.policy.space import ObservationEncoder
from barn_sim.batch import Batch
from barn_sim.config import SimulatorConfig
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import Pose2D, Scan, Velocity2D
from barn_worlds.worlds.world import World

Known = dict[int, tuple[TrialSpec, Floats]]  # by world
_ROUNDED = 1.0 + 1e-12  # more than squares of distances are rounded by


class Episodes:
    """Trials of some robots, a row each in all arrays; a step is a few compiled calls for all of them.

    Only robots near an obstacle, trials that may have ended, and whatever needs Python (the shield, a pose in a map)
    are looked at one by one.
    """

    def __init__(
        self,
        count: int,
        config: EnvConfig,
        simulator: SimulatorConfig,
        safety: CollisionCheckConfig,
    ) -> None:
        self.batch = Batch(count, simulator)
        self.readings = self.batch.readings
        self.seen = np.zeros(
            (count, config.observation.size), np.float32
        )  # last observations
        self.running = np.zeros(count, np.bool_)
        self.worlds = np.zeros(count, np.int64)
        self.left_m = np.zeros(count)
        self.known: Known = {}  # first trial in each world and its `way_points`
        self._config, self._safety, self._period_s = (
            config,
            safety,
            simulator.control_period_s,
        )
        self._weights = RewardWeights.of(config.reward)
        self._encoder = ObservationEncoder(config.observation)
        self._now: dict[int, tuple[RunningTrial, Simulator]] = {}
        self._scan: Scan | None = None
        self._goals = np.zeros((count, 2))
        self._ways, self._points = np.zeros((count, 0, 3)), np.zeros(count, np.int64)
        self._states = np.zeros(count, rules.STATE)

    def trial(self, index: int) -> RunningTrial:
        """Return the trial that runs or was the last."""
        return self._now[index][0]

    def scan(self, index: int) -> Scan:
        """Return the last scan of a robot."""
        return self._now[index][1].lidar.scan_of(
            int(self.readings.stamps_ns[index]), self.readings.ranges[index]
        )

    def begin(self, index: int, spec: TrialSpec, points: Floats) -> None:
        """Begin a trial, of which nothing is read yet; ConfigError if its distances differ from the others'."""
        other = next(
            (one.spec for k, (one, _) in self._now.items() if k != index), spec
        )
        if (
            other.scaled_protocol is not spec.scaled_protocol
            and other.scaled_protocol != spec.scaled_protocol
        ):
            names = f"{spec.world.name} and {other.world.name}"
            raise ConfigError(
                f"worlds {names}: robots that advance together need worlds with cells of one size"
            )
        start, seed = spec.course.start, spec.simulator_seed
        if (before := self._now.get(index)) is None:
            simulator = Simulator(
                spec.world,
                spec.simulator,
                start,
                seed,
                self.batch.scenes,
                fleet=self.batch.fleet,
                index=index,
            )
        else:
            simulator = before[1]
            simulator.begin(spec.world, start, seed)
        self.batch.put(index, simulator)
        trial = RunningTrial(spec, logged=False)
        trial.referee.move_to(self._states[index : index + 1])
        self._now[index] = trial, simulator
        self.running[index], self.worlds[index] = True, spec.world_number
        self._goals[index] = spec.goal.x, spec.goal.y
        missing = len(points) - self._ways.shape[1]
        if missing > 0:
            self._ways = np.pad(self._ways, ((0, 0), (0, missing), (0, 0)))
        self._ways[index, : len(points)], self._points[index] = points, len(points)

    def look(self, which: Integers) -> Floats:
        """Read the sensors, fill in the observations and find the way left; return that before, for all (n,)."""
        before_m: Floats = self.left_m.copy()
        if len(which) == 0:
            return before_m
        self.batch.read(which)
        readings, poses = self.readings, self.readings.odometry
        trial, simulator = self._now[int(which[0])]
        if trial.spec.protocol.map_given:
            poses = poses.copy()
            for index in which.tolist():
                pose = self._now[index][1].read_localization(
                    Pose2D(*poses[index].tolist())
                )
                poses[index] = pose.x, pose.y, pose.yaw
        if self._scan is None:
            self._scan = simulator.lidar.scan_of(0, readings.ranges[which[0]])
        self._encoder.encode_all(
            self._scan,
            readings.ranges,
            poses,
            self._goals,
            readings.velocities,
            which,
            self.seen,
        )
        way_left(self._ways, self._points, readings.truths, which, self.left_m)
        return before_m

    def judge(self, which: Integers) -> list[int]:
        """Judge the last readings of those that have moved or begun; return which of them have ended."""
        readings = self.readings
        rules.observe(
            self._states,
            which,
            readings.stamps_ns,
            readings.odometry,
            readings.truths,
            readings.collisions,
        )
        ended = which[self._states["code"][which] != rules.RUNNING]
        self.running[ended] = False
        return list(ended.tolist())

    def step(
        self, resting: Bools, actions: npt.NDArray[np.floating]
    ) -> tuple[Floats, list[int]]:
        """Let trials that do not rest (n,) go on for a period by actions (n, 2); return rewards (n,), which ended."""
        view = self._config.observation
        wanted = self._config.action.commands(actions)
        given, shielded = self._shielded(resting, wanted)
        finite = np.isfinite(given).all(axis=1)
        moving = (finite & ~resting).nonzero()[0]
        self.batch.advance(moving, given)
        refused = ~(finite | resting)
        before_m = self.look((~refused).nonzero()[0])
        rewards = np.empty(len(actions))
        reward_steps(
            self._weights, before_m, self.left_m, self._period_s, self.seen[:, : view.beams], view.range_limit_m,
            shielded, rewards,
        )  # fmt: skip
        rewards[resting] = 0.0
        ended = self.judge(moving)
        for index in refused.nonzero()[0].tolist():
            self.trial(index).command(Velocity2D(*given[index].tolist()))
            self.running[index] = False
            ended.append(index)
        for index in ended:
            verdict = self.trial(index).verdict
            assert verdict is not None
            rewards[index] += reward_of_end(self._config.reward, verdict)
        return rewards, ended

    def _shielded(self, resting: Bools, wanted: Floats) -> tuple[Floats, Bools]:
        """Return the commands given (n, 2), and which of them are not those wanted."""
        if not self._safety.enabled:
            return wanted, np.zeros(len(wanted), np.bool_)
        given = wanted.copy()
        for index in np.flatnonzero(
            ~resting & np.isfinite(wanted).all(axis=1)
        ).tolist():
            command, moving = (
                Velocity2D(*of[index].tolist())
                for of in (wanted, self.readings.velocities)
            )
            safe = avoid_collision(command, moving, self.scan(index), self._safety)
            given[index] = safe.linear, safe.angular
        changed: Bools = ((given != wanted) & ~np.isnan(wanted)).any(axis=1)
        return given, changed

    def close(self) -> None:
        """End the physics clients."""
        self.batch.close()


def info_of_end(trial: RunningTrial) -> dict[str, Any]:
    """Return what `info` has of the end of an episode, nothing before."""
    if (verdict := trial.verdict) is None or (scores := trial.scores) is None:
        return {}
    return {
        "outcome": verdict.outcome.value,
        "detail": verdict.detail,
        "is_success": scores.success,
        "scores": dict(vars(scores)),
    }


def way_points(world: World, course: Course, along: str) -> Floats:
    """Return places (n, 3) on the way to the goal, straight or along the path: x, y and how far it is from there, m."""
    goal = np.array([[course.goal.x, course.goal.y]])
    points = goal if along == "straight" else np.vstack([world.path_m(), goal])
    lengths = np.hypot(*np.diff(points, axis=0).T)
    return np.column_stack([points, np.append(np.cumsum(lengths[::-1])[::-1], 0.0)])


@njit(cache=True)
def way_left(
    points: Floats, counts: Integers, positions: Floats, which: Integers, left_m: Floats
) -> None:
    """Fill in the way left (n,) of the rows `which` at positions (n, 2), by `counts` (n,) of points of `way_points`."""
    for row in which:
        x, y, nearest = positions[row, 0], positions[row, 1], np.inf
        for k in range(counts[row]):
            dx, dy = points[row, k, 0] - x, points[row, k, 1] - y
            nearest = min(nearest, dx * dx + dy * dy)
        shortest = np.inf  # squares tell which points come into question
        for k in range(counts[row]):
            dx, dy = points[row, k, 0] - x, points[row, k, 1] - y
            if dx * dx + dy * dy <= nearest * _ROUNDED:
                away = math.hypot(dx, dy)
                if away < shortest:
                    shortest, left_m[row] = away, away + points[row, k, 2]


class RewardWeights(NamedTuple):
    """What compiled code needs of `RewardConfig`; who renames it deletes numba's files in `__pycache__`."""

    progress_per_m: float
    per_second: float
    near_per_second: float
    near_m: float
    shielded_per_second: float

    @classmethod
    def of(cls, config: RewardConfig) -> "RewardWeights":
        """Return the weights of a configuration."""
        return cls(*(getattr(config, name) for name in cls._fields))


@njit(cache=True)
def reward_steps(
    weights: RewardWeights,
    before_m: Floats,
    left_m: Floats,
    period_s: float,
    shares: npt.NDArray[np.float32],
    range_m: float,
    shielded: Bools,
    rewards: Floats,
) -> None:
    """Fill in the rewards (n,) of steps; shares (n, beams): nearest returns in parts of a range; shielded (n,)."""
    for i in range(len(rewards)):
        nearest = shares[i, 0]
        for beam in range(1, shares.shape[1]):
            nearest = min(nearest, shares[i, beam])
        nearness = max(0.0, 1.0 - np.float64(nearest) * range_m / weights.near_m)
        rate = (
            weights.per_second
            + weights.near_per_second * nearness
            + weights.shielded_per_second * shielded[i]
        )
        rewards[i] = (
            weights.progress_per_m * (before_m[i] - left_m[i]) + rate * period_s
        )


def reward_of_end(config: RewardConfig, verdict: Verdict) -> float:
    """Return what the end of an episode is worth."""
    if verdict.outcome is Outcome.SUCCESS:
        return config.success
    ended_by_itself = verdict.outcome in (Outcome.COLLISION, Outcome.INVALID_COMMAND)
    return config.collision if ended_by_itself else config.out_of_time
