"""What launch files have, read from their source.

Launch itself is only in a full ROS 2 installation.
"""

import ast
from functools import cache
from importlib import import_module
from pathlib import Path

from barn_worlds.base.config import fields_of

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT / "barn_worlds/barn_worlds/ros/launching.py"


@cache
def launch_arguments(path: Path) -> set[str]:
    """Return a set that the names of a launch file's arguments are among.

    These are the texts in it and in what all launch files share, and the fields of the
    configurations that it imports.
    """
    tree = ast.parse(path.read_text("utf-8"))
    names = _texts(tree) | _texts(ast.parse(SHARED.read_text("utf-8")))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("barn_"):
            for config in (
                alias.name for alias in node.names if alias.name.endswith("Config")
            ):
                config_class = getattr(import_module(node.module), config)
                names |= {name for name, _, _ in fields_of(config_class())}
    return names


def constant(path: Path, name: str) -> object:
    """Return what a launch file assigns to a name at its top."""
    for node in ast.parse(path.read_text("utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return ast.literal_eval(node.value)
    raise AssertionError(f"{path}: no {name}")


def _texts(tree: ast.Module) -> set[str]:
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
