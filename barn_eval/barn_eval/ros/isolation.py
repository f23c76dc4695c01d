"""Whether ROS is installed, and what keeps planners from the suite's processes."""

import platform
import subprocess
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec
from pathlib import Path

from barn_eval.ros.supervision.process import LAUNCHER
from barn_eval.trials.ros_config import RosConfig


def ros_problem() -> str:
    """Return why this Python has no usable rclpy, empty if it has; import nothing.

    Either rclpy is not installed, or it was built for another Python.
    """
    spec = find_spec("rclpy")
    if spec is None or not spec.submodule_search_locations:
        return "rclpy is not installed"

    folder = Path(next(iter(spec.submodule_search_locations)))
    extensions = folder.glob("_rclpy_pybind11.*")
    endings = sorted(path.name.partition(".")[2] for path in extensions)
    # Without such a file the import itself says what is wrong.
    if not endings or any(f".{ending}" in EXTENSION_SUFFIXES for ending in endings):
        return ""
    return (
        f"rclpy of {folder} is for a different Python ({', '.join(endings)});"
        f" this is {platform.python_version()}"
    )


@cache
def probe_isolation() -> str:
    """Return "apart", "visible", or why planners cannot be isolated here; cached.

    "apart": in namespaces of their own they neither see nor signal the suite's
    processes. "visible": they only see them.
    """
    probe = subprocess.run(  # noqa: S603
        [*LAUNCHER, "probe"], capture_output=True, text=True, check=False
    )
    return probe.stdout.strip() or "cannot be asked"


def can_isolate() -> bool:
    """Return whether planners on this host can be kept from signaling the suite."""
    return probe_isolation() in ("apart", "visible")


def session_isolation(config: RosConfig) -> str:
    """Return "apart", "visible", a reason or "not asked for", as run.json has it."""
    return probe_isolation() if config.isolate else "not asked for"
