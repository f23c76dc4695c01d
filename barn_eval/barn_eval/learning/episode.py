"""One episode: a trial as the benchmark runs it, a command at a time, and the reward of each step.

Progress in the reward is a difference of potentials, which does not change what the best policy is (Ng, Harada and
Russell, "Policy invariance under reward transformations", ICML 1999; exactly so for discount factors near 1).
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_eval.learning.config import RewardConfig
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.protocol import Course
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import RunningTrial
from barn_planners.interface import Observation
from barn_sim.body.bullet import PhysicsClient
from barn_sim.body.cylinders import Bools
from barn_sim.motion.batch import Batch
from barn_sim.sensors.readings import Sensors
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.types import Pose2D, Scan, Velocity2D
from barn_worlds.worlds.world import World

# What ends a trial by what was done; anything else ends it by the time or a fault.
TERMINAL = (Outcome.SUCCESS, Outcome.COLLISION, Outcome.INVALID_COMMAND)

_ROUNDED = 1.0 + 1e-12  # more than squares of distances are rounded by


class Episode:
    """Simulator and referee of one trial, in step as in a direct trial.

    sensors: the readings of this instant; a simulator in a batch is advanced, read and judged there, and has none.
    """

    sensors: Sensors

    def __init__(self, spec: TrialSpec, simulator: Simulator, batch: Batch | None = None, index: int = 0) -> None:
        """Begin. batch, index: where the simulator advances, which is made for that place."""
        self.spec = spec
        self.trial = RunningTrial(spec, logged=False)
        self._simulator = simulator
        if batch is None:
            self._take(simulator.sense())
        else:
            batch.put(index, simulator)

    @classmethod
    def of(cls, spec: TrialSpec, client: PhysicsClient, batch: Batch | None = None, index: int = 0) -> "Episode":
        """Begin with a new simulator; whatever used the physics client before is over."""
        fleet = None if batch is None else batch.fleet
        start, seed = spec.course.start, spec.simulator_seed
        simulator = Simulator(spec.world, spec.simulator, start, seed, client, fleet=fleet, index=index)
        return cls(spec, simulator, batch, index)

    def repeated(
        self, campaign_seed: int, repetition: int, client: PhysicsClient, batch: Batch | None = None, index: int = 0
    ) -> "Episode":
        """Begin the same trial with other noise."""
        spec, fleet = (
            replace(self.spec, campaign_seed=campaign_seed, repetition=repetition),
            None if batch is None else batch.fleet,
        )
        simulator = Simulator(
            spec.world, spec.simulator, spec.course.start, spec.simulator_seed, client, fleet=fleet, index=index
        )
        return Episode(spec, simulator, batch, index)

    @property
    def verdict(self) -> Verdict | None:
        """The verdict, None while the episode runs."""
        return self.trial.verdict

    def step(self, command: Velocity2D) -> Verdict | None:
        """Give a command, let it be carried out for a control period, read the sensors and judge."""
        return self.trial.command(command) or self._take(self._simulator.step(command))

    def localised(self, odometry: Pose2D) -> Pose2D:
        """Return the pose in the planning frame, given that in the odom frame just read."""
        return self._simulator.read_localisation(odometry) if self.spec.protocol.map_given else odometry

    def scan(self, ranges: npt.NDArray[np.float32]) -> Scan:
        """Return the scan of measured ranges (n,)."""
        return self._simulator.lidar.scan_of(self._simulator.stamp_ns, ranges)

    def observation(self) -> Observation:
        """Return what a planner is told of this instant."""
        sensors = self.sensors
        pose = sensors.localisation if self.spec.protocol.map_given else sensors.odometry.pose
        return Observation(sensors.stamp_ns, sensors.odometry, sensors.scan, pose)

    def _take(self, sensors: Sensors) -> Verdict | None:
        self.sensors = sensors
        return self.trial.read(sensors.odometry, sensors.truth, sensors.collision)


class WayLeft:
    """How far it is to the goal: straight, or to the nearest cell of the world's path and on along it.

    points (n, 3): x, y and way left from there, m.
    """

    def __init__(self, world: World, course: Course, along: str) -> None:
        goal = np.array([[course.goal.x, course.goal.y]])
        points = goal if along == "straight" else np.vstack([world.path_m(), goal])
        lengths = np.hypot(*np.diff(points, axis=0).T)
        self.points = np.column_stack([points, np.append(np.cumsum(lengths[::-1])[::-1], 0.0)])

    def metres(self, pose: Pose2D) -> float:
        """Return the way left from a true pose in the map frame."""
        left_m = np.empty(1)
        way_left(
            self.points[None], np.array([len(self.points)]), np.array([[pose.x, pose.y]]), np.zeros(1, np.int64), left_m
        )
        return float(left_m[0])


@njit(cache=True)
def way_left(points: Floats, counts: Integers, positions: Floats, which: Integers, left_m: Floats) -> None:
    """Fill in the way left (n,) of the rows `which`, from positions (n, 2).

    Each goes along the first of its own points (n, m, 3), as `WayLeft` has them, of which there are `counts` (n,).
    """
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
    """What of the reward's configuration compiled code needs, as `RewardConfig` has it.

    Numba keeps this class's name with the machine code on disk: who renames it deletes that in `__pycache__`.
    """

    progress_per_m: float
    per_second: float
    near_per_second: float
    near_m: float
    shielded_per_second: float

    @classmethod
    def of(cls, config: RewardConfig) -> "RewardWeights":
        """Return the weights of a configuration."""
        return cls(*(getattr(config, name) for name in cls._fields))


def step_reward(config: RewardConfig, progress_m: float, period_s: float, nearest_m: float, shielded: bool) -> float:
    """Return the reward of a step of `period_s`, without that of the end.

    progress_m: change of the way left; nearest_m: nearest return of the lidar at its end; shielded: whether the shield
    has changed the command.
    """
    return float(_reward(RewardWeights.of(config), progress_m, period_s, nearest_m, shielded))


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
    """Fill in the rewards (n,) of steps as `step_reward` does.

    before_m, left_m (n,): way left before and after; shares (n, beams): nearest returns in parts of a range.
    """
    for i in range(len(rewards)):
        nearest = shares[i, 0]
        for beam in range(1, shares.shape[1]):
            nearest = min(nearest, shares[i, beam])
        nearest_m = np.float64(nearest) * range_m
        rewards[i] = _reward(weights, before_m[i] - left_m[i], period_s, nearest_m, shielded[i])


@njit(cache=True)
def _reward(weights: RewardWeights, progress_m: float, period_s: float, nearest_m: float, shielded: bool) -> float:
    nearness = max(0.0, 1.0 - nearest_m / weights.near_m)
    rate = weights.per_second + weights.near_per_second * nearness + weights.shielded_per_second * shielded
    return weights.progress_per_m * progress_m + rate * period_s


def reward_of_end(config: RewardConfig, verdict: Verdict) -> float:
    """Return what the end of an episode is worth."""
    if verdict.outcome is Outcome.SUCCESS:
        return config.success
    ended_by_itself = verdict.outcome in (Outcome.COLLISION, Outcome.INVALID_COMMAND)
    return config.collision if ended_by_itself else config.out_of_time
