"""Files of learned policies: layers of numbers and a JSON header, nothing executable.

A policy file is a .npz: `policy.json` and, per layer k, float32 in `weights_k.npy` (inputs, outputs) and `biases_k.npy`
(outputs,). The header::

    {"schema": 1, "layers": [45, 64, 64, 2], "activation": "tanh", "output": "clip",
     "observation": {...}, "action": {...}, "about": {...}}

The activation follows every layer but the last. Output "tanh" is applied to the last one; "clip" only limits the
action. observation, action: the configurations in `barn_planners.policy.space`. about: notes for people.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_planners.interface import FloatArray
from barn_planners.policy.space import ACTIONS, PolicyAction, PolicyObservation
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import BarnError, ConfigError, WorldError, suggest
from barn_worlds.formats.npz import Arrays, NpzFormat

ACTIVATIONS = ("tanh", "relu")
OUTPUTS = ("clip", "tanh")
_ARRAYS = (("weights", 2), ("biases", 1))  # their dimensions
MOST_LAYERS = 16
FORMAT = NpzFormat(
    "a policy file",
    "policy.json",
    schema=1,
    largest_file=64 * 1024 * 1024,
    largest=64 * 1024 * 1024,
)


class PolicyError(BarnError):
    """A policy file that cannot be read or is malformed."""


@dataclass(frozen=True, eq=False)
class Policy:
    """A multilayer perceptron: weights (inputs, outputs) and biases per layer; PolicyError at `where` if unsound."""

    observation: PolicyObservation
    action: PolicyAction
    weights: tuple[npt.NDArray[np.float32], ...]
    biases: tuple[npt.NDArray[np.float32], ...]
    activation: str = "tanh"
    output: str = "clip"
    about: Mapping[str, object] = field(default_factory=dict)
    where: str = "policy"

    def __post_init__(self) -> None:
        for name, value, known in (
            ("activation", self.activation, ACTIVATIONS),
            ("output", self.output, OUTPUTS),
        ):
            if value not in known:
                raise PolicyError(
                    f"{self.where}: unknown {name} {value!r:.40}{suggest(value, known)}"
                )
        if not 1 <= len(self.weights) <= MOST_LAYERS or len(self.weights) != len(
            self.biases
        ):
            raise PolicyError(
                f"{self.where}: must have 1 to {MOST_LAYERS} layers, got {len(self.weights)}"
            )
        layers = self.layers
        if layers[0] != self.observation.size or layers[-1] != ACTIONS:
            ends = f"{self.observation.size} observed values to {ACTIONS} actions"
            raise PolicyError(
                f"{self.where}: must lead from {ends}, got layers of {layers}"
            )
        for k, (weights, biases) in enumerate(
            zip(self.weights, self.biases, strict=True)
        ):
            if weights.shape != (layers[k], layers[k + 1]) or biases.shape != (
                layers[k + 1],
            ):
                needed = f"weights {(layers[k], layers[k + 1])} and as many biases"
                got = f"{weights.shape} and {biases.shape}"
                raise PolicyError(
                    f"{self.where}: layer {k} must have {needed}, got {got}"
                )
            if not (np.isfinite(weights).all() and np.isfinite(biases).all()):
                raise PolicyError(
                    f"{self.where}: layer {k} holds values that are not finite"
                )

    @property
    def layers(self) -> list[int]:
        """Number of inputs, then of outputs of each layer."""
        return [len(self.weights[0]), *(len(biases) for biases in self.biases)]


@dataclass(frozen=True)
class _PolicyHeader:
    """What the header of a file must hold."""

    schema: int
    layers: list[int]
    activation: str
    output: str
    observation: PolicyObservation
    action: PolicyAction
    about: dict[str, Any]


class PolicyNetwork:
    """Evaluates a policy, summing in a fixed order: the same bits with any number of threads."""

    def __init__(self, policy: Policy) -> None:
        self._layers = [
            (np.ascontiguousarray(weights, np.float64), biases.astype(np.float64))
            for weights, biases in zip(policy.weights, policy.biases, strict=True)
        ]
        self._relu = policy.activation == "relu"
        self._squash = policy.output == "tanh"

    def act(self, seen: npt.NDArray[np.float32]) -> FloatArray:
        """Return the action (2,) for an observation, before limits."""
        values: FloatArray = seen.astype(np.float64)
        last = len(self._layers) - 1
        for k, (weights, biases) in enumerate(self._layers):
            values = affine(values, weights, biases)
            if k < last:
                values = np.maximum(values, 0.0) if self._relu else np.tanh(values)
        return np.tanh(values) if self._squash else values


@njit(cache=True)
def affine(values, weights, biases):  # type: ignore[no-untyped-def]
    """Return values (n,) @ weights (n, m) + biases (m,)."""
    out = biases.copy()
    for i in range(len(values)):
        for j in range(len(out)):
            out[j] += values[i] * weights[i, j]
    return out


def write_policy(path: Path, policy: Policy) -> None:
    """Write a policy file atomically; PolicyError if that fails."""
    given = (
        policy.layers,
        policy.activation,
        policy.output,
        policy.observation,
        policy.action,
        dict(policy.about),
    )
    arrays: Arrays = {}
    for k, layer in enumerate(zip(policy.weights, policy.biases, strict=True)):
        for (name, _), values in zip(_ARRAYS, layer, strict=True):
            arrays[f"{name}_{k}"] = np.ascontiguousarray(values, np.float32)
    try:
        FORMAT.write(path, as_dict(_PolicyHeader(FORMAT.schema, *given)), arrays)
    except WorldError as error:
        raise PolicyError(str(error)) from None


def read_policy(path: Path) -> Policy:
    """Return the policy of a file; PolicyError if it is damaged or of another version."""
    try:
        content, arrays = FORMAT.read(path)
        if not isinstance(content.get("about"), dict):
            raise PolicyError(f"{path}: about must be a mapping")
        header = from_dict(_PolicyHeader, content, str(path))
        if not 2 <= len(header.layers) <= MOST_LAYERS + 1:
            raise PolicyError(
                f"{path}: layers must be 2 to {MOST_LAYERS + 1} sizes, got {len(header.layers)}"
            )
        count = range(len(header.layers) - 1)
        weights, biases = (
            tuple(_array(path, arrays, f"{name}_{k}", n) for k in count)
            for name, n in _ARRAYS
        )
        rest = (header.activation, header.output, header.about, str(path))
        policy = Policy(header.observation, header.action, weights, biases, *rest)
    except (WorldError, ConfigError) as error:
        raise PolicyError(str(error)) from None
    if policy.layers != list(header.layers):
        raise PolicyError(
            f"{path}: its header has layers of {list(header.layers)}, the file has {policy.layers}"
        )
    return policy


def _array(
    path: Path, arrays: Arrays, name: str, dimensions: int
) -> npt.NDArray[np.float32]:
    array = FORMAT.array(arrays, name, path)
    if array.dtype != np.float32 or array.ndim != dimensions:
        raise PolicyError(
            f"{path}: {name} must hold float32 in {dimensions} dimensions, got {array.dtype} of shape {array.shape}"
        )
    return array
