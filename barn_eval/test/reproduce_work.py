"""Made-up trials of the paper's planners in real worlds, and folders of them."""

from dataclasses import replace

import numpy as np
from results.test_rows import result as a_result

from barn_eval.results.folder import ResultsFolder
from barn_eval.results.store import TrialRecord
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.protocol import PAPER_2020
from barn_eval.trials.run_config import ExecutionConfig, PlannerChoice, RunConfig
from barn_eval.trials.spec import simulator_config


def invent_result(spec):
    """Return the result of a trial that was not driven: slower with filled cells, more so for DWA; some fail."""
    generator = np.random.default_rng([spec.simulator_seed, spec.planner_seed])
    steepness = 8.0 if spec.planner == "dwa" else 4.0
    length_m = spec.world.path_length_m
    time_s = length_m * (
        1.5 + steepness * float(spec.world.grid.mean()) + 0.2 * generator.random()
    )
    fails = generator.random() < 0.1
    scored_s = spec.protocol.failure_time_s if fails else time_s
    result = a_result(spec.world_number)
    times = {
        "traversal_time_s": spec.protocol.limit_s if fails else time_s,
        "scored_time_s": scored_s,
    }
    times |= {"path_length_m": length_m, "normalised_time_s_per_m": scored_s / length_m}
    names = (
        "trial_id",
        "dataset",
        "planner",
        "task",
        "planner_config",
        "repetition",
        "simulator_seed",
        "planner_seed",
    )
    of_spec = {name: getattr(spec, name) for name in names} | {
        "world_checksum": spec.world.checksum
    }
    of_spec |= {"protocol": spec.protocol.name, "metric": spec.protocol.metric}
    outcome = Outcome.TIMEOUT if fails else Outcome.SUCCESS
    return replace(
        result,
        **of_spec,
        outcome=outcome,
        scores=replace(result.scores, success=not fails, **times),
    )


def experiment_of(worlds, repetitions=3, dataset="barn300"):
    """Return an experiment of both planners."""
    planners = (PlannerChoice("dwa"), PlannerChoice("eband"))
    rules = {"protocol": PAPER_2020, "simulator": simulator_config(PAPER_2020)}
    return RunConfig(
        dataset=dataset,
        worlds=worlds,
        planners=planners,
        repetitions=repetitions,
        **rules,
    )


def write_invented(out, experiment, change=lambda result: result):
    """Write a folder of trials that were not driven, and return their results."""
    with ResultsFolder.open(
        out, experiment, ExecutionConfig(), experiment.trials()
    ) as folder:
        for spec in folder.remaining:
            folder.append(TrialRecord(change(invent_result(spec)), None))
        return folder.complete()
