"""A batch of environments for Stable-Baselines3, which has an interface of its own for them."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from barn_eval.learning.config import EnvConfig
from barn_eval.learning.vector import JackalVectorEnv


class StableBatch(VecEnv):  # type: ignore[misc, unused-ignore]
    """`count` environments of a configuration that advance together; arguments as of `JackalVectorEnv`.

    An episode begins anew in the step that ends it. The info of that step has `terminal_observation`,
    `TimeLimit.truncated`, and `outcome` and `is_success` of the episode; other steps have none.
    """

    def __init__(self, count: int, config: EnvConfig) -> None:
        self._batch = JackalVectorEnv(count, config, autoreset_mode="SameStep")
        super().__init__(count, self._batch.single_observation_space, self._batch.single_action_space)
        self._seed: int | None = None
        self._actions = np.zeros((count, 2), np.float32)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset; environment k gets `seed` + k."""
        self._seed = seed
        return [None if seed is None else seed + k for k in range(self.num_envs)]

    def reset(self) -> npt.NDArray[np.float32]:
        """Begin episodes in all environments."""
        seen: npt.NDArray[np.float32] = self._batch.reset(seed=self._seed)[0]
        self._seed = None
        return seen

    def step_async(self, actions: npt.NDArray[np.float32]) -> None:
        """Take the actions of a step."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Take the step."""
        seen, rewards, terminated, truncated, told = self._batch.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for k in np.flatnonzero(terminated | truncated).tolist():
            final = told["final_info"]
            infos[k] = {
                "terminal_observation": told["final_obs"][k],
                "TimeLimit.truncated": bool(truncated[k]),
                "outcome": final["outcome"][k],
                "is_success": bool(final["is_success"][k]),
            }
        return seen, rewards.astype(np.float32), terminated | truncated, infos

    def close(self) -> None:
        """Release the environments."""
        self._batch.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of some environments."""
        return [getattr(env, attr_name) for env in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: object, indices: VecEnvIndices = None) -> None:
        """Set an attribute of some environments."""
        for env in self._chosen(indices):
            setattr(env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: object, indices: VecEnvIndices = None, **method_kwargs: object
    ) -> list[Any]:
        """Call a method of some environments."""
        return [getattr(env, method_name)(*method_args, **method_kwargs) for env in self._chosen(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Tell whether some environments are wrapped, which they never are."""
        return [isinstance(env, wrapper_class) for env in self._chosen(indices)]

    def _chosen(self, indices: VecEnvIndices) -> list[Any]:
        return [self._batch.envs[k] for k in self._get_indices(indices)]
