"""The parameter files of the package: `python -m barn_sim.ros.parameter_files config` writes them anew."""

from __future__ import annotations

import sys

import yaml

from barn_sim.config import PRESETS, SimulatorConfig
from barn_sim.ros.node_config import NodeConfig, RunConfig
from barn_worlds.config import fields_of
from barn_worlds.ros.parameter_files import parameter_file, write

NODE = "/**/simulator"


def files() -> dict[str, str]:
    """Return the files by name: all parameters with their defaults, and what each preset changes."""
    everything = parameter_file(NODE, "The simulator with its defaults.", [NodeConfig(), RunConfig()])
    presets = {f"{name}.yaml": preset_file(name) for name in PRESETS if name != "default"}
    return {"simulator.yaml": everything, **presets}


def preset_file(name: str) -> str:
    """Return the parameter file of a preset: everything in which it differs from the default."""
    default = {field: value for field, _, value in fields_of(SimulatorConfig())}
    changes = {field: value for field, _, value in fields_of(PRESETS[name]) if value != default[field]}
    content = {NODE: {"ros__parameters": changes}}
    return f"# The simulator as in the preset {name}.\n" + yaml.safe_dump(content, sort_keys=False)


if __name__ == "__main__":
    sys.exit(write(files(), sys.argv[1:]))
