"""Many environments at once: `make_vec("barn/Jackal-v0", num_envs=64, vectorization_mode="vector_entry_point")`."""

from functools import partial
from typing import Any, cast

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from barn_eval.learning.config import EnvConfig
from barn_eval.learning.environment import JackalEnv
from barn_eval.learning.episodes import info_of_end
from barn_planners.policy.space import ACTIONS
from barn_worlds.base.arrays import Bools, Integers
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import NANOSECONDS_PER_SECOND
from barn_worlds.datasets.dataset import open_dataset

Ended = dict[int, dict[str, Any]]  # infos, by the number of the environment
Step = tuple[npt.NDArray[Any], npt.NDArray[np.float64], Bools, Bools, dict[str, Any]]


class JackalVectorEnv(SyncVectorEnv):
    """Environments whose robots advance together; all is as with Gymnasium's SyncVectorEnv, to the last bit."""

    def __init__(
        self,
        num_envs: int = 1,
        config: EnvConfig | None = None,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        **changes: object,
    ) -> None:
        self._config = replace_dotted(config or EnvConfig(), changes, "environment")
        make = partial(
            JackalEnv, self._config, opened=open_dataset(self._config.dataset)
        )
        super().__init__([make] * num_envs, autoreset_mode=autoreset_mode)
        self._jackals = [cast(JackalEnv, env.unwrapped) for env in self.envs]
        self._episodes = self._jackals[0].episodes(num_envs)
        self._everyone = np.ones(num_envs, np.bool_)
        for index, env in enumerate(self._jackals):
            env.join(self._episodes, index)

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Begin episodes, in all environments or in those of `options["reset_mask"]`."""
        asked = (options or {}).get("reset_mask", self._everyone)
        self._env_obs = list(self._observations.copy())
        super().reset(seed=seed, options=options)
        begun = np.flatnonzero(asked)
        self._episodes.look(begun)
        infos = self._tell(self._infos(asked), self._judge_first(begun))
        return self._episodes.seen.copy(), infos

    def step(self, actions: npt.NDArray[np.floating]) -> Step:
        """Drive all robots for one control period."""
        actions = np.asarray(actions)
        if actions.shape != (self.num_envs, ACTIONS):
            raise ConfigError(
                f"actions must be an array of shape {(self.num_envs, ACTIONS)}, got {actions.shape}"
            )
        next_step = self.autoreset_mode is AutoresetMode.NEXT_STEP
        resting = self._autoreset_envs if next_step else ~self._everyone
        if not (self._episodes.running | resting).all():
            raise gymnasium.error.ResetNeeded(
                "reset() must be called before the first step of an episode"
            )
        begun = np.flatnonzero(resting)
        self._begin(begun)
        self._rewards, over = self._episodes.step(resting, actions)
        self._terminations[:] = self._truncations[:] = False
        for index in over:
            self._terminations[index], self._truncations[index] = self._jackals[
                index
            ].conclude()
        ended = {index: info_of_end(self._episodes.trial(index)) for index in over}
        infos: dict[str, Any] = {}
        if ended and self.autoreset_mode is AutoresetMode.SAME_STEP:
            infos = self._tell_last(ended)
            begun, ended = np.array(sorted(ended)), {}
            self._begin(begun)
            self._episodes.look(begun)
        infos = self._tell(
            infos | self._infos(self._everyone), ended | self._judge_first(begun)
        )
        self._autoreset_envs = self._terminations | self._truncations
        seen, rewards = self._episodes.seen.copy(), self._rewards.copy()
        return seen, rewards, self._terminations.copy(), self._truncations.copy(), infos

    def _begin(self, which: Integers) -> None:
        """Begin new episodes, of which nothing is read yet."""
        for index in which.tolist():
            self._jackals[index].reset()

    def _judge_first(self, begun: Integers) -> Ended:
        """Judge the first readings of episodes; return the infos of those that end by it."""
        return {
            index: info_of_end(self._episodes.trial(index))
            for index in self._episodes.judge(begun)
        }

    def _infos(self, there: Bools) -> dict[str, Any]:
        """Return what `info` has of every step, for those who took it."""
        infos: dict[str, Any] = {}
        for name, values in self._columns().items():
            infos[name], infos[f"_{name}"] = np.where(there, values, 0), there.copy()
        return infos

    def _columns(self) -> dict[str, npt.NDArray[Any]]:
        times_s = self._episodes.readings.stamps_ns / NANOSECONDS_PER_SECOND
        return {
            "world": self._episodes.worlds,
            "time_s": times_s,
            "way_left_m": self._episodes.left_m,
        }

    def _tell(self, infos: dict[str, Any], more: Ended) -> dict[str, Any]:
        """Add the infos of some environments to those of all."""
        for index, info in more.items():
            infos = self._add_info(infos, info, index)
        return infos

    def _tell_last(self, ended: Ended) -> dict[str, Any]:
        """Return infos with the last observations and infos of episodes that have ended."""
        columns, last = self._columns(), {}
        for index, info in ended.items():
            final = info | {name: values[index] for name, values in columns.items()}
            last[index] = {
                "final_obs": self._episodes.seen[index].copy(),
                "final_info": final,
            }
        return self._tell({}, last)

    def close_extras(self, **kwargs: object) -> None:
        """Close the environments."""
        super().close_extras(**kwargs)
        self._episodes.close()
