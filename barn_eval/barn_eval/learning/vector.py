"""Many environments at once: `make_vec("barn/Jackal-v0", num_envs=64, vectorization_mode="vector_entry_point")`."""

from functools import partial
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from barn_eval.learning.config import EnvConfig
from barn_eval.learning.environment import JackalEnv
from barn_sim.batch import Batch
from barn_worlds.errors import ConfigError


class JackalVectorEnv(SyncVectorEnv):
    """Environments whose robots advance together in compiled code.

    All else, above all when an environment starts anew, is as in Gymnasium's SyncVectorEnv, and so is every
    observation, reward and info, to the last bit. threads: among which the robots are divided. config, changes: as of
    `JackalEnv`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: EnvConfig | None = None,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int = 1,
        **changes: Any,
    ) -> None:
        if threads < 1:
            raise ConfigError(f"threads must be at least 1, got {threads}")
        super().__init__([partial(JackalEnv, config, **changes)] * num_envs, autoreset_mode=autoreset_mode)
        self._jackals = [_jackal(env) for env in self.envs]
        self._batch = Batch(num_envs, self._jackals[0].simulator_config, threads)
        for index, env in enumerate(self._jackals):
            env.join(self._batch, index)

    def step(
        self, actions: npt.NDArray[np.floating]
    ) -> tuple[npt.NDArray[Any], npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """Drive all robots for one control period."""
        resting = self._autoreset_envs if self.autoreset_mode is AutoresetMode.NEXT_STEP else np.zeros(self.num_envs)
        actions = np.asarray(actions)
        moving = [k for k, env in enumerate(self._jackals) if not resting[k] and env.begin(actions[k])]
        self._batch.advance(moving)
        return super().step(actions)

    def close_extras(self, **kwargs: Any) -> None:
        """Close the environments and end the threads."""
        super().close_extras(**kwargs)
        self._batch.close()


def _jackal(env: gymnasium.Env[Any, Any]) -> JackalEnv:
    unwrapped = env.unwrapped
    assert isinstance(unwrapped, JackalEnv)
    return unwrapped
