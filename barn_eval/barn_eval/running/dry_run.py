"""What a run would do, how long it takes and how large its results are."""

from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from barn_eval.results.bags import BAGS
from barn_eval.results.folder import find_completed
from barn_eval.results.run_file import RunFile
from barn_eval.running.request import RunRequest
from barn_eval.running.run import check_limits
from barn_eval.trials.result import Rows
from barn_worlds.base.errors import note

# Estimates for a folder without trials: means of 60 trials of the suite's planners in
# barn300 on a 2 GHz core, in lockstep, without the first compilation of kernels.
SIMULATED_S = 22.0
TRIAL_S = {"direct": 2.0, "ros": 5.0}
BAG_BYTES = 1_200_000
ROW_BYTES = 3_000


@dataclass(frozen=True)
class DryRun:
    """What a run would do, and an estimate of its time and space."""

    out: str
    """Folder of the results."""

    mode: str
    """"direct" or "ros"."""

    worlds: tuple[int, ...]
    """World numbers."""

    planners: tuple[str, ...]
    """Planner names."""

    repetitions: int
    """Trials per world and planner."""

    workers: int
    """Trials at a time."""

    trials: int
    """Number of trials."""

    there: int
    """Number of trials that have a result already."""

    wall_s: float
    """Wall-clock time of the other trials [s]."""

    disk_bytes: int
    """Space that their results take at most."""

    basis: str
    """Source of the two estimates."""


def estimate_run(request: RunRequest, *, overwrite: bool = False) -> DryRun:
    """Return what a run would do, its time and disk space; nothing is run or written.

    Args:
        request: The run and its folder.
        overwrite: Whether the run would delete other results in its folder.

    Raises:
        BarnError: If the run would not start.
    """
    config = request.config
    trials = request.trials()
    warning = check_limits(trials)
    if warning:
        note(warning)
    run_file = RunFile.for_run(request.out, config, trials)
    completed = find_completed(run_file, trials, overwrite=overwrite).results

    remaining = len(trials) - len(completed)
    workers = request.execution.processes
    trial_bytes: float = ROW_BYTES
    if config.bags != "none":
        trial_bytes += _mean_bag_bytes(request.out, completed)
    basis = "means of the suite's planners in barn300"
    if completed:
        basis = f"{len(completed)} trials in the folder"
    return DryRun(
        out=str(request.out),
        mode=config.mode,
        worlds=tuple(dict.fromkeys(spec.world_number for spec in trials)),
        planners=tuple(planner.name for planner in config.planners),
        repetitions=config.repetitions,
        workers=workers,
        trials=len(trials),
        there=len(completed),
        # Fewer trials than workers take as long as one trial.
        wall_s=remaining
        * _mean_trial_s(request, completed)
        / min(workers, max(remaining, 1)),
        disk_bytes=round(remaining * trial_bytes),
        basis=basis,
    )


def _mean_trial_s(request: RunRequest, completed: Rows) -> float:
    """Return the mean wall-clock time of completed trials [s]; if none, an estimate."""
    if completed:
        return fmean(row.wall_clock.duration_s for row in completed)
    ros = request.config.ros
    # Without lockstep, time passes as fast as the user has asked.
    if request.config.mode == "ros" and not ros.lockstep and ros.real_time_factor:
        return SIMULATED_S / ros.real_time_factor
    return TRIAL_S[request.config.mode]


def _mean_bag_bytes(out: Path, completed: Rows) -> float:
    """Return the mean size of completed trials' bags in bytes; if none, an estimate."""
    sizes = []
    for row in completed:
        bag = out / BAGS / row.trial_id
        if bag.is_dir():
            sizes.append(sum(file.stat().st_size for file in bag.iterdir()))
    return fmean(sizes) if sizes else BAG_BYTES
