"""The generated parts of README.md and config: the simulator's parameters."""

from barn_sim.config import PRESETS, RunConfig, SimulatorConfig, SimulatorNodeConfig
from barn_worlds.config import fields_of
from barn_worlds.reference import Reference, parameter_file, parameter_table

NODE = "/**/simulator"


def reference() -> Reference:
    """Return the tables, a file of all parameters, and one per preset of those that differ from the default."""
    node, default = SimulatorNodeConfig(), {name: value for name, _, value in fields_of(SimulatorConfig())}
    files = {"simulator.yaml": parameter_file(NODE, "The simulator with its defaults.", [node, RunConfig()])}
    for preset, config in PRESETS.items():
        same = {name for name, _, value in fields_of(config) if value == default[name]}
        if preset != "default":
            title = f"The simulator as in the preset {preset}: what differs from the default."
            files[f"{preset}.yaml"] = parameter_file(NODE, title, [config], leave_out=same)
    sections = {
        "run parameters": parameter_table({"default": RunConfig()}, leave_out=default),
        "simulator parameters": parameter_table(PRESETS),
        "node parameters": parameter_table({"default": node}),
    }
    return Reference(sections, files)
