"""The parameter files of the package: `python -m barn_planners.ros.parameter_files config` writes them anew."""

from __future__ import annotations

import sys
from dataclasses import replace

from barn_planners.registry import planner_entry, planner_names
from barn_planners.ros.planner import NodeConfig
from barn_planners.sync import SyncConfig
from barn_worlds.ros.parameter_files import parameter_file, write


def files() -> dict[str, str]:
    """Return a file for each preset of this package's planners, by name."""
    found = {}
    for planner in planner_names():
        entry = planner_entry(planner)
        if not entry.config_class.__module__.startswith("barn_planners."):
            continue
        for preset, config in entry.presets.items():
            name = planner if len(entry.presets) == 1 else f"{planner}_{preset}"
            node = replace(NodeConfig(), preset=preset, use_map=preset == "paper")
            # for any name of the node, since each planner has an executable of its own as well
            found[f"{name}.yaml"] = parameter_file(
                "/**",
                f"The planner {planner} with its preset {preset}.",
                [node, SyncConfig(), config],
                {"planner": planner, "use_sim_time": True},
            )
    return found


if __name__ == "__main__":
    sys.exit(write(files(), sys.argv[1:]))
