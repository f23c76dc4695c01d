"""`barn run --system`: trials in a simulator or on a robot that somebody else runs."""

import os
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path

from barn_eval.results.folder import read_results
from barn_eval.results.store import LOGS
from barn_eval.ros import evaluator
from barn_eval.ros.supervision import nodes
from barn_eval.ros.supervision.process import SupervisedProcess
from barn_eval.running.request import RunRequest
from barn_eval.trials.result import TrialResult
from barn_eval.trials.ros_config import EvaluatorConfig, PlannerLink
from barn_eval.trials.system_file import read_system
from barn_worlds.base.errors import ConfigError, convert_os_errors


def run_observed(
    request: RunRequest, system: Path, *, protocol: str, robot: str, starts: bool
) -> list[TrialResult]:
    """Judge trials in a system as they are driven; return all results of the folder.

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
    file = read_system(system)
    (choice,) = config.planners
    link = {item.name: getattr(config.ros, item.name) for item in fields(PlannerLink)}
    defaults = EvaluatorConfig(
        dataset=config.dataset,
        worlds=config.worlds,
        planner=choice.name if starts else "planner",
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
            ros = replace(config.ros, remap=(*config.ros.remap, *file.remappings()))
            node = nodes.planner(choice, replace(config, ros=ros))
            if node.parameters:
                clock = {"use_sim_time": file.sim_time}
                node = replace(node, parameters={**node.parameters, **clock})
            logs = request.out / LOGS
            with convert_os_errors(ConfigError, logs):
                logs.mkdir(parents=True, exist_ok=True)
            command = node.write_parameters(logs)
            log = logs / "planner.log"
            stack.callback(SupervisedProcess("planner", command, os.environ, log).stop)
        evaluator.main([], defaults)
    return read_results(request.out)
