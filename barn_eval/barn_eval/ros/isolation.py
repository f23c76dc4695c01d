"""Whether ROS is here, and what keeps planners over ROS from the suite's processes."""

import platform
import subprocess
import sys
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec
from pathlib import Path

from barn_eval.trials.ros_config import RosConfig


def ros_problem() -> str:
    """Return why this Python cannot use ROS; empty if it can.

    Either rclpy is not installed, or it was built for another Python.
    """
    spec = find_spec("rclpy")
    if spec is None or not spec.submodule_search_locations:
        return "rclpy is not installed"

    folder = Path(next(iter(spec.submodule_search_locations)))
    extensions = folder.glob("_rclpy_pybind11.*")
    endings = sorted(path.name.partition(".")[2] for path in extensions)
    if not endings or any(f".{ending}" in EXTENSION_SUFFIXES for ending in endings):
        return ""
    return (
        f"rclpy of {folder} is of another Python ({', '.join(endings)});"
        f" this is {platform.python_version()}"
    )


@cache
def isolation() -> str:
    """Return what keeps planner processes from the suite's, or why nothing does.

    "apart": in namespaces of their own they neither see nor signal the suite's
    processes. "visible": they only see them.
    """
    script = Path(__file__).parent / "supervision" / "guard.py"
    probe = subprocess.run(  # noqa: S603
        [sys.executable, "-I", "-S", str(script), "probe"],
        capture_output=True,
        text=True,
        check=False,
    )
    return probe.stdout.strip() or "cannot be asked"


def is_isolated() -> bool:
    """Tell whether no planner over ROS can signal the suite's processes."""
    return isolation() in ("apart", "visible")


def session_isolation(config: RosConfig) -> str:
    """Return the isolation of a run over ROS, as run.json has it of each session."""
    return isolation() if config.isolate else "not asked for"
