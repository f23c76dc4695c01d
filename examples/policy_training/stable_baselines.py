"""Stable-Baselines3: a batch of environments, and models as policy files."""

import warnings
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env import DummyVecEnv

from barn_eval.learning.config import EnvConfig
from barn_eval.learning.environment import JackalVectorEnv
from barn_planners.policy.file import Policy, write_policy
from barn_worlds.base.errors import ConfigError
from policy_training.curriculum import Curriculum, CurriculumConfig

# Activations of policy files by the names of torch's modules.
_ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu"}


class StableBatch(DummyVecEnv):  # type: ignore[misc, unused-ignore]
    """Environments of one configuration that advance together.

    The step that ends an episode also begins the next one. Its info holds
    `terminal_observation`, `TimeLimit.truncated`, `outcome` and `is_success` of the
    episode that ended. The infos of other steps are empty.
    """

    def __init__(
        self, count: int, config: EnvConfig, curriculum: CurriculumConfig | None = None
    ) -> None:
        """Make the environments.

        Args:
            count: Number of environments.
            config: What each of them is.
            curriculum: How each draws its worlds. An episode counts for the next but
                one, since the next one has already begun when it ends.
        """
        self._batch = JackalVectorEnv(count, config, autoreset_mode="SameStep")
        envs = self._batch.envs
        self.curricula: list[Curriculum] = []
        if curriculum is not None:
            self.curricula = [Curriculum(env, curriculum) for env in envs]
        super().__init__([partial(envs.__getitem__, index) for index in range(count)])

    def reset(self) -> npt.NDArray[np.float32]:
        """Begin episodes in all environments and return their observations."""
        observations: npt.NDArray[np.float32]
        observations, _ = self._batch.reset(seed=self._seeds)
        self._reset_seeds()
        return observations

    def step_wait(
        self,
    ) -> tuple[
        npt.NDArray[np.float32],
        npt.NDArray[np.float32],
        npt.NDArray[np.bool_],
        list[dict[str, Any]],
    ]:
        """Take the step; return observations, rewards, ends and infos."""
        observations, rewards, terminated, truncated, batch_info = self._batch.step(
            self.actions
        )
        is_done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for index in np.flatnonzero(is_done).tolist():
            final_info = batch_info["final_info"]
            is_success = bool(final_info["is_success"][index])
            infos[index] = {
                "terminal_observation": batch_info["final_obs"][index],
                "TimeLimit.truncated": bool(truncated[index]),
                "outcome": final_info["outcome"][index],
                "is_success": is_success,
            }
            if self.curricula:
                self.curricula[index].record(is_success)
        return observations, rewards.astype(np.float32), is_done, infos

    def close(self) -> None:
        """Close the environments."""
        self._batch.close()


class _Actor(NamedTuple):
    """The part of a model that acts."""

    modules: list[Any]  # from the observation to the mean of the action
    squashes: bool  # whether tanh follows


def export_policy(
    model: Any, config: EnvConfig, path: Path, about: Mapping[str, Any] | None = None
) -> Policy:
    """Write the actor of a model as a policy file.

    Args:
        model: PPO, A2C, SAC, TD3 or DDPG with an "MlpPolicy".
        config: Configuration of the environment that it was trained in.
        path: Policy file to write.
        about: Notes for people.

    Returns:
        The policy in the file.

    Raises:
        ConfigError: If a policy file cannot hold the actor.
    """
    _check_extractor(model)
    actor = _find_actor(model.policy)
    modules = actor.modules
    squashes = actor.squashes
    if _kind(modules[-1]) == "Tanh":
        modules = modules[:-1]
        squashes = True

    layers = modules[::2]
    activations = {_kind(module) for module in modules[1::2]}
    is_linear = {_kind(layer) for layer in layers} == {"Linear"}
    if not is_linear or len(activations) > 1 or not activations <= _ACTIVATIONS.keys():
        allowed = ", ".join(_ACTIVATIONS)
        kinds = ", ".join(_kind(module) for module in modules)
        raise ConfigError(
            f"policy must be linear layers with one of {allowed} between, got {kinds}"
        )

    # A single layer has no activation; the file names one all the same.
    activation = _ACTIVATIONS[activations.pop()] if activations else "tanh"
    notes = {"algorithm": _kind(model), "steps": int(model.num_timesteps)}
    weights = [np.ascontiguousarray(_to_array(layer.weight).T) for layer in layers]
    biases = [_to_array(layer.bias) for layer in layers]
    normalization = model.get_vec_normalize_env()
    if normalization is not None and normalization.norm_obs:
        weights[0], biases[0] = _fold(normalization, weights[0], biases[0])
    policy = Policy(
        config.observation,
        config.action,
        tuple(weights),
        tuple(biases),
        activation,
        "tanh" if squashes else "clip",
        {**notes, **(about or {})},
        "model",
    )
    write_policy(path, policy)
    return policy


def _fold(
    normalization: Any,
    weights: npt.NDArray[np.float32],
    biases: npt.NDArray[np.float32],
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return the first layer for observations that VecNormalize has not changed.

    It also clips them, which no layer can: the file differs from the model where an entry
    is further from its mean than `clip_obs` standard deviations.
    """
    statistics = normalization.obs_rms
    scale = 1.0 / np.sqrt(statistics.var + normalization.epsilon)
    low = normalization.observation_space.low
    high = normalization.observation_space.high
    farthest = np.maximum(statistics.mean - low, high - statistics.mean) * scale
    clipped = int((farthest > normalization.clip_obs).sum())
    if clipped:
        warnings.warn(
            f"VecNormalize: {clipped} entries of an observation may be clipped at"
            f" {normalization.clip_obs:g} standard deviations, which the file does not"
            " do; train with a higher clip_obs",
            stacklevel=3,
        )
    folded = scale[:, None] * weights
    shifted = biases - statistics.mean @ folded
    return folded.astype(np.float32), shifted.astype(np.float32)


def _check_extractor(model: Any) -> None:
    """Check that the actor gets observations as the environment makes them."""
    extractor = getattr(model.policy, "features_extractor", None)
    kind = _kind(extractor or model.policy.actor.features_extractor)
    if kind != "FlattenExtractor":
        raise ConfigError(
            "features extractor must be FlattenExtractor, as MlpPolicy has it, "
            f"got {kind}"
        )


def _find_actor(policy: Any) -> _Actor:
    # On-policy algorithms: PPO, A2C.
    if hasattr(policy, "mlp_extractor"):
        modules = [*policy.mlp_extractor.policy_net, policy.action_net]
        return _Actor(modules, bool(policy.squash_output))
    actor: Any = getattr(policy, "actor", None)
    # SAC.
    if hasattr(actor, "latent_pi"):
        return _Actor([*actor.latent_pi, actor.mu], squashes=True)
    # TD3, DDPG.
    if hasattr(actor, "mu"):
        return _Actor([*actor.mu], squashes=False)
    raise ConfigError(f"{_kind(policy)} has no actor that could be exported")


def _kind(module: Any) -> str:
    return type(module).__name__


def _to_array(tensor: Any) -> npt.NDArray[np.float32]:
    array: npt.NDArray[np.float32] = tensor.detach().cpu().numpy().astype(np.float32)
    return array
