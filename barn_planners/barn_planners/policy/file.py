"""Files of learned policies: layers of numbers and a JSON header, nothing executable.

A policy file is a .npz. For each layer k it holds float32 arrays `weights_k.npy`
(inputs, outputs) and `biases_k.npy` (outputs,). Its header is `policy.json`::

    {"schema": 1, "layers": [45, 64, 64, 2], "activation": "tanh", "output": "clip",
     "observation": {...}, "action": {...}, "about": {...}}

- layers: number of inputs, then of outputs of each layer.
- activation: follows every layer but the last.
- output: "tanh" follows the last layer; "clip" only limits the action.
- observation, action: the configurations in `barn_planners.policy.space`. Several frames,
  or actions that hold for several control periods, make it schema 2.
- about: notes for people.

Any other policy is an ONNX file with float32 inputs and outputs of fixed shapes. Its
first input is the observation (1, size), its first output the action (1, 2). Further
inputs are the state of a recurrent policy, zeros at the start of a trial; as many
further outputs, in the same order, are the state of the next step. The metadata of the
model has an entry `barn_policy`, in JSON::

    {"observation": {...}, "action": {...}, "about": {...}}
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from barn_planners.interface import FloatArray
from barn_planners.policy.space import ACTIONS, PolicyAction, PolicyObservation, Vector
from barn_worlds.base.arrays import Singles, kernel
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.errors import BarnError, ConfigError, format_error, suggest
from barn_worlds.base.files import parse_json, read_bytes
from barn_worlds.formats.npz import Arrays, NpzFormat

ACTIVATIONS = ("tanh", "relu")
OUTPUTS = ("clip", "tanh")
# Limits for untrusted files: more would only fill memory.
MAX_LAYERS = 16
LARGEST_FILE = 64 * 1024 * 1024
FORMAT = NpzFormat(
    "a policy file",
    "policy.json",
    schema=1,
    largest_file=LARGEST_FILE,
    largest=LARGEST_FILE,
    # Of policies with more than one frame, or whose actions hold longer than a period.
    other_schemas=(2,),
)

METADATA_KEY = "barn_policy"
# Numbers of an input or output.
LARGEST_ARRAY = 2_000_000
# Log level of onnxruntime, whose warnings about shapes would go to the terminal.
_ERRORS_ONLY = 3


class PolicyError(BarnError):
    """A policy file that cannot be read or is malformed."""


@dataclass(frozen=True, eq=False)
class Policy:
    """A multilayer perceptron from observations to actions, checked on construction."""

    observation: PolicyObservation
    action: PolicyAction
    # Per layer: (inputs, outputs).
    weights: tuple[Singles, ...]
    # Per layer: (outputs,).
    biases: tuple[Singles, ...]
    # Follows every layer but the last: one of `ACTIVATIONS`.
    activation: str = "tanh"
    # Follows the last layer: one of `OUTPUTS`.
    output: str = "clip"
    # Notes for people.
    about: Mapping[str, object] = field(default_factory=dict)
    # Where errors are reported, such as the path of the file.
    where: str = "policy"

    def __post_init__(self) -> None:
        """Raise PolicyError unless choices, layer sizes and numbers are valid."""
        self._check_choice("activation", self.activation, ACTIVATIONS)
        self._check_choice("output", self.output, OUTPUTS)

        count = len(self.weights)
        self._require(
            1 <= count <= MAX_LAYERS and count == len(self.biases),
            f"must have 1 to {MAX_LAYERS} layers, got {count}",
        )
        layers = self.layers
        ends = f"{self.observation.size} observed values to {ACTIONS} actions"
        self._require(
            layers[0] == self.observation.size and layers[-1] == ACTIONS,
            f"must lead from {ends}, got layers of {layers}",
        )

        for k in range(count):
            weights = self.weights[k]
            biases = self.biases[k]
            shape = (layers[k], layers[k + 1])
            self._require(
                weights.shape == shape and biases.shape == shape[1:],
                f"layer {k} must have weights {shape} and as many biases, "
                f"got {weights.shape} and {biases.shape}",
            )
            self._require(
                bool(np.isfinite(weights).all() and np.isfinite(biases).all()),
                f"layer {k} holds values that are not finite",
            )

    def _check_choice(self, name: str, value: str, choices: tuple[str, ...]) -> None:
        """Raise PolicyError unless `value` is one of `choices`."""
        problem = f"unknown {name} {value!r:.40}{suggest(value, choices)}"
        self._require(value in choices, problem)

    def _require(self, holds: bool, problem: str) -> None:
        """Raise PolicyError with `where` and `problem` unless `holds`."""
        if not holds:
            raise PolicyError(f"{self.where}: {problem}")

    @property
    def layers(self) -> tuple[int, ...]:
        """Sizes of the layers: number of inputs, then of outputs of each layer."""
        return (len(self.weights[0]), *map(len, self.biases))


@dataclass(frozen=True)
class _PolicyHeader:
    """The JSON header of a policy file; its fields are the keys."""

    schema: int
    layers: tuple[int, ...]
    activation: str
    output: str
    observation: PolicyObservation
    action: PolicyAction
    about: dict[str, Any]


class PolicyNetwork:
    """Evaluates a policy, with the same bits for any number of threads."""

    def __init__(self, policy: Policy):
        """Copy weights and biases in double precision."""
        self.observation = policy.observation
        self.action = policy.action
        self._layers = [
            (np.ascontiguousarray(weights, np.float64), biases.astype(np.float64))
            for weights, biases in zip(policy.weights, policy.biases, strict=True)
        ]
        self._uses_relu = policy.activation == "relu"
        self._squashes_output = policy.output == "tanh"

    def reset(self) -> None:
        """Do nothing: a perceptron has no memory."""

    def act(self, observation: Vector) -> FloatArray:
        """Return the action (2,), not yet clipped, for an observation (size,)."""
        values: FloatArray = observation.astype(np.float64)
        last = len(self._layers) - 1
        for k, (weights, biases) in enumerate(self._layers):
            values = affine(values, weights, biases)
            if k < last:
                values = np.maximum(values, 0.0) if self._uses_relu else np.tanh(values)
        return np.tanh(values) if self._squashes_output else values


@kernel
def affine(values: FloatArray, weights: FloatArray, biases: FloatArray) -> FloatArray:
    """Return values @ weights + biases (m,), summed in a fixed order.

    The order of summation in BLAS depends on its threads and on the machine.

    Args:
        values: Inputs (n,).
        weights: Weights (n, m).
        biases: Biases (m,).
    """
    outputs: FloatArray = biases.copy()
    for i in range(len(values)):
        for j in range(len(outputs)):
            outputs[j] += values[i] * weights[i, j]
    return outputs


def write_policy(path: Path, policy: Policy) -> None:
    """Write a policy to a .npz file atomically; make folders, replace what exists.

    Args:
        path: File to write or replace.
        policy: Policy to store; its numbers are stored as float32.

    Raises:
        WorldError: If the file cannot be written.
    """
    schema = FORMAT.schema
    if policy.observation.frames > 1 or policy.action.repeat > 1:
        schema = FORMAT.other_schemas[0]
    header = _PolicyHeader(
        schema,
        policy.layers,
        policy.activation,
        policy.output,
        policy.observation,
        policy.action,
        dict(policy.about),
    )
    arrays: Arrays = {}
    for k, weights in enumerate(policy.weights):
        arrays[f"weights_{k}"] = np.ascontiguousarray(weights, np.float32)
        arrays[f"biases_{k}"] = np.ascontiguousarray(policy.biases[k], np.float32)
    FORMAT.write(path, as_dict(header), arrays)


def read_policy(path: Path) -> Policy:
    """Return the checked policy of a .npz file; raise BarnError if it is invalid.

    Raises:
        BarnError: If the file is damaged, malformed or of another version.
    """
    content, arrays = FORMAT.read(path)
    # Free-form notes are the one part that the header's types do not check.
    if not isinstance(content.get("about"), dict):
        raise PolicyError(f"{path}: about must be a mapping")
    header = from_dict(_PolicyHeader, content, str(path))
    sizes = len(header.layers)
    if not 2 <= sizes <= MAX_LAYERS + 1:
        raise PolicyError(
            f"{path}: layers must list 2 to {MAX_LAYERS + 1} sizes, got {sizes}"
        )

    layers = range(sizes - 1)
    policy = Policy(
        header.observation,
        header.action,
        tuple(_read_array(path, arrays, f"weights_{k}", 2) for k in layers),
        tuple(_read_array(path, arrays, f"biases_{k}", 1) for k in layers),
        header.activation,
        header.output,
        header.about,
        str(path),
    )

    if len(arrays) > 2 * len(layers):
        raise PolicyError(
            f"{path}: must have {2 * len(layers)} arrays for its {len(layers)} layers, "
            f"got {len(arrays)}"
        )
    # The header is what people and tools read, so it must not contradict the numbers.
    if policy.layers != header.layers:
        raise PolicyError(
            f"{path}: its header has layers of {header.layers}, "
            f"but its arrays have {policy.layers}"
        )
    return policy


def _read_array(path: Path, arrays: Arrays, name: str, dimensions: int) -> Singles:
    """Return a float32 array of a file; WorldError if it is missing or malformed."""
    return FORMAT.array(arrays, name, path, [None] * dimensions, "float32")


def load_network(path: Path) -> "PolicyNetwork | OnnxNetwork":
    """Return the network of a .npz or .onnx file; raise BarnError if it is invalid.

    Raises:
        BarnError: If the file is damaged, malformed or of another version, or if it is
            an .onnx file and onnxruntime is missing.
    """
    if path.suffix == ".onnx":
        return OnnxNetwork(path)
    return PolicyNetwork(read_policy(path))


@dataclass(frozen=True)
class _Metadata:
    """The entry `barn_policy` of a model; its fields are the keys."""

    observation: PolicyObservation
    action: PolicyAction
    about: dict[str, Any] = field(default_factory=dict)


class OnnxNetwork:
    """Evaluates an ONNX model on one thread."""

    def __init__(self, path: Path):
        """Read an ONNX file and check its shapes; BarnError if it is invalid.

        Raises:
            BarnError: If it is damaged, its sizes do not fit its metadata, or
                onnxruntime is missing.
        """
        try:
            import onnxruntime  # noqa: PLC0415 (optional)
        except ImportError:
            raise ConfigError(
                f"{path}: .onnx policies need onnxruntime: pip install onnxruntime"
            ) from None
        content = read_bytes(path, LARGEST_FILE)
        options = onnxruntime.SessionOptions()
        # The order of summation must not depend on the number of processors.
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.log_severity_level = _ERRORS_ONLY
        try:
            self._session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        # The library raises errors of many classes for bytes that are no model.
        except Exception as error:
            raise PolicyError(
                f"{path}: not an ONNX model: {format_error(error)}"
            ) from None
        self.observation, self.action = self._read_metadata(path)
        self._inputs = self._session.get_inputs()
        self._check_shapes(path)
        self.reset()

    def _read_metadata(self, path: Path) -> tuple[PolicyObservation, PolicyAction]:
        """Return the model's observation and action; BarnError if they are invalid."""
        text = self._session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
        if text is None:
            raise PolicyError(f"{path}: its metadata has no entry {METADATA_KEY}")
        where = f"{path}: {METADATA_KEY}"
        metadata = from_dict(_Metadata, parse_json(text, where), where)
        return metadata.observation, metadata.action

    def _check_shapes(self, path: Path) -> None:
        """Raise PolicyError unless inputs and outputs have a policy's types and shapes."""
        outputs = self._session.get_outputs()
        for item in (*self._inputs, *outputs):
            is_fixed = all(isinstance(size, int) for size in item.shape)
            # An untrusted file may ask for any amount of memory.
            is_fixed = is_fixed and 0 < math.prod(item.shape) <= LARGEST_ARRAY
            if item.type != "tensor(float)" or not is_fixed:
                raise PolicyError(
                    f"{path}: {item.name} must have a fixed shape of at most {LARGEST_ARRAY} "
                    f"float32 numbers, got {item.type} of {item.shape}"
                )
        shapes = [item.shape for item in self._inputs]
        expected = [[1, self.observation.size], *shapes[1:]]
        results = [item.shape for item in outputs]
        if shapes != expected or results != [[1, ACTIONS], *shapes[1:]]:
            raise PolicyError(
                f"{path}: must lead from {expected[0]} and a state to {[1, ACTIONS]} "
                f"and the same state, got {shapes} to {results}"
            )

    def reset(self) -> None:
        """Set the recurrent state to zeros for a new trial."""
        self._state = [np.zeros(item.shape, np.float32) for item in self._inputs[1:]]

    def act(self, observation: Vector) -> FloatArray:
        """Return the action (2,), not yet clipped, and update the recurrent state."""
        values = [observation[None], *self._state]
        names = [item.name for item in self._inputs]
        feed = dict(zip(names, values, strict=True))
        action, *self._state = self._session.run(None, feed)
        result: FloatArray = action[0].astype(np.float64)
        return result
