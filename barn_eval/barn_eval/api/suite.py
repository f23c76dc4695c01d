"""The suite itself from Python, as `barn reproduce`, `bench` and `info` have it."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.console import Console

from barn_eval.results.provenance import provenance
from barn_eval.ros.isolation import probe_isolation, ros_problem
from barn_eval.ros.work import isolation_warning
from barn_eval.studies.bench import BenchSetup, bench
from barn_eval.studies.reproduction import findings as reproduction
from barn_eval.studies.reproduction.findings import QUICK, ReproduceConfig
from barn_eval.studies.reproduction.page import write_results
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import ExecutionConfig
from barn_planners.registry import planner_names
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.text_files import read_package_yaml
from barn_worlds.datasets.dataset import dataset_files

__all__ = ["BenchSetup", "bench", "info", "reproduce"]

# Module or program: (what needs it, what is off without it).
OPTIONAL: dict[str, list[str]] = read_package_yaml("barn_eval", "optional.yaml")


def reproduce(
    *,
    quick: bool = False,
    out: str | Path | None = None,
    settings: Mapping[str, object] | None = None,
    workers: int = 0,
    docs: str | Path | None = None,
    progress: bool = True,
) -> list[Path]:
    """Run the paper's trials, write it all up and return the pages, results.md.

    The same call goes on where one was interrupted.

    Args:
        quick: Part of the worlds.
        out: Folder of trials and page. Default: out/results, or out/results_quick.
        settings: Fields of `barn_eval.studies.reproduction.findings.ReproduceConfig`, such as dataset and seed.
        workers: Trials at a time; 0 for one per processor.
        docs: Folder to write the page into as well.
        progress: Show how far it is.

    Raises:
        BarnError: Something is not possible as it was asked for.
    """
    config = replace_dotted(
        QUICK if quick else ReproduceConfig(), settings or {}, "settings"
    )
    folder = (
        Path(out) if out else Path("out") / ("results_quick" if quick else "results")
    )
    console = Console(stderr=True, quiet=not progress)
    findings, origin = reproduction.reproduce(
        config, folder, ExecutionConfig(workers=workers), console
    )
    return [
        write_results(findings, origin, Path(target))
        for target in (folder, docs)
        if target
    ]


def info() -> dict[str, Any]:
    """Return what is installed, which ROS there is, what is off and why, planners, data sets and machine."""
    found = {
        name: bool((shutil.which if name == "ffmpeg" else find_spec)(name))
        for name in OPTIONAL
    }
    off = {
        name: f"off: {name} is not installed; {remedy}"
        for name, (_, remedy) in OPTIONAL.items()
    }
    if found["rclpy"] and (problem := ros_problem()):
        found["rclpy"], off["rclpy"] = False, f"off: {problem}; {OPTIONAL['rclpy'][1]}"
    return provenance() | {
        "ros": _ros(),
        "optional": {
            name: "on" if there else off[name] for name, there in found.items()
        },
        "planners": planner_names(),
        "data_sets": list(dataset_files()),
    }


def _ros() -> dict[str, str]:
    """Return what of ROS there is, as text."""
    names = (
        "ROS_DISTRO",
        "RMW_IMPLEMENTATION",
        "ROS_DOMAIN_ID",
        "ROS_AUTOMATIC_DISCOVERY_RANGE",
        "AMENT_PREFIX_PATH",
    )
    found = {name: os.environ.get(name, "") for name in names}
    if not ros_problem():
        found["middleware"] = _middleware()
    found["isolation"] = (
        isolation_warning(RosConfig()) or f"planners over ROS: {probe_isolation()}"
    )
    return found


def _middleware() -> str:
    """Return the name of ROS's middleware, or why it does not load; asked in a process that may well crash."""
    asked = "import rclpy; print(rclpy.get_rmw_implementation_identifier())"
    done = subprocess.run(  # noqa: S603
        [sys.executable, "-c", asked],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    if done.returncode == 0:
        return done.stdout.strip()
    reason = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
    return f"does not load: {reason[-1]}"
