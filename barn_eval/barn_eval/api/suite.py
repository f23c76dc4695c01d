"""The suite itself from Python: `reproduce`, `bench` and `info` as in `barn`."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from barn_eval.results.provenance import provenance
from barn_eval.ros.isolation import probe_isolation, ros_problem
from barn_eval.ros.work import isolation_warning
from barn_eval.running.reporting import Reporter, make_reporter
from barn_eval.studies.bench import BenchSetup, bench
from barn_eval.studies.physical import measure_difficulty, write_finding
from barn_eval.studies.reproduction import findings as reproduction
from barn_eval.studies.reproduction.findings import QUICK, ReproduceConfig
from barn_eval.studies.reproduction.page import write_results
from barn_eval.trials.ros_config import RosConfig
from barn_eval.trials.run_config import ExecutionConfig
from barn_planners.registry import planner_names
from barn_worlds.base.config import replace_dotted
from barn_worlds.base.files import read_package_yaml
from barn_worlds.datasets.dataset import dataset_files

__all__ = ["BenchSetup", "bench", "info", "reproduce", "reproduce_physical"]

OPTIONAL: dict[str, list[str]] = read_package_yaml("barn_eval", "optional.yaml")
"""By optional module or program: the part that needs it, and how to install it."""

_ROS_VARIABLES = (
    "ROS_DISTRO",
    "RMW_IMPLEMENTATION",
    "ROS_DOMAIN_ID",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "AMENT_PREFIX_PATH",
)


def reproduce(
    *,
    quick: bool = False,
    out: str | Path | None = None,
    settings: Mapping[str, object] | None = None,
    workers: int = 0,
    docs: str | Path | None = None,
    progress: bool | Reporter = True,
) -> list[Path]:
    """Run the paper's trials and write results.md with figures; return the .md paths.

    The same call resumes an interrupted run.

    Args:
        quick: Run only some of the worlds.
        out: Folder of trials and page. Default: out/results, or out/results_quick.
        settings: Fields of
            `barn_eval.studies.reproduction.findings.ReproduceConfig`, such as dataset
            and seed.
        workers: Trials to run at a time; 0 for one per processor.
        docs: Second folder to write the page to.
        progress: As for `barn.run`.

    Raises:
        BarnError: If a setting is not allowed or a file cannot be written.
    """
    default = QUICK if quick else ReproduceConfig()
    config = replace_dotted(default, settings or {}, "settings")
    default_folder = Path("out") / ("results_quick" if quick else "results")
    folder = Path(out) if out else default_folder
    findings, origin = reproduction.reproduce(
        config, folder, ExecutionConfig(workers=workers), make_reporter(progress)
    )
    folders = [folder]
    if docs:
        folders.append(Path(docs))
    return [write_results(findings, origin, path) for path in folders]


def reproduce_physical(
    folders: Sequence[str | Path], out: str | Path = "out/physical"
) -> Path:
    """Write a page on measured over predicted difficulty, as Fig. 8; return its path.

    Args:
        folders: Results of one robot or simulator, such as `barn.judge` writes; those
            of the suite's own simulator may be added for comparison.
        out: Folder for the page.

    Raises:
        BarnError: If the folders do not go together, or have too few worlds.
    """
    finding = measure_difficulty([Path(folder) for folder in folders])
    return write_finding(finding, Path(out))


def info() -> dict[str, Any]:
    """Return a mapping: versions, commit, machine, ros, optional, planners, data_sets.

    `optional` gives the state of each optional part, "on" or "off: REASON".
    """
    states: dict[str, str] = {}
    for name, (_, remedy) in OPTIONAL.items():
        # The only program; all others are modules.
        if name == "ffmpeg":
            is_installed = shutil.which(name) is not None
        else:
            is_installed = find_spec(name) is not None

        problem = ""
        if not is_installed:
            problem = f"{name} is not installed"
        # rclpy may be installed for another Python.
        elif name == "rclpy":
            problem = ros_problem()
        states[name] = "on"
        if problem:
            states[name] = f"off: {problem}; {remedy}"
    ros = {name: os.environ.get(name, "") for name in _ROS_VARIABLES}
    # Only ROS can name its middleware.
    if not ros_problem():
        ros["middleware"] = _find_middleware()
    warning = isolation_warning(RosConfig())
    ros["isolation"] = warning or f"planners over ROS: {probe_isolation()}"
    return provenance() | {
        "ros": ros,
        "optional": states,
        "planners": planner_names(),
        "data_sets": list(dataset_files()),
    }


def _find_middleware() -> str:
    """Return the name of rclpy's middleware from a child process, or why it failed."""
    # Loading the middleware may crash the process.
    code = "import rclpy; print(rclpy.get_rmw_implementation_identifier())"
    process = subprocess.run(  # noqa: S603
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    if process.returncode == 0:
        return process.stdout.strip()
    reason = f"exit code {process.returncode}"
    # The last line of a traceback is the exception.
    lines = process.stderr.strip().splitlines()
    if lines:
        reason = lines[-1]
    return f"does not load: {reason}"
