"""Policies as ONNX files, for what is no multilayer perceptron.

Such a file has float32 inputs and outputs of fixed shapes. Its first input is the
observation (1, size), its first output the action (1, 2). Further inputs are the state of a
recurrent policy, zeros at the start of a trial; as many further outputs, in the same order,
are the state of the next step. The metadata of the model has an entry `barn_policy`, in
JSON::

    {"observation": {...}, "action": {...}, "about": {...}}

which are those of `barn_planners.policy.file`.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from barn_planners.interface import FloatArray
from barn_planners.policy.file import PolicyError, PolicyNetwork, read_policy
from barn_planners.policy.space import ACTIONS, PolicyAction, PolicyObservation, Vector
from barn_worlds.base.config import from_dict
from barn_worlds.base.errors import ConfigError, format_error
from barn_worlds.base.files import read_bytes
from barn_worlds.base.text_files import parse_json

METADATA_KEY = "barn_policy"
LARGEST_FILE = 64 * 1024 * 1024
# Numbers of an input or output.
LARGEST_ARRAY = 2_000_000
# Of onnxruntime's log: a warning about shapes would go to the terminal.
_ERRORS_ONLY = 3


def load_network(path: Path) -> "PolicyNetwork | OnnxNetwork":
    """Return the policy of a .npz or .onnx file, ready to be asked.

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
        """Read and check a file.

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
        """Return observation and action of the model's metadata."""
        text = self._session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
        if text is None:
            raise PolicyError(f"{path}: its metadata has no entry {METADATA_KEY}")
        where = f"{path}: {METADATA_KEY}"
        metadata = from_dict(_Metadata, parse_json(text, where), where)
        return metadata.observation, metadata.action

    def _check_shapes(self, path: Path) -> None:
        """Raise PolicyError unless inputs and outputs are those of a policy."""
        outputs = self._session.get_outputs()
        for item in (*self._inputs, *outputs):
            is_fixed = all(isinstance(size, int) for size in item.shape)
            # A file of strangers may ask for any amount of memory.
            is_fixed = is_fixed and 0 < math.prod(item.shape) <= LARGEST_ARRAY
            if item.type != "tensor(float)" or not is_fixed:
                raise PolicyError(
                    f"{path}: {item.name} must hold at most {LARGEST_ARRAY} float32 of a fixed shape, "
                    f"got {item.type} of {item.shape}"
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
        """Set the state to zeros: a new trial begins."""
        self._state = [np.zeros(item.shape, np.float32) for item in self._inputs[1:]]

    def act(self, observation: Vector) -> FloatArray:
        """Return the action (2,), not yet clipped, for an observation (size,)."""
        values = [observation[None], *self._state]
        names = [item.name for item in self._inputs]
        feed = dict(zip(names, values, strict=True))
        action, *self._state = self._session.run(None, feed)
        result: FloatArray = action[0].astype(np.float64)
        return result
