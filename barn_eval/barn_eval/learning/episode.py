"""One episode: a trial as the benchmark runs it, a command at a time, and the reward of each step.

Progress in the reward is a difference of potentials, which does not change what the best policy is (Ng, Harada and
Russell, "Policy invariance under reward transformations", ICML 1999; exactly so for discount factors near 1).
"""

import numpy as np

from barn_eval.learning.config import RewardConfig
from barn_eval.trials.outcome import Outcome, Verdict
from barn_eval.trials.protocol import Course
from barn_eval.trials.referee import Reading, Referee
from barn_eval.trials.scores import Scores, score
from barn_eval.trials.spec import TrialSpec
from barn_planners.interface import Observation
from barn_sim.batch import Batch
from barn_sim.bullet import PhysicsClient
from barn_sim.simulator import Simulator
from barn_worlds.types import Pose2D, Velocity2D
from barn_worlds.world import World

# What ends a trial by what was done; anything else ends it by the time or a fault.
TERMINAL = (Outcome.SUCCESS, Outcome.COLLISION, Outcome.INVALID_COMMAND)


class Episode:
    """Simulator and referee of one trial, in step as in a direct trial; `sensors` are the readings of this instant."""

    def __init__(self, spec: TrialSpec, client: PhysicsClient, batch: Batch | None = None, index: int = 0) -> None:
        """Begin; whatever used the physics client before is over. batch, index: where its simulator advances."""
        self.spec = spec
        self.goal = spec.goal  # in the planning frame
        fleet = None if batch is None else batch.fleet
        self._simulator = Simulator(
            spec.world, spec.simulator, spec.course.start, spec.simulator_seed, client, fleet=fleet, index=index
        )
        if batch is not None:
            batch.put(index, self._simulator)
        self._referee = Referee(spec.protocol, spec.course)
        self.sensors = self._simulator.sense()
        self._judge()

    @property
    def verdict(self) -> Verdict | None:
        """The verdict, None while the episode runs."""
        return self._referee.verdict

    def command(self, command: Velocity2D) -> bool:
        """Give a command; return whether the episode goes on for the control period in which it is carried out."""
        going_on = self._referee.command(command) is None
        if going_on:
            self._simulator.command(command)
        return going_on

    def advance(self) -> None:
        """Advance by a control period, unless the batch does."""
        self._simulator.advance(self.spec.simulator.ticks(self.spec.simulator.control_period_s))

    def look(self) -> None:
        """Read the sensors and judge, after a control period."""
        self.sensors = self._simulator.sense()
        self._judge()

    def observation(self) -> Observation:
        """Return what a planner is told of this instant."""
        sensors = self.sensors
        pose = sensors.localisation if self.spec.protocol.map_given else sensors.odometry.pose
        return Observation(sensors.stamp_ns, sensors.odometry, sensors.scan, pose)

    def scores(self) -> Scores | None:
        """Return the scores of an episode that has ended."""
        return score(self.verdict, self.spec.course, self.spec.protocol) if self.verdict is not None else None

    def _judge(self) -> None:
        sensors = self.sensors
        self._referee.observe(Reading(sensors.stamp_ns, sensors.odometry.pose, sensors.truth.pose, sensors.collision))


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
