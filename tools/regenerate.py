"""Write the parameter tables of all READMEs and the parameter files anew from the code: `make generated`."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

MODULES = (
    "barn_worlds.ros.reference",
    "barn_sim.ros.reference",
    "barn_planners.ros.reference",
    "barn_eval.reference",
)

if __name__ == "__main__":
    for module in MODULES:
        package = Path(__file__).parents[1] / module.partition(".")[0]
        import_module(module).reference().write(package)
