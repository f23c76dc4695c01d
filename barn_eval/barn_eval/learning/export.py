"""From a model of Stable-Baselines3 to a policy file, which needs neither it nor PyTorch to drive."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from barn_eval.learning.config import EnvConfig
from barn_planners.policy.file import Policy, write_policy
from barn_worlds.base.errors import ConfigError

_ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu"}


def export_policy(model: Any, config: EnvConfig, path: Path, about: Mapping[str, Any] | None = None) -> Policy:
    """Write what a model has learned as a policy file and return it; ConfigError for what it cannot hold.

    model: of PPO, A2C, SAC, TD3 or DDPG with an "MlpPolicy", trained in an environment of this `config`. about: for
    people.
    """
    normalising = model.get_vec_normalize_env()
    if normalising is not None and normalising.norm_obs:
        raise ConfigError("VecNormalize: observations are in [-1, 1] already; train with norm_obs=False")
    extractor = type(getattr(model.policy, "features_extractor", None) or model.policy.actor.features_extractor)
    if extractor.__name__ != "FlattenExtractor":
        raise ConfigError(f"features extractor must be FlattenExtractor, as MlpPolicy has it, got {extractor.__name__}")
    modules, squash = _modules(model.policy)
    if type(modules[-1]).__name__ == "Tanh":
        modules, squash = modules[:-1], True
    layers, activations = modules[::2], {type(module).__name__ for module in modules[1::2]}
    kinds = {type(layer).__name__ for layer in layers}
    if kinds != {"Linear"} or len(activations) > 1 or not activations <= set(_ACTIVATIONS):
        found = ", ".join(type(module).__name__ for module in modules)
        raise ConfigError(f"policy must be linear layers with one of {', '.join(_ACTIVATIONS)} between, got {found}")
    made = Policy(
        config.observation,
        config.action,
        tuple(np.ascontiguousarray(_numbers(layer.weight).T) for layer in layers),
        tuple(_numbers(layer.bias) for layer in layers),
        _ACTIVATIONS[activations.pop()] if activations else "tanh",
        "tanh" if squash else "clip",
        {"algorithm": type(model).__name__, "steps": int(model.num_timesteps), **(about or {})},
        "model",
    )
    write_policy(path, made)
    return made


def _modules(policy: Any) -> tuple[list[Any], bool]:
    """Return the modules from the observation to the mean of the action, and whether tanh follows."""
    if hasattr(policy, "mlp_extractor"):  # on-policy algorithms
        return [*policy.mlp_extractor.policy_net, policy.action_net], bool(policy.squash_output)
    actor: Any = getattr(policy, "actor", None)
    if hasattr(actor, "latent_pi"):  # SAC
        return [*actor.latent_pi, actor.mu], True
    if hasattr(actor, "mu"):  # TD3, DDPG
        return [*actor.mu], False
    raise ConfigError(f"{type(policy).__name__} has no actor that could be exported")


def _numbers(tensor: Any) -> np.ndarray[Any, np.dtype[np.float32]]:
    numbers: np.ndarray[Any, np.dtype[np.float32]] = tensor.detach().cpu().numpy().astype(np.float32)
    return numbers
