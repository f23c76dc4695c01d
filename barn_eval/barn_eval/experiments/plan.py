"""What running an experiment would do, and about how long it would take, without doing it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from barn_eval.experiments.folder import results_there
from barn_eval.experiments.request import Request
from barn_eval.experiments.run_file import RunFile
from barn_eval.experiments.store import BAGS
from barn_eval.trials.result import TrialResult

# Where the folder has no trials yet: means of 60 trials of the suite's planners in barn300, on a 2 GHz core.
SIMULATED_S = 22.0
TRIAL_S = {"direct": 2.0, "ros": 5.0}  # in lockstep, without the first compilation of kernels
BAG_BYTES, PICTURE_BYTES, ROW_BYTES = 1_200_000, 80_000, 3_000


@dataclass(frozen=True)
class Plan:
    """What running an experiment would do.

    there: trials that have a result already. wall_s, disk_bytes: what the others take, bags at most; basis: what these
    are estimated from.
    """

    out: str
    mode: str
    worlds: tuple[int, ...]
    planners: tuple[str, ...]
    repetitions: int
    workers: int
    trials: int
    there: int
    wall_s: float
    disk_bytes: int
    basis: str


def plan(request: Request, *, overwrite: bool = False) -> Plan:
    """Return what a request would do; BarnError in one line where it would be refused. Nothing is written."""
    experiment, execution = request.experiment, request.execution
    experiment.check()
    specs = experiment.trials()
    checksums = {spec.index: spec.world.checksum for spec in specs}
    there = results_there(RunFile.of(request.out, experiment, checksums), specs, overwrite=overwrite)
    left = len(specs) - len(there)
    trial_s = _trial_s(request, there)
    bag_bytes = _bag_bytes(request.out, there) if experiment.bags != "none" else 0.0
    each_bytes = ROW_BYTES + bag_bytes + (PICTURE_BYTES if execution.pictures else 0)
    basis = f"{len(there)} trials in the folder" if there else "means of the suite's planners in barn300"
    return Plan(
        out=str(request.out),
        mode=experiment.mode,
        worlds=tuple(checksums),
        planners=tuple(one.name for one in experiment.planners),
        repetitions=experiment.repetitions,
        workers=execution.processes,
        trials=len(specs),
        there=len(there),
        wall_s=left * trial_s / min(execution.processes, max(left, 1)),
        disk_bytes=round(left * each_bytes),
        basis=basis,
    )


def _trial_s(request: Request, there: Sequence[TrialResult]) -> float:
    if there:
        return fmean(result.wall_clock.duration_s for result in there)
    setup = request.experiment.ros
    if request.experiment.mode == "ros" and not setup.lockstep and setup.real_time_factor:
        return SIMULATED_S / setup.real_time_factor
    return TRIAL_S[request.experiment.mode]


def _bag_bytes(out: Path, there: Sequence[TrialResult]) -> float:
    kept = [folder for result in there if (folder := out / BAGS / result.trial_id).is_dir()]
    sizes = [sum(file.stat().st_size for file in folder.iterdir()) for folder in kept]
    return fmean(sizes) if sizes else BAG_BYTES
