"""The Gymnasium environment `barn/Jackal-v0`: trials of the benchmark for a learner.

A batch has many of them, whose robots advance together::

    gymnasium.make_vec(
        "barn/Jackal-v0", num_envs=64, vectorization_mode="vector_entry_point"
    )
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias, cast

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from barn_eval.learning.config import EnvConfig, configure
from barn_eval.learning.drawing import TopView
from barn_eval.learning.episodes import Episodes, Info, final_info
from barn_eval.learning.reward import FAILURES, path_points
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.result import Outcome
from barn_eval.trials.spec import TrialSpec, simulator_config
from barn_planners.policy.collision_check import CollisionCheckConfig
from barn_planners.policy.space import ACTIONS, Vector
from barn_planners.robots import fit_to_robot, lidar_mount_changes
from barn_sim.config import robot_of
from barn_worlds.base.arrays import Bools, Bytes, Floats, Integers
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.errors import ConfigError, suggest
from barn_worlds.datasets.dataset import Dataset, open_dataset, select_worlds
from barn_worlds.robots.files import load_robot

RENDER_MODES = ("rgb_array",)
_RESET_OPTIONS = ("world", "campaign_seed", "repetition")
_FIRST = np.arange(1)
# `info` of some environments, by their indices.
_Infos: TypeAlias = dict[int, Info]


class JackalEnv(gymnasium.Env[Vector, npt.NDArray[np.floating]]):  # type: ignore[misc, unused-ignore]
    """A robot that has to reach the goal of a world.

    Observations and actions are those of `barn_planners.policy.space`. An episode is a
    trial of the benchmark. It terminates with a success, a collision (if the
    protocol checks collisions), a robot beyond the world's edge, or a command that is
    not finite. It is truncated by the time limits.

    `info` holds the world's number, the time in s and the distance left to the goal in
    m. At the end of an episode it also holds the outcome and its detail, whether it is
    a success, and the scores.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 20}  # noqa: RUF012 (Gymnasium's)

    def __init__(
        self,
        config: EnvConfig | None = None,
        render_mode: str | None = None,
        fitted_dataset: Dataset | None = None,
        **changes: object,
    ):
        """Load worlds, robot and protocol; BarnError if they do not fit; begin nothing.

        Args:
            config: What the environment is; the default is `EnvConfig()`.
            render_mode: None, or "rgb_array" for pictures from above.
            fitted_dataset: The data set of `config`, fitted to its robot, if it is open
                already.
            **changes: Fields of `config` by dotted name, so that `gymnasium.make` takes
                them: `make(name, worlds="0:100", **{"reward.success": 20.0})`.

        Raises:
            BarnError: If a value is not allowed or the worlds do not fit the robot.
        """
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ConfigError(
                f"render_mode must be None or {RENDER_MODES[0]!r}, got {render_mode!r}"
            )
        self.render_mode = render_mode
        self.config = configure(config, changes)
        robot = load_robot(self.config.robot)
        self._dataset = fitted_dataset or open_dataset(self.config.dataset).for_robot(
            robot
        )
        # Numbers of the worlds that episodes are drawn from, evenly.
        self.worlds = tuple(
            sorted(select_worlds(self.config.worlds, self._dataset.world_numbers))
        )
        self.protocol = load_protocol(self.config.protocol)
        self.simulator_config = simulator_config(
            self.protocol, self.config.simulator, robot
        )
        self._dataset.require_fit(robot_of(self.simulator_config), self.worlds)
        self._safety = self._fit_safety(self.config.safety)

        low, high = self.config.observation.bounds()
        self.observation_space = spaces.Box(low, high, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)
        # Films run as fast as the robot drives.
        frames_per_second = round(1.0 / self.simulator_config.control_period_s)
        self.metadata = {**self.metadata, "render_fps": max(1, frames_per_second)}

        self._top_view: TopView | None = None
        self._episodes: Episodes | None = None
        # The row in `_episodes`. In a batch, the batch reads the sensors and steps.
        self._index = 0
        self._is_in_batch = False
        self._no_rest = np.zeros(1, np.bool_)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs; ConfigError once an episode has begun."""
        if self._episodes is not None:
            raise ConfigError(
                "an environment cannot be copied after its first reset; create another"
                " and reset both with the same seed"
            )
        return self.__dict__.copy()

    def make_episodes(self, count: int = 1) -> Episodes:
        """Return new `Episodes` for `count` robots, without taking them for its own."""
        return Episodes(count, self.config, self.simulator_config, self._safety)

    def join_batch(self, episodes: Episodes, index: int) -> None:
        """Use one row of shared episodes, which the batch reads and steps, from now on.

        Args:
            episodes: Episodes of the batch, which steps them.
            index: Row of this environment.
        """
        self._episodes = episodes
        self._index = index
        self._is_in_batch = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Vector, Info]:
        """Begin a trial; return observation and info, zeros and {} in a batch.

        Args:
            seed: Seed of everything that is drawn from now on; None keeps the
                generator.
            options: `world` chooses the world by number; otherwise it is drawn. With
                `campaign_seed` (and `repetition`, 0 by default) as well, the episode is
                the very trial that `barn run --seed` makes of these numbers.

        Returns:
            Observation and info. In a batch they are zeros and {}: the batch reads the
            sensors.

        Raises:
            ConfigError: If an option is unknown or not allowed.
        """
        super().reset(seed=seed)
        if self._episodes is None:
            self._episodes = self.make_episodes()
        episodes = self._episodes
        spec = self._draw_trial(_check_options(options))
        along = self.config.reward.progress_along
        episodes.begin(self._index, spec, path_points(spec.world, spec.course, along))
        if self.render_mode:
            self._top_view = TopView(spec, self._index)
        if self._is_in_batch:
            return np.zeros(self.config.observation.size, np.float32), {}

        episodes.observe(_FIRST)
        episodes.judge(_FIRST)
        self.extend_trail()
        return episodes.observations[0].copy(), self._info(episodes)

    def step(
        self, action: npt.NDArray[np.floating]
    ) -> tuple[Vector, float, bool, bool, Info]:
        """Drive by an action (2,) from -1 to 1 and judge; ResetNeeded if none runs.

        Args:
            action: Action (2,), as of `barn_planners.policy.space`.

        Returns:
            Observation, reward, whether the episode terminated, whether it was
            truncated, and info.

        Raises:
            ResetNeeded: Before `reset` and after the end of an episode.
            ConfigError: If the action has another shape.
        """
        episodes = self._episodes
        if episodes is None or not episodes.running[0]:
            raise gymnasium.error.ResetNeeded(
                "reset() must be called before the first step of an episode"
            )
        action = np.asarray(action)
        if action.shape != (ACTIONS,):
            raise ConfigError(
                f"action must be an array of shape {(ACTIONS,)}, got {action.shape}"
            )

        rewards, ended = episodes.step(self._no_rest, action[None])
        self.extend_trail()
        terminated = bool(ended) and self.is_terminal()
        return (
            episodes.observations[0].copy(),
            float(rewards[0]),
            terminated,
            bool(ended) and not terminated,
            self._info(episodes),
        )

    def is_terminal(self) -> bool:
        """Return whether success or one of `FAILURES` ended the trial, not a limit.

        False for ends that truncate, such as time limits, and while the trial runs.
        """
        assert self._episodes is not None
        verdict = self._episodes.trial(self._index).verdict
        # All outcomes but these truncate an episode.
        terminal = (Outcome.SUCCESS, *FAILURES)
        return verdict is not None and verdict.outcome in terminal

    def extend_trail(self) -> None:
        """Add the robot's position to the pictures from above, if there are any."""
        if self._episodes is not None and self._top_view is not None:
            self._top_view.extend_trail(self._episodes)

    def render(self) -> Bytes | None:
        """Return an RGB picture (height, width, 3), None without mode or episode."""
        if self._episodes is None or self._top_view is None:
            return None
        return self._top_view.draw(self._episodes)

    def close(self) -> None:
        """Close the physics client, unless a batch owns it; forget the episodes."""
        if self._episodes is not None and not self._is_in_batch:
            self._episodes.close()
        self._episodes = None
        self._top_view = None

    def _draw_trial(self, options: Mapping[str, int]) -> TrialSpec:
        """Return a trial; draw its world and seed at random if options lack them."""
        # Always in this order, so that equal seeds draw equal trials.
        world_number = options.get("world")
        if world_number is None:
            draw = self.np_random.random()
            world_number = self.worlds[int(draw * len(self.worlds))]
        run_seed = options.get("campaign_seed")
        if run_seed is None:
            run_seed = int(self.np_random.integers(2**62))
        return TrialSpec(
            dataset=self._dataset.name,
            world_number=world_number,
            world=self._dataset.load(world_number),
            planner="policy",
            preset="",
            overrides={},
            protocol=self.protocol,
            simulator=self.simulator_config,
            run_seed=run_seed,
            repetition=options.get("repetition", 0),
            # The referee refuses faster commands, as from any planner.
            declared_mps=self.config.action.cap_mps,
        )

    def _fit_safety(self, safety: CollisionCheckConfig) -> CollisionCheckConfig:
        """Return the check for robot and lidar; ConfigError if it has another mount.

        Raises:
            ConfigError: If the check names another mount.
        """
        mount_x_m = self.simulator_config.lidar.mount_x_m
        # The default stands for a mount that nobody has set.
        if safety.lidar_x_m not in (CollisionCheckConfig().lidar_x_m, mount_x_m):
            mount = f"{mount_x_m:g} m (simulator parameter lidar.mount_x_m)"
            raise ConfigError(
                f"safety.lidar_x_m is {safety.lidar_x_m:g}, "
                f"but the lidar is mounted at {mount}"
            )
        safety = replace(safety, lidar_x_m=mount_x_m)
        robot = robot_of(self.simulator_config)
        changes = fit_to_robot(safety, robot) | lidar_mount_changes(safety, robot.lidar)
        return replace_dotted(safety, changes, "safety")

    def _info(self, episodes: Episodes) -> Info:
        """Return `info` of robot 0, with outcome and scores once its trial is over."""
        columns = episodes.info_columns()
        info = {name: values[0].item() for name, values in columns.items()}
        if episodes.running[0]:
            return info
        return info | final_info(episodes.trial(0))


def _check_options(options: Mapping[str, Any] | None) -> dict[str, int]:
    """Return the options of a reset as integers; ConfigError if one is not allowed."""
    checked = {}
    for name, value in (options or {}).items():
        if name not in _RESET_OPTIONS:
            hint = suggest(name, _RESET_OPTIONS)
            raise ConfigError(f"reset: unknown option {name!r}{hint}")
        is_integer = isinstance(value, (int, np.integer))
        # Python counts True as an integer.
        if not is_integer or isinstance(value, bool) or value < 0:
            raise ConfigError(
                f"reset: option {name!r} must be a whole number from 0, got {value!r}"
            )
        checked[name] = int(value)
    return checked


class JackalVectorEnv(SyncVectorEnv):
    """Environments whose robots advance together.

    Results equal those of Gymnasium's SyncVectorEnv to the last bit.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: EnvConfig | None = None,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        disable_env_checker: bool | None = None,  # noqa: ARG002 (a batch has none)
        **changes: object,
    ):
        """Make `num_envs` environments that share one batch of simulators.

        Args:
            num_envs: Number of environments.
            config: What each of them is; the default is `EnvConfig()`.
            autoreset_mode: When an episode that has ended is followed by the next one.
            render_mode: None, or "rgb_array" for pictures from above.
            max_episode_steps: Steps after which an episode is truncated, None for no
                limit but those of the protocol.
            disable_env_checker: Taken as by single environments, without effect.
            **changes: Fields of `config` by dotted name.
        """
        config = configure(config, changes)
        # All environments share its worlds in memory.
        dataset = open_dataset(config.dataset).for_robot(load_robot(config.robot))
        if max_episode_steps is not None and (
            type(max_episode_steps) is not int or max_episode_steps < 1
        ):
            raise ConfigError(
                "max_episode_steps must be a whole number from 1, "
                f"got {max_episode_steps!r}"
            )
        make_env = partial(JackalEnv, config, render_mode, fitted_dataset=dataset)
        super().__init__([make_env] * num_envs, autoreset_mode=autoreset_mode)
        self._jackals = [cast(JackalEnv, env.unwrapped) for env in self.envs]
        self._episodes = self._jackals[0].make_episodes(num_envs)
        self._all = np.ones(num_envs, np.bool_)
        self._max_steps = max_episode_steps
        self._elapsed_steps = np.zeros(num_envs, np.int64)
        for index, env in enumerate(self._jackals):
            env.join_batch(self._episodes, index)

    def __getstate__(self) -> dict[str, Any]:
        """Raise ConfigError: the physics of a batch cannot be copied."""
        raise ConfigError(
            "a batch of environments cannot be copied; create another and reset both with the same seed"
        )

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[npt.NDArray[Any], Info]:
        """Begin episodes in all or `reset_mask` robots; return observations and infos.

        Args:
            seed: Seed of the first environment, whose successors get the next numbers;
                or a seed for each.
            options: Options of `JackalEnv.reset`. `reset_mask` (n,) resets only some.

        Returns:
            Observations (n, size) and infos.
        """
        mask = (options or {}).get("reset_mask", self._all)
        # Gymnasium returns these rows for environments that the mask leaves out.
        self._env_obs = list(self._observations.copy())
        super().reset(seed=seed, options=options)
        started = np.flatnonzero(mask)
        self._elapsed_steps[started] = 0
        self._episodes.observe(started)
        for index in started:
            self._jackals[index].extend_trail()
        infos = self._merge(self._step_infos(mask), self._judge_starts(started))
        return self._episodes.observations.copy(), infos

    def step(
        self, actions: npt.NDArray[np.floating]
    ) -> tuple[npt.NDArray[Any], Floats, Bools, Bools, Info]:
        """Drive robots by actions (n, 2); begin due episodes; ResetNeeded if one ended.

        Args:
            actions: Actions (n, 2), as of `barn_planners.policy.space`.

        Returns:
            Observations (n, size), rewards, whether episodes terminated, whether they
            were truncated, all (n,), and infos.

        Raises:
            ResetNeeded: Before the first `reset`.
            ConfigError: If the actions have another shape.
        """
        actions = np.asarray(actions)
        shape = (self.num_envs, ACTIONS)
        if actions.shape != shape:
            raise ConfigError(
                f"actions must be an array of shape {shape}, got {actions.shape}"
            )
        # In the mode NEXT_STEP, the step after the end of an episode only begins the
        # next.
        is_resting = ~self._all
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            is_resting = self._autoreset_envs
        if not (self._episodes.running | is_resting).all():
            raise gymnasium.error.ResetNeeded(
                "reset() must be called before the first step of an episode"
            )

        started = np.flatnonzero(is_resting)
        self._begin_episodes(started)
        rewards, ended = self._episodes.step(is_resting, actions)
        self._terminations[:] = False
        self._truncations[:] = False
        for index in ended:
            self._terminations[index] = self._jackals[index].is_terminal()
            self._truncations[index] = not self._terminations[index]
        # As Gymnasium's TimeLimit, which wraps single environments.
        self._elapsed_steps[~is_resting] += 1
        if self._max_steps is not None:
            is_late = ~is_resting & (self._elapsed_steps >= self._max_steps)
            self._truncations |= is_late
            ended = sorted({*ended, *np.flatnonzero(is_late).tolist()})

        infos: Info = {}
        # Taken before any reset, which puts another trial in the place of the one that
        # has ended.
        end_infos = {index: final_info(self._episodes.trial(index)) for index in ended}
        if ended and self.autoreset_mode is AutoresetMode.SAME_STEP:
            infos = self._last_infos(end_infos)
            end_infos = {}
            started = np.array(sorted(ended))
            self._begin_episodes(started)
            self._episodes.observe(started)
        end_infos |= self._judge_starts(started)
        for env in self._jackals:
            env.extend_trail()
        infos = self._merge(infos | self._step_infos(self._all), end_infos)
        self._autoreset_envs = self._terminations | self._truncations
        # The arrays are filled anew in the next step, and learners keep what they get.
        return (
            self._episodes.observations.copy(),
            rewards,
            self._terminations.copy(),
            self._truncations.copy(),
            infos,
        )

    def _begin_episodes(self, indices: Integers) -> None:
        """Reset environments by their indices; sensors are read later, together."""
        self._elapsed_steps[indices] = 0
        for index in indices.tolist():
            self._jackals[index].reset()

    def _judge_starts(self, started: Integers) -> _Infos:
        """Judge first readings; return final infos, by index, of those that end."""
        return {
            index: final_info(self._episodes.trial(index))
            for index in self._episodes.judge(started)
        }

    def _step_infos(self, mask: Bools) -> Info:
        """Return `info` columns in Gymnasium's format, 0 outside the mask (n,)."""
        infos: Info = {}
        for name, values in self._episodes.info_columns().items():
            infos[name] = np.where(mask, values, 0)
            infos[f"_{name}"] = mask.copy()
        return infos

    def _last_infos(self, end_infos: _Infos) -> Info:
        """Return ended episodes' `final_obs` and `final_info` as Gymnasium has them."""
        columns = self._episodes.info_columns()
        last: _Infos = {}
        for index, info in end_infos.items():
            step_info = {name: values[index] for name, values in columns.items()}
            last[index] = {
                "final_obs": self._episodes.observations[index].copy(),
                "final_info": info | step_info,
            }
        return self._merge({}, last)

    def _merge(self, infos: Info, additions: _Infos) -> Info:
        """Add infos of single environments, by index, to those of the batch."""
        for index, info in additions.items():
            infos = self._add_info(infos, info, index)
        return infos

    def close_extras(self, **kwargs: object) -> None:
        """Close the environments and the physics clients that they share."""
        super().close_extras(**kwargs)
        # The environments of a batch leave the physics clients to it.
        self._episodes.close()
