"""`barn run --system`: trials in a simulator or on a robot that somebody else runs."""

import os
import shutil
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from barn_eval.results.rows import RowFile
from barn_eval.results.store import LOGS
from barn_eval.ros import evaluator
from barn_eval.ros.supervision import nodes
from barn_eval.running.request import RunRequest
from barn_eval.trials.result import TrialResult
from barn_eval.trials.ros_config import EvaluatorConfig, PlannerLink
from barn_eval.trials.system_file import read_system
from barn_worlds.base.errors import ConfigError, convert_os_errors


def run_observed(
    request: RunRequest, system: Path, *, protocol: str, robot: str, starts: bool
) -> list[TrialResult]:
    """Judge one planner, started if asked, in a system; return the folder's rows.

    Args:
        request: Its planner, worlds, repetitions, seed, bags and folder.
        system: YAML file of the system.
        protocol: Name or file of the protocol.
        robot: Name or file of the robot.
        starts: Whether to start the planner; else somebody else does.

    Raises:
        BarnError: If the file cannot be read, or there is more than one planner.
    """
    config = request.config
    if len(config.planners) > 1:
        raise ConfigError(
            f"planners: one at a time with --system, got {len(config.planners)}"
        )
    if config.ros.remap or config.ros.namespace:
        raise ConfigError(
            f"ros: with --system, name topics in {system}, not by remap or namespace"
        )
    file = read_system(system)
    (choice,) = config.planners
    link = {item.name: getattr(config.ros, item.name) for item in fields(PlannerLink)}
    defaults = EvaluatorConfig(
        dataset=config.dataset,
        worlds=config.worlds,
        planner=choice.name,
        protocol=protocol,
        robot=robot,
        seed=config.seed,
        repetitions=config.repetitions,
        out=str(request.out),
        bags=config.bags,
        system=str(system),
        **link,
    )
    with ExitStack() as stack:
        if starts:
            ros = replace(config.ros, remap=tuple(file.remappings()))
            node = nodes.planner(choice, replace(config, ros=ros))
            if node.parameters:
                clock = {"use_sim_time": file.sim_time}
                node = replace(node, parameters={**node.parameters, **clock})
            # The folder of the run must be empty until the evaluator has begun it.
            logs = Path(stack.enter_context(TemporaryDirectory(prefix="barn_")))
            process = node.start(os.environ, logs)
            stack.callback(_keep_log, process.log, request.out / LOGS)
            stack.callback(process.stop)
        # The operator reads the log, as the output of a command.
        os.environ.setdefault("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{message}")
        evaluator.main([], defaults, raises=True)
    # Of a trial that was repeated, the last row counts.
    return list({row.trial_id: row for row in RowFile(request.out).read()}.values())


def _keep_log(log: Path, folder: Path) -> None:
    """Copy a log into a run's folder, made if missing; do nothing without a run."""
    if folder.parent.is_dir():
        with convert_os_errors(ConfigError, folder):
            folder.mkdir(exist_ok=True)
            shutil.copy(log, folder)
