"""Many environments at once, whose robots advance together.

envs = gymnasium.make_vec(
"barn/Jackal-v0", num_envs=64, vectorization_mode="vector_entry_point"
)
"""

from functools import partial
from typing import Any, TypeAlias, cast

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from barn_eval.learning.config import EnvConfig, configure
from barn_eval.learning.environment import JackalEnv
from barn_eval.learning.episodes import Info, final_info
from barn_planners.policy.space import ACTIONS
from barn_worlds.base.arrays import Bools, Floats, Integers
from barn_worlds.base.errors import ConfigError
from barn_worlds.datasets.dataset import open_dataset
from barn_worlds.robots.files import load_robot

# `info` of some environments, by their indices.
_Infos: TypeAlias = dict[int, Info]


class JackalVectorEnv(SyncVectorEnv):
    """Environments whose robots advance together.

    Everything is as with Gymnasium's SyncVectorEnv, to the last bit.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: EnvConfig | None = None,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
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
            **changes: Fields of `config` by dotted name.
        """
        config = configure(config, changes)
        # All environments share its worlds in memory.
        dataset = open_dataset(config.dataset).for_robot(load_robot(config.robot))
        if max_episode_steps is not None and max_episode_steps < 1:
            raise ConfigError(
                f"max_episode_steps must be at least 1, got {max_episode_steps}"
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
            "a batch of environments cannot be copied: make another, and reset both with"
            " the same seed"
        )

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[npt.NDArray[Any], Info]:
        """Begin new episodes in all environments, or in those of `reset_mask`.

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
        """Drive all robots one control period by actions (n, 2); begin due episodes.

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
