"""Made-up trials of the paper's planners in real worlds, and folders of them."""

from dataclasses import replace

import numpy as np
from results.test_rows import result as a_result

from barn_eval.results.folder import ResultsFolder
from barn_eval.results.store import TrialRecord
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.result import Outcome
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.spec import simulator_config


def invent_result(spec):
    """Return the result of a trial that was not driven.

    Slower with filled cells, more so for DWA; some fail.
    """
    generator = np.random.default_rng([spec.simulator_seed, spec.planner_seed])
    steepness = 8.0 if spec.planner == "dwa" else 4.0
    length_m = spec.world.path_length_m
    filled = steepness * float(spec.world.grid.mean())
    time_s = length_m * (1.5 + filled + 0.2 * generator.random())
    fails = generator.random() < 0.1
    protocol = spec.protocol
    scored_s = protocol.failure_time_s if fails else time_s
    result = a_result(spec.world_number)
    scores = replace(
        result.scores,
        success=not fails,
        traversal_time_s=protocol.limit_s if fails else time_s,
        scored_time_s=scored_s,
        path_length_m=length_m,
        normalised_time_s_per_m=scored_s / length_m,
    )
    return replace(
        result,
        trial_id=spec.trial_id,
        dataset=spec.dataset,
        world_checksum=spec.world.checksum,
        planner=spec.planner,
        planner_config=spec.planner_config,
        protocol=protocol.name,
        metric=protocol.metric,
        task=spec.task,
        repetition=spec.repetition,
        simulator_seed=spec.simulator_seed,
        planner_seed=spec.planner_seed,
        outcome=Outcome.TIMEOUT if fails else Outcome.SUCCESS,
        scores=scores,
    )


def experiment_of(worlds, repetitions=3, dataset="barn300"):
    """Return an experiment of both planners."""
    return RunConfig(
        dataset=dataset,
        worlds=worlds,
        planners=(PlannerChoice("dwa"), PlannerChoice("eband")),
        repetitions=repetitions,
        protocol=PAPER_2020,
        simulator=simulator_config(PAPER_2020),
    )


def write_invented(out, experiment, change=lambda result: result):
    """Write a folder of trials that were not driven, and return their results."""
    with ResultsFolder.open(
        out, experiment, ExecutionConfig(), experiment.trials()
    ) as folder:
        for spec in folder.remaining:
            folder.append(TrialRecord(change(invent_result(spec)), None))
        return folder.complete()
