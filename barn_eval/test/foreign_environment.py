"""A virtual environment as a user of plain ROS 2 has it: rclpy, the message packages and what they need, no suite."""

import os
import subprocess
import sys
import venv
from importlib.metadata import distributions
from pathlib import Path

from barn_eval.ros.supervision import nodes

SUITE = ("barn_worlds", "barn_sim", "barn_planners", "barn_metrics", "barn_eval")
NEEDED = ("numpy", "pyyaml", "typing_extensions", "typing-extensions")


def make(folder):
    """Make the environment and return its Python; None where ROS does not come from wheels.

    Nothing is installed anew: the packages of the wheels are linked to, each by its name.
    """
    linked = {}
    for distribution in distributions():
        name = distribution.metadata["Name"].lower()
        if name.startswith("ros-") or name in NEEDED:
            for file in distribution.files or ():
                top = file.parts[0]
                if top != ".." and not top.endswith((".dist-info", ".egg-info")):
                    linked[top] = Path(distribution.locate_file(top)).resolve()
    if "rclpy" not in linked:
        return None
    venv.EnvBuilder(with_pip=False, symlinks=True).create(folder)
    (packages,) = folder.glob("lib/python*/site-packages")
    for top, where in linked.items():
        (packages / top).symlink_to(where)
    for shared in (Path(sys.prefix) / "lib").glob("*.so*"):
        (folder / "lib" / shared.name).symlink_to(shared)
    (folder / "share").symlink_to(Path(sys.prefix) / "share")
    return folder / "bin" / "python"


def cannot_import_the_suite(python):
    """Tell whether a Python can import rclpy, and none of the suite's packages nor what they compute with."""
    code = "import sys, importlib.util as u, rclpy; print([n for n in sys.argv[1:] if u.find_spec(n)])"
    command = [str(python), "-I", "-c", code, *SUITE, "numba", "pybullet"]
    environment = nodes.foreign_environment(os.environ)
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout.strip() == "[]"
