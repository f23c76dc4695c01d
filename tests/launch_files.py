"""What launch files have: from their source, or from loading them as `ros2` does."""

import ast
import json
import os
import re
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import yaml
from repository import ROOT

NODES = {
    "barn_worlds": "map_server",
    "barn_sim": "simulator",
    "barn_planners": "planner",
    "barn_eval": "evaluator",
}
FILES = {
    path.name.partition(".")[0]: path
    for path in sorted(ROOT.glob("barn_*/launch/*.launch.py"))
}


@cache
def system_prefix() -> Path:
    """Return a prefix with the workspace as colcon installs it, without libraries."""
    prefix = Path(tempfile.mkdtemp(prefix="barn_launch_"))
    (prefix / "python").mkdir()
    (prefix / "share").mkdir()
    (prefix / "python/yaml").symlink_to(Path(yaml.__file__).parent)
    for package, node in NODES.items():
        (prefix / "share" / package).symlink_to(ROOT / package)
        (prefix / "python" / package).symlink_to(ROOT / package / package)
        (prefix / "lib" / package).mkdir(parents=True)
        script = f"#!{sys.executable}\n"
        (prefix / "lib" / package / node).write_text(script)
    return prefix


def run_launch_file(path: Path, *arguments: str, prefix: Path | None = None):
    """Load a launch file in a Python without site-packages.

    Returns:
        The process that has ended; it prints JSON.
    """
    loader = Path(__file__).with_name("load_launch_file.py")
    command = [sys.executable, "-I", "-S", loader, prefix or system_prefix(), path]
    return subprocess.run(
        [*command, *arguments],
        check=False,
        capture_output=True,
        text=True,
        env={"PATH": os.environ["PATH"], "NUMBA_CACHE_DIR": "/nowhere"},
    )


@cache
def load_launch_file(path: Path, *arguments: str) -> dict:
    """Return what a launch file declares and makes with these arguments."""
    done = run_launch_file(path, *arguments)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@cache
def launch_arguments(path: Path) -> set[str]:
    """Return the names of a launch file's arguments.

    Of a file of the suite, those that it declares; of another one, all texts in it.
    """
    if path in FILES.values():
        return set(load_launch_file(path)["arguments"])
    tree = ast.parse(path.read_text("utf-8"))
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }


def constant(path: Path, name: str) -> object:
    """Return what a launch file assigns to a name at its top."""
    for node in ast.parse(path.read_text("utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return ast.literal_eval(node.value)
    raise AssertionError(f"{path}: no {name}")


def words_of_arguments(text: str) -> set[str]:
    """Return the names of the arguments on a command line."""
    return set(re.findall(r"([\w.]+):=", text))
