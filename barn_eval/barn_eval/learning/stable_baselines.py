"""A batch of environments for Stable-Baselines3, which has an interface of its own for them."""

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env import DummyVecEnv

from barn_eval.learning.config import EnvConfig
from barn_eval.learning.vector import JackalVectorEnv


class StableBatch(DummyVecEnv):  # type: ignore[misc, unused-ignore]
    """`count` environments of a configuration that advance together; arguments as of `JackalVectorEnv`.

    An episode begins anew in the step that ends it. The info of that step has `terminal_observation`,
    `TimeLimit.truncated`, and `outcome` and `is_success` of the episode; other steps have none.
    """

    def __init__(self, count: int, config: EnvConfig) -> None:
        self._batch = JackalVectorEnv(count, config, autoreset_mode="SameStep")
        super().__init__([partial(self._batch.envs.__getitem__, k) for k in range(count)])

    def reset(self) -> npt.NDArray[np.float32]:
        """Begin episodes in all environments."""
        seen: npt.NDArray[np.float32] = self._batch.reset(seed=self._seeds)[0]
        self._reset_seeds()
        return seen

    def step_wait(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Take the step."""
        seen, rewards, terminated, truncated, told = self._batch.step(self.actions)
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
