"""PyTorch modules as ONNX policy files: convolutions, recurrent policies, anything."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import onnx
import torch

from barn_eval.learning.config import EnvConfig
from barn_planners.policy.file import METADATA_KEY, OnnxNetwork
from barn_worlds.base.config import as_dict


def export_onnx(
    module: torch.nn.Module,
    config: EnvConfig,
    path: Path,
    state_sizes: Sequence[int] = (),
    about: Mapping[str, Any] | None = None,
) -> OnnxNetwork:
    """Write a module as a policy file; return the file's policy, read and checked.

    Args:
        module: Takes an observation (1, size) and each state (1, n), and returns the
            action (1, 2) followed by the new states.
        config: Configuration of the environment that it was trained in.
        path: File to write, which ends in .onnx.
        state_sizes: Length n of each state of a recurrent module.
        about: Notes for people.

    Raises:
        PolicyError: If inputs and outputs are not those of a policy.
    """
    states = [torch.zeros(1, size) for size in state_sizes]
    observation = torch.zeros(1, config.observation.size)
    module.eval()
    program: Any = torch.onnx.export(
        module, (observation, *states), dynamo=True, verbose=False
    )
    model = program.model_proto
    entry = model.metadata_props.add()
    entry.key = METADATA_KEY
    spaces = {
        "observation": as_dict(config.observation),
        "action": as_dict(config.action),
    }
    entry.value = json.dumps({**spaces, "about": dict(about or {})})
    onnx.save(model, path)
    return OnnxNetwork(path)
