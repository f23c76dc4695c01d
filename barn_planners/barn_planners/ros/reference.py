"""The generated parts of README.md and config: parameters of the node and the planners."""

from dataclasses import replace

from barn_planners.registry import PlannerEntry, planner_entry, planner_names
from barn_planners.ros.planner import NodeConfig
from barn_planners.sync import SyncConfig
from barn_worlds.reference import Reference, parameter_file, parameter_table


def reference() -> Reference:
    """Return the tables of the node and of this package's planners, and a parameter file for each preset."""
    entries = {name: planner_entry(name) for name in planner_names()}
    ours = {name: one for name, one in entries.items() if one.config_class.__module__.startswith("barn_planners.")}
    sections = {
        "node parameters": parameter_table({"default": NodeConfig()}),
        "reading parameters": parameter_table({"default": SyncConfig()}),
        "planner parameters": "\n\n".join(_section(name, entry) for name, entry in ours.items()),
    }
    files = {
        f"{name}.yaml" if len(entry.presets) == 1 else f"{name}_{preset}.yaml": _file(name, entry, preset)
        for name, entry in ours.items()
        for preset in entry.presets
    }
    return Reference(sections, files)


def _section(name: str, entry: PlannerEntry) -> str:
    return f"### `{name}`\n\n{entry.summary[:1].upper()}{entry.summary[1:]}.\n\n{parameter_table(entry.presets)}"


def _file(name: str, entry: PlannerEntry, preset: str) -> str:
    """Return the parameter file of a preset, for a node of any name: each planner has an executable of its own."""
    node = replace(NodeConfig(), preset=preset, use_map=preset == "paper")
    configs = [node, SyncConfig(), entry.presets[preset]]
    title = f"The planner {name} with its preset {preset}."
    return parameter_file("/**", title, configs, {"planner": name, "use_sim_time": True})
