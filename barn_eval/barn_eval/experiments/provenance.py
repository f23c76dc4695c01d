"""What a result was made with: versions, source commit and machine."""

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

SUITE = ("barn_worlds", "barn_sim", "barn_planners", "barn_metrics", "barn_eval")
LIBRARIES = ("numpy", "numba", "scipy", "pybullet", "mcap", "rosbags", "rclpy")


def versions() -> dict[str, str]:
    """Return the version of Python, of the suite's packages and of the libraries that decide results."""
    return {"python": platform.python_version()} | {name: _version(name) for name in (*SUITE, *LIBRARIES)}


def commit() -> str:
    """Return the commit of the source tree, "+changes" added where files differ from it; empty if not known."""
    return commit_of(Path(__file__).parent)


def commit_of(folder: Path) -> str:
    """Return the commit of the repository around a folder; empty if that is not this suite's.

    An environment with the suite installed may lie within the repository of another project.
    """
    if not _git(folder, "ls-files", ":(top,glob)**/barn_eval/package.xml"):
        return ""
    changes = _git(folder, "status", "--porcelain", "--untracked-files=no")
    return _git(folder, "rev-parse", "HEAD") + ("+changes" if changes else "")


def machine() -> dict[str, Any]:
    """Return what wall-clock figures depend on."""
    return {"processor": _processor(), "cores": os.cpu_count(), "system": platform.platform()}


def provenance() -> dict[str, Any]:
    """Return versions, commit and machine."""
    return {"versions": versions(), "commit": commit(), "machine": machine()}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _git(folder: Path, *arguments: str) -> str:
    try:
        done = subprocess.run(  # noqa: S603
            ["git", "--no-optional-locks", "-C", str(folder), *arguments],  # noqa: S607
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())
