"""For Stable-Baselines3: a batch of environments, and what it has learned as a policy file."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env import DummyVecEnv

from barn_eval.learning.config import EnvConfig
from barn_eval.learning.vector import JackalVectorEnv
from barn_planners.policy.file import Policy, write_policy
from barn_worlds.base.errors import ConfigError
from policy_training.curriculum import Curriculum, CurriculumConfig

_ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu"}


class StableBatch(DummyVecEnv):  # type: ignore[misc, unused-ignore]
    """`count` environments of a configuration that advance together.

    curriculum: how each draws its worlds; an episode that ends counts for those after the next, which has begun.

    An episode begins anew in the step that ends it. The info of that step has `terminal_observation`,
    `TimeLimit.truncated`, and `outcome` and `is_success` of the episode; other steps have none.
    """

    def __init__(
        self, count: int, config: EnvConfig, curriculum: CurriculumConfig | None = None
    ) -> None:
        self._batch = JackalVectorEnv(count, config, autoreset_mode="SameStep")
        self.curricula = (
            [Curriculum(env, curriculum) for env in self._batch.envs]
            if curriculum
            else []
        )
        super().__init__(
            [partial(self._batch.envs.__getitem__, k) for k in range(count)]
        )

    def reset(self) -> npt.NDArray[np.float32]:
        """Begin episodes in all environments."""
        seen: npt.NDArray[np.float32] = self._batch.reset(seed=self._seeds)[0]
        self._reset_seeds()
        return seen

    def step_wait(
        self,
    ) -> tuple[
        npt.NDArray[np.float32],
        npt.NDArray[np.float32],
        npt.NDArray[np.bool_],
        list[dict[str, Any]],
    ]:
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
            if self.curricula:
                self.curricula[k].record(infos[k]["is_success"])
        return seen, rewards.astype(np.float32), terminated | truncated, infos

    def close(self) -> None:
        """Release the environments."""
        self._batch.close()


def export_policy(
    model: Any, config: EnvConfig, path: Path, about: Mapping[str, Any] | None = None
) -> Policy:
    """Write what a model has learned as a policy file and return it; ConfigError for what it cannot hold.

    model: of PPO, A2C, SAC, TD3 or DDPG with an "MlpPolicy", trained in an environment of this `config`. about: for
    people.
    """
    normalising = model.get_vec_normalize_env()
    if normalising is not None and normalising.norm_obs:
        raise ConfigError(
            "VecNormalize: observations are in [-1, 1] already; train with norm_obs=False"
        )
    extractor = type(
        getattr(model.policy, "features_extractor", None)
        or model.policy.actor.features_extractor
    )
    if extractor.__name__ != "FlattenExtractor":
        raise ConfigError(
            f"features extractor must be FlattenExtractor, as MlpPolicy has it, got {extractor.__name__}"
        )
    modules, squash = _modules(model.policy)
    if type(modules[-1]).__name__ == "Tanh":
        modules, squash = modules[:-1], True
    layers, activations = (
        modules[::2],
        {type(module).__name__ for module in modules[1::2]},
    )
    kinds = {type(layer).__name__ for layer in layers}
    if (
        kinds != {"Linear"}
        or len(activations) > 1
        or not activations <= set(_ACTIVATIONS)
    ):
        found = ", ".join(type(module).__name__ for module in modules)
        raise ConfigError(
            f"policy must be linear layers with one of {', '.join(_ACTIVATIONS)} between, got {found}"
        )
    made = Policy(
        config.observation,
        config.action,
        tuple(np.ascontiguousarray(_numbers(layer.weight).T) for layer in layers),
        tuple(_numbers(layer.bias) for layer in layers),
        _ACTIVATIONS[activations.pop()] if activations else "tanh",
        "tanh" if squash else "clip",
        {
            "algorithm": type(model).__name__,
            "steps": int(model.num_timesteps),
            **(about or {}),
        },
        "model",
    )
    write_policy(path, made)
    return made


def _modules(policy: Any) -> tuple[list[Any], bool]:
    """Return the modules from the observation to the mean of the action, and whether tanh follows."""
    if hasattr(policy, "mlp_extractor"):  # on-policy algorithms
        return [*policy.mlp_extractor.policy_net, policy.action_net], bool(
            policy.squash_output
        )
    actor: Any = getattr(policy, "actor", None)
    if hasattr(actor, "latent_pi"):  # SAC
        return [*actor.latent_pi, actor.mu], True
    if hasattr(actor, "mu"):  # TD3, DDPG
        return [*actor.mu], False
    raise ConfigError(f"{type(policy).__name__} has no actor that could be exported")


def _numbers(tensor: Any) -> np.ndarray[Any, np.dtype[np.float32]]:
    numbers: np.ndarray[Any, np.dtype[np.float32]] = (
        tensor.detach().cpu().numpy().astype(np.float32)
    )
    return numbers
