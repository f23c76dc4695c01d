"""Files of learned policies: layers of numbers and a JSON header, nothing executable.

A policy file is a .npz: `policy.json` and, per layer k, float32 in `weights_k.npy` (inputs, outputs) and `biases_k.npy`
(outputs,). The header::

    {"schema": 1, "layers": [45, 64, 64, 2], "activation": "tanh", "output": "clip",
     "observation": {...}, "action": {...}, "about": {...}}

The activation follows every layer but the last. Output "tanh" is applied to the last one; "clip" only limits the
action. observation, action: the configurations in `barn_planners.policy_space`. about: notes for people.
"""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from barn_planners.policy_space import ACTIONS, PolicyAction, PolicyObservation
from barn_worlds.config import as_dict, from_dict
from barn_worlds.errors import BarnError, ConfigError, WorldError, suggest
from barn_worlds.formats.files import read_bytes, write_bytes
from barn_worlds.formats.npy import parse_npy, to_npy

SCHEMA = 1
ACTIVATIONS = ("tanh", "relu")
OUTPUTS = ("clip", "tanh")
MOST_LAYERS = 16
WIDEST_LAYER = 65536
LARGEST_FILE = 64 * 1024 * 1024
_HEADER = "policy.json"
_KEYS = {"schema", "layers", "activation", "output", "observation", "action", "about"}

Array = npt.NDArray[np.float64]


class PolicyError(BarnError):
    """A policy file that cannot be read or is malformed."""


@dataclass(frozen=True, eq=False)
class Policy:
    """A multilayer perceptron from observations to actions.

    weights: one (inputs, outputs) per layer; biases: one (outputs,) per layer. Raises PolicyError, which begins
    with `where`, if sizes do not match each other, the observation or the action, or if a value is not finite.
    """

    observation: PolicyObservation
    action: PolicyAction
    weights: tuple[npt.NDArray[np.float32], ...]
    biases: tuple[npt.NDArray[np.float32], ...]
    activation: str = "tanh"
    output: str = "clip"
    about: Mapping[str, Any] = field(default_factory=dict)
    where: str = "policy"

    def __post_init__(self) -> None:
        for name, value, known in (("activation", self.activation, ACTIVATIONS), ("output", self.output, OUTPUTS)):
            if value not in known:
                raise PolicyError(f"{self.where}: unknown {name} {value!r:.40}{suggest(value, known)}")
        if not 1 <= len(self.weights) <= MOST_LAYERS or len(self.weights) != len(self.biases):
            raise PolicyError(f"{self.where}: must have 1 to {MOST_LAYERS} layers, got {len(self.weights)}")
        layers = self.layers
        if layers[0] != self.observation.size or layers[-1] != ACTIONS:
            raise PolicyError(
                f"{self.where}: must lead from {self.observation.size} observed values to {ACTIONS} actions,"
                f" got layers of {layers}"
            )
        for k, (weights, biases) in enumerate(zip(self.weights, self.biases, strict=True)):
            if weights.shape != (layers[k], layers[k + 1]) or biases.shape != (layers[k + 1],):
                raise PolicyError(
                    f"{self.where}: layer {k} must have weights {(layers[k], layers[k + 1])} and as many biases,"
                    f" got {weights.shape} and {biases.shape}"
                )
            if not (np.isfinite(weights).all() and np.isfinite(biases).all()):
                raise PolicyError(f"{self.where}: layer {k} holds values that are not finite")

    @property
    def layers(self) -> list[int]:
        """Number of inputs, then of outputs of each layer."""
        return [len(self.weights[0]), *(len(biases) for biases in self.biases)]


class PolicyNetwork:
    """Evaluates a policy, summing in a fixed order: the same bits with any number of threads."""

    def __init__(self, policy: Policy) -> None:
        self._layers = [
            (np.ascontiguousarray(weights, np.float64), biases.astype(np.float64))
            for weights, biases in zip(policy.weights, policy.biases, strict=True)
        ]
        self._relu = policy.activation == "relu"
        self._squash = policy.output == "tanh"

    def act(self, seen: npt.NDArray[np.float32]) -> Array:
        """Return the action (2,) for an observation, before limits."""
        values: Array = seen.astype(np.float64)
        last = len(self._layers) - 1
        for k, (weights, biases) in enumerate(self._layers):
            values = affine(values, weights, biases)
            if k < last:
                values = np.maximum(values, 0.0) if self._relu else np.tanh(values)
        return np.tanh(values) if self._squash else values


@njit(cache=True)
def affine(values: Array, weights: Array, biases: Array) -> Array:
    """Return values (n,) @ weights (n, m) + biases (m,)."""
    out: Array = biases.copy()
    for i in range(len(values)):
        for j in range(len(out)):
            out[j] += values[i] * weights[i, j]
    return out


def write_policy(path: Path, policy: Policy) -> None:
    """Write a policy file atomically; PolicyError if that fails."""
    header = {
        "schema": SCHEMA,
        "layers": policy.layers,
        "activation": policy.activation,
        "output": policy.output,
        "observation": as_dict(policy.observation),
        "action": as_dict(policy.action),
        "about": dict(policy.about),
    }
    members = {_HEADER: (json.dumps(header, indent=1) + "\n").encode()}
    for k, (weights, biases) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        members[f"weights_{k}.npy"] = to_npy(np.ascontiguousarray(weights, np.float32))
        members[f"biases_{k}.npy"] = to_npy(np.ascontiguousarray(biases, np.float32))
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED, 9)
    try:
        write_bytes(path, file.getvalue())
    except WorldError as error:
        raise PolicyError(str(error)) from None


def read_policy(path: Path) -> Policy:
    """Return the policy of a file; PolicyError if it is damaged or of another version."""
    try:
        with zipfile.ZipFile(io.BytesIO(read_bytes(path, LARGEST_FILE))) as archive:
            if sum(member.file_size for member in archive.infolist()) > LARGEST_FILE:
                raise PolicyError(f"{path}: unpacks to more than the allowed {LARGEST_FILE} bytes")
            header = _header(path, archive)
            count = len(header["layers"]) - 1
            weights = tuple(_array(path, archive, f"weights_{k}.npy", 2) for k in range(count))
            biases = tuple(_array(path, archive, f"biases_{k}.npy", 1) for k in range(count))
        observation = from_dict(PolicyObservation, header["observation"], f"{path}: observation")
        action = from_dict(PolicyAction, header["action"], f"{path}: action")
        policy = Policy(
            observation, action, weights, biases, header["activation"], header["output"], header["about"], str(path)
        )
    except (WorldError, ConfigError) as error:
        raise PolicyError(str(error)) from None
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError) as error:
        raise PolicyError(f"{path}: not a policy file, or a damaged one: {error}") from None
    if policy.layers != header["layers"]:
        raise PolicyError(f"{path}: its header has layers of {header['layers']}, the file has {policy.layers}")
    return policy


def _header(path: Path, archive: zipfile.ZipFile) -> dict[str, Any]:
    """Return the header after checking the types of its values."""
    try:
        header = json.loads(_member(path, archive, _HEADER))
    except (ValueError, RecursionError):
        raise PolicyError(f"{path}: its header is not JSON") from None
    if not isinstance(header, dict) or header.get("schema") != SCHEMA:
        version = header.get("schema") if isinstance(header, dict) else None
        raise PolicyError(f"{path}: schema version must be {SCHEMA}, got {version!r:.40}")
    wrong = sorted(set(header) ^ _KEYS)
    if wrong:
        raise PolicyError(f"{path}: its header must have the keys {', '.join(sorted(_KEYS))}; check {wrong[0]!r:.40}")
    layers = header["layers"]
    whole = isinstance(layers, list) and all(type(width) is int and 1 <= width <= WIDEST_LAYER for width in layers)
    if not whole or not 2 <= len(layers) <= MOST_LAYERS + 1:
        raise PolicyError(f"{path}: layers must be 2 to {MOST_LAYERS + 1} sizes up to {WIDEST_LAYER}")
    if not isinstance(header["about"], dict):
        raise PolicyError(f"{path}: about must be a mapping")
    return header


def _array(path: Path, archive: zipfile.ZipFile, name: str, dimensions: int) -> npt.NDArray[np.float32]:
    array = parse_npy(_member(path, archive, name), f"{path}: {name}")
    if array.dtype != np.float32 or array.ndim != dimensions:
        raise PolicyError(
            f"{path}: {name} must hold float32 in {dimensions} dimensions, got {array.dtype} of shape {array.shape}"
        )
    return array


def _member(path: Path, archive: zipfile.ZipFile, name: str) -> bytes:
    if name not in archive.namelist():
        raise PolicyError(f"{path}: not a policy file: it has no {name}")
    return archive.read(name)
