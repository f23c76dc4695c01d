"""Episodes: trials as the benchmark runs them, one alone or many that advance together.

A step is a few compiled calls for all robots. Python runs only for robots near an
obstacle, trials that may have ended, the collision check, and poses in a map.
"""

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from barn_eval.learning.config import EnvConfig
from barn_eval.learning.reward import (
    final_reward,
    measure_distances_left,
    reward_steps,
    reward_weights,
)
from barn_eval.trials import rules
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import RunningTrial
from barn_planners.policy.collision_check import CollisionCheckConfig, avoid_collision
from barn_planners.policy.space import FrameStack, ObservationEncoder
from barn_sim.batch import Batch
from barn_sim.config import SimulatorConfig
from barn_sim.simulator import Simulator
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import NANOSECONDS_PER_SECOND, Pose2D, Scan, Velocity2D

# What Gymnasium returns beside an observation.
Info: TypeAlias = dict[str, Any]


class Episodes:
    """The episodes of some robots, each of which has a row in all arrays."""

    def __init__(
        self,
        count: int,
        config: EnvConfig,
        simulator: SimulatorConfig,
        safety: CollisionCheckConfig,
    ):
        """Make arrays and a batch of simulators for `count` robots; begin no trial.

        Args:
            count: Number of robots.
            config: Observations, actions and rewards.
            simulator: Configuration of all simulators.
            safety: Collision check for the robot.
        """
        self.batch = Batch(count, simulator)
        self.readings = self.batch.readings
        # Last observations (n, size), distances to the goal, world numbers; whether an
        # episode runs.
        self.observations = np.zeros((count, config.observation.size), np.float32)
        self.distances_left_m = np.zeros(count)
        self.worlds = np.zeros(count, np.int64)
        self.running = np.zeros(count, np.bool_)

        self._config = config
        self._safety = safety
        self._period_s = simulator.control_period_s
        self._reward_weights = reward_weights(config.reward)
        self._encoder = ObservationEncoder(config.observation)
        self._stack = FrameStack(count, config.observation)
        self._frames = np.zeros((count, config.observation.frame_size), np.float32)
        # Poses in the planning frame, x and y in m, yaw in rad.
        self._poses = np.zeros((count, 3))
        # Of the episode: the distance to the goal at its start, which the first
        # observation shows, and what the collision check has cost.
        self._is_new = np.zeros(count, np.bool_)
        self._start_m = np.zeros(count)
        self._shielded = np.zeros(count)
        self._trials: dict[int, RunningTrial] = {}
        self._simulators: dict[int, Simulator] = {}
        # Any scan: all robots have the same lidar.
        self._sample_scan: Scan | None = None
        self._goals = np.zeros((count, 2))
        self._paths = np.zeros((count, 0, 3))
        self._path_lengths = np.zeros(count, np.int64)
        self._states = np.zeros(count, rules.STATE)

    def info_columns(self) -> dict[str, npt.NDArray[Any]]:
        """Return world number, time (s) and distance left (m), each (n,), by name."""
        return {
            "world": self.worlds,
            "time_s": self.readings.stamps_ns / NANOSECONDS_PER_SECOND,
            "way_left_m": self.distances_left_m,
        }

    def trial(self, index: int) -> RunningTrial:
        """Return the current trial of robot `index`, or its last one after the end."""
        return self._trials[index]

    def scan(self, index: int) -> Scan:
        """Return the last scan of robot `index` that `observe` has read."""
        return self._simulators[index].lidar.scan_of(
            int(self.readings.stamps_ns[index]), self.readings.ranges[index]
        )

    def begin(self, index: int, spec: TrialSpec, path: Floats) -> None:
        """Put a robot at a trial's start, sensors unread; ConfigError if cells differ.

        Args:
            index: Robot that drives it.
            spec: World, rules and seeds of the trial.
            path: Points on the path to the goal, as of `path_points`.

        Raises:
            ConfigError: If the distances of its rules differ from those of other
                robots.
        """
        self._require_equal_rules(index, spec)
        start = spec.course.start
        seed = spec.simulator_seed
        simulator = self._simulators.get(index)
        if simulator is None:
            simulator = Simulator(
                spec.world,
                spec.simulator,
                start,
                seed,
                self.batch.scenes,
                fleet=self.batch.fleet,
                index=index,
            )
            self._simulators[index] = simulator
        else:
            simulator.begin(spec.world, start, seed)
        # What the batch remembers of this row, such as its last scan, is of another trial.
        self.batch.put(index, simulator)

        # Nobody reads the trajectory of an episode.
        trial = RunningTrial(spec, logged=False)
        # The kernel that judges all trials works on one array.
        trial.referee.move_to(self._states[index : index + 1])
        self._trials[index] = trial
        self.running[index] = True
        self.worlds[index] = spec.world_number
        self._goals[index] = spec.goal.position

        self._is_new[index] = True
        self._shielded[index] = 0.0
        self._stack.clear(index)

        # Paths share one array, as wide as the longest of them.
        missing = len(path) - self._paths.shape[1]
        if missing > 0:
            self._paths = np.pad(self._paths, ((0, 0), (0, missing), (0, 0)))
        self._paths[index, : len(path)] = path
        self._path_lengths[index] = len(path)

    def _require_equal_rules(self, index: int, spec: TrialSpec) -> None:
        """Raise ConfigError if worlds of this and another robot differ in cell size."""
        # The others agreed with each other when they began, so one of them is enough.
        for other_index, other in self._trials.items():
            if other_index == index:
                continue
            speed_mps = other.spec.scaled_protocol.reference_speed_mps
            if speed_mps == spec.scaled_protocol.reference_speed_mps:
                return
            names = f"{spec.world.name} and {other.spec.world.name}"
            raise ConfigError(
                f"worlds {names}: robots that advance together need worlds with cells "
                "of one size"
            )

    def observe(self, rows: Integers) -> None:
        """Read the sensors of `rows` and update what they observe.

        Args:
            rows: Robots to read.
        """
        self._read(rows)
        self._encode(rows)

    def _read(self, rows: Integers) -> None:
        """Read sensors and poses of `rows`; with a map, poses are localized."""
        if len(rows) == 0:
            return
        self.batch.read(rows)
        self._poses[rows] = self.readings.odometry[rows]
        if not self._trials[int(rows[0])].spec.protocol.map_given:
            return
        for index in rows.tolist():
            odometry_pose = Pose2D(*self._poses[index].tolist())
            pose = self._simulators[index].read_localization(odometry_pose)
            self._poses[index] = pose.numbers

    def _encode(self, rows: Integers) -> None:
        """Update observations and distances of `rows` by their last readings."""
        if len(rows) == 0:
            return
        readings = self.readings
        if self._sample_scan is None:
            first = int(rows[0])
            lidar = self._simulators[first].lidar
            self._sample_scan = lidar.scan_of(0, readings.ranges[first])
        self._encoder.encode_all(
            self._sample_scan,
            readings.ranges,
            self._poses,
            self._goals,
            readings.velocities,
            rows,
            self._frames,
        )
        self._stack.push(rows, self._frames, self.observations)
        measure_distances_left(
            self._paths,
            self._path_lengths,
            readings.truths,
            rows,
            self.distances_left_m,
        )
        new = rows[self._is_new[rows]]
        self._start_m[new] = self.distances_left_m[new]
        self._is_new[new] = False

    def judge(self, rows: Integers) -> list[int]:
        """Judge the last readings of rows; stop and return those that have ended.

        Args:
            rows: Robots that have moved or begun.

        Returns:
            Those whose episodes have ended.
        """
        readings = self.readings
        rules.observe(
            self._states,
            rows,
            readings.stamps_ns,
            readings.odometry,
            readings.truths,
            readings.collisions,
        )
        ended = rows[self._states["code"][rows] != rules.RUNNING]
        self.running[ended] = False
        return list(ended.tolist())

    def step(
        self, is_resting: Bools, actions: npt.NDArray[np.floating]
    ) -> tuple[Floats, list[int]]:
        """Drive all robots for one step and judge; return rewards and ended rows.

        A step is as many control periods as an action holds for, or fewer where an
        episode ends before.

        Args:
            is_resting: Robots (n,) that stand still because their episode begins now.
            actions: Actions (n, 2).

        Returns:
            Rewards (n,), and the robots whose episodes have ended.
        """
        commands = self._config.action.commands(actions)
        is_finite = np.isfinite(commands).all(axis=1)
        # A command that is not a number ends the episode before the robot moves.
        is_refused = ~(is_finite | is_resting)
        driving = (is_finite & ~is_resting).nonzero()[0]
        # Robots that rest are read as well: it is the first look of their episodes.
        observed = (~is_refused).nonzero()[0]

        before_m = self.distances_left_m.copy()
        driven_s = np.zeros(len(actions))
        changed_s = np.zeros(len(actions))
        ended: list[int] = []
        read = observed
        for _ in range(self._config.action.repeat):
            checked = self._check_commands(driving, commands)
            self.batch.advance(driving, checked)
            self._read(read)
            driven_s[driving] += self._period_s
            if checked is not commands:
                is_changed = (checked[driving] != commands[driving]).any(axis=1)
                changed_s[driving[is_changed]] += self._period_s
            ended += self.judge(driving)
            driving = driving[self.running[driving]]
            read = driving
        driven_s[is_refused] = self._period_s

        self._encode(observed)
        rewards = np.empty(len(actions))
        observation = self._config.observation
        reward_steps(
            self._reward_weights,
            self._start_m,
            before_m,
            self.distances_left_m,
            driven_s,
            changed_s,
            self.observations[:, : observation.beams],
            observation.range_limit_m,
            self._shielded,
            rewards,
        )
        rewards[is_resting] = 0.0

        for index in is_refused.nonzero()[0].tolist():
            command = Velocity2D(*commands[index].tolist())
            self._trials[index].command(command)
            self.running[index] = False
            ended.append(index)
        for index in ended:
            verdict = self._trials[index].verdict
            assert verdict is not None
            rewards[index] += final_reward(self._config.reward, verdict)
        return rewards, ended

    def _check_commands(self, driving: Integers, commands: Floats) -> Floats:
        """Return commands (m/s, rad/s), those of `driving` after the collision check."""
        if not self._safety.enabled:
            return commands

        checked: Floats = commands.copy()
        for index in driving.tolist():
            command = avoid_collision(
                Velocity2D(*commands[index].tolist()),
                Velocity2D(*self.readings.velocities[index].tolist()),
                self.scan(index),
                self._safety,
            )
            checked[index] = command.numbers
        return checked

    def close(self) -> None:
        """Close the physics clients of all robots."""
        self.batch.close()


def final_info(trial: RunningTrial) -> Info:
    """Return outcome, detail, success and scores of an ended trial, or else {}."""
    verdict = trial.verdict
    scores = trial.scores
    if verdict is None or scores is None:
        return {}
    return {
        "outcome": verdict.outcome.value,
        "detail": verdict.detail,
        "is_success": scores.success,
        "scores": dict(vars(scores)),
    }
