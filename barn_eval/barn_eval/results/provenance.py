"""Find out what results are made with: versions, the source's commit, the machine."""

import os
import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from barn_worlds import __version__

SUITE = ("barn_worlds", "barn_sim", "barn_planners", "barn_metrics", "barn_eval")
LIBRARIES = ("numpy", "numba", "scipy", "pybullet", "mcap", "rosbags", "rclpy")


def provenance() -> dict[str, Any]:
    """Return package versions, source commit and machine as plain data; runs git."""
    return {"versions": versions(), "commit": commit(), "machine": machine()}


def versions() -> dict[str, str]:
    """Return versions by name of Python, the suite's packages and key libraries."""
    packages = {"python": platform.python_version()}
    # All packages of the suite are released together.
    packages |= dict.fromkeys(SUITE, __version__)
    packages |= {library: _library_version(library) for library in LIBRARIES}
    return packages


@cache
def _library_version(library: str) -> str:
    """Return the version of an installed package, else "not installed"."""
    try:
        return version(library)
    except PackageNotFoundError:
        return "not installed"


def commit() -> str:
    """Return the suite's full commit, plus "+changes" if tracked files differ, or "".

    Wheels and source archives have it in a file (qa/build_backend.py). It is empty
    without a repository and that file.
    """
    built = Path(__file__).parents[1] / "data" / "commit"
    revision = commit_of(Path(__file__).parent)
    if not revision and built.exists():
        revision = built.read_text("utf-8").strip()
    return revision


def commit_of(folder: Path) -> str:
    """Return HEAD of the suite's repository around a folder, or "" for any other folder.

    "+changes" is appended if tracked files differ from HEAD.
    """
    # The suite may be installed inside another repository.
    if not _git(folder, "ls-files", ":(top,glob)**/barn_eval/package.xml"):
        return ""
    # Files that git does not track, such as results, change no code.
    changes = _git(folder, "status", "--porcelain", "--untracked-files=no")
    revision = _git(folder, "rev-parse", "HEAD")
    if changes:
        revision += "+changes"
    return revision


def machine() -> dict[str, Any]:
    """Return processor model, number of logical cores, and operating system."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
    }


def _git(folder: Path, *arguments: str) -> str:
    """Run git in a folder; return its stripped output, or "" if it fails or takes 10 s."""
    # Without locks, so that this does not disturb the user's own git commands.
    command = ["git", "--no-optional-locks", "-C", str(folder), *arguments]
    try:
        process = subprocess.run(  # noqa: S603
            command, capture_output=True, text=True, timeout=10, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return process.stdout.strip() if process.returncode == 0 else ""


def _processor() -> str:
    """Return the processor's model name, or its architecture if that is unknown."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor()
    for line in lines:
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.machine()
