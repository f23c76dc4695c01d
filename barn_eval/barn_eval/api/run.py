"""Runs from Python, as `barn run` executes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import pandas as pd

from barn_eval.analysis.leaderboard import make_sweep_board, sweep_rows
from barn_eval.api.results import Results
from barn_eval.ros.work import run_request
from barn_eval.running.dry_run import DryRun, estimate_run
from barn_eval.running.judge import JudgeOptions
from barn_eval.running.judge import judge as judge_bags
from barn_eval.running.options import RunKeywords, RunOptions, Worlds
from barn_eval.running.planner_objects import Planners
from barn_eval.running.reporting import Reporter, make_reporter
from barn_eval.running.request import RunRequest, read_request
from barn_eval.running.settings import grid
from barn_eval.trials.protocol import Protocol
from barn_worlds.base.config import from_dict
from barn_worlds.base.errors import suggest

if TYPE_CHECKING:
    from typing_extensions import Unpack


@overload
def run(
    worlds: Worlds | None = ...,
    planners: Planners | None = ...,
    protocol: str | Path | Protocol | None = ...,
    *,
    file: str | Path | None = ...,
    dry_run: Literal[False] = ...,
    overwrite: bool = ...,
    progress: bool | Reporter = ...,
    **options: Unpack[RunKeywords],
) -> Results: ...
@overload
def run(
    worlds: Worlds | None = ...,
    planners: Planners | None = ...,
    protocol: str | Path | Protocol | None = ...,
    *,
    file: str | Path | None = ...,
    dry_run: Literal[True],
    overwrite: bool = ...,
    progress: bool | Reporter = ...,
    **options: Unpack[RunKeywords],
) -> DryRun: ...
def run(
    worlds: Worlds | None = None,
    planners: Planners | None = None,
    protocol: str | Path | Protocol | None = None,
    *,
    file: str | Path | None = None,
    dry_run: bool = False,
    overwrite: bool = False,
    progress: bool | Reporter = True,
    **options: Unpack[RunKeywords],
) -> Results | DryRun:
    """Drive the trials that a run's folder still lacks, and return all its results.

    For instance, with a function as one of two planners:

        def my_planner(observation, task):  # or of the observation alone
            return 0.5, 0.0  # m/s forward, rad/s to the left
        results = barn.run("0:300:60", ["gap", my_planner], "challenge", workers=2)

    Args:
        worlds: Worlds of the data set: a number, several, or a text such as "0-49",
            "0:300:60", "1,4,7-9" or "all" (default). Or `World` objects: one, several
            that are numbered from 0, or a mapping of numbers to them. The results
            folder keeps a copy of such objects.
        planners: One planner or several, each a name ("dwa", or "eband:challenge" with
            a preset), a `PlannerChoice`, a planner class (a new instance for each
            trial), an instance (which drives all trials of a worker), or a function
            that returns (m/s, rad/s), a `Velocity2D`, or None for no command. Or a
            mapping of names to these. Default: "dwa".
        protocol: "challenge" (default), "challenge_2022", "challenge_2022_03",
            "dynabarn", "known_map", "paper2020", a YAML file or a `Protocol`.
        file: A YAML file with options; arguments override it.
        dry_run: Return what the run would do; execute and write nothing.
        overwrite: Delete the results of a different run in the same folder.
        progress: Whether to show progress in a terminal or notebook; otherwise it goes
            to the logger `barn_eval`. Or a `Reporter` of your own.
        options: Any option of `RunKeywords`: dataset, robot, course, repetitions, seed,
            settings, compute, simulator, mode, planner_command, ros, bags, workers,
            engine, address, trial_limit_s, attempts, losses, out.

    Returns:
        The results, with those of earlier sessions in the same folder. With `dry_run`,
        a `DryRun`.

    Raises:
        BarnError: If an option or a value is not allowed; one line says which.
    """
    request = _read_request(
        file, {"worlds": worlds, "planners": planners, "protocol": protocol, **options}
    )
    if dry_run:
        return estimate_run(request, overwrite=overwrite)
    # The folder also has the results of earlier sessions.
    run_request(request, make_reporter(progress), overwrite=overwrite)
    return Results(request.out, request.planner_objects)


def sweep(
    parameters: Mapping[str, Sequence[Any]],
    *,
    file: str | Path | None = None,
    overwrite: bool = False,
    progress: bool | Reporter = True,
    **options: Unpack[RunOptions],
) -> pd.DataFrame:
    """Run all combinations of parameter values; return a DataFrame, best first.

    Each combination has a folder of its own below `out`.

    Args:
        parameters: Values by parameter of the only planner, such as
            {"dwa.path_weight": [0.3, 0.6, 1.2]}. {"latency": [0, 0.1, 0.3]} delays the
            commands of all planners [s].
        file: A YAML file with options; arguments override it.
        overwrite: Delete the results of different runs in the same folders.
        progress: As for `run`.
        options: Any argument or option of `run`: worlds, planners, protocol and those
            of `RunKeywords`.

    Returns:
        A row per combination: `level_with_best` (not clearly worse than the best),
        planner, a column per parameter, the columns of `Results.summary`, and its
        folder. For latency, rows are in the order of planners and delays.

    Raises:
        BarnError: If an option or a value is not allowed; one line says which.
    """
    base = _read_request(file, options)
    reporter = make_reporter(progress)
    for setting in grid(base, parameters):
        setting.write_parameter_files()
        run_request(setting.request, reporter, overwrite=overwrite)
    return pd.DataFrame(sweep_rows(make_sweep_board(base.out)))


def _read_request(file: str | Path | None, options: RunOptions) -> RunRequest:
    """Return the request that file and options describe; TypeError for unknown ones."""
    # A wrong keyword is refused before any value, as by any Python function.
    unknown = options.keys() - RunOptions.__annotations__.keys()
    if unknown:
        name = min(unknown)
        hint = suggest(name, RunOptions.__annotations__)
        raise TypeError(f"a run has no option {name!r}{hint}")
    return read_request(Path(file) if file else None, options)


def judge(
    bags: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    course: Sequence[float] = (),
    overwrite: bool = False,
    **options: Any,
) -> Results:
    """Judge trials from bags that others recorded, write results and return them.

    Args:
        bags: One bag or several, of one simulator or robot.
        out: Folder for the results.
        course: Start x, y, yaw and goal x, y in m and rad, instead of those in the bags.
        overwrite: Remove other results from the folder first.
        options: Options of `barn judge` by name, such as `pose="/odom"`.

    Raises:
        BarnError: If a bag cannot be read or an option is wrong.
    """
    if isinstance(bags, str | Path):
        bags = [bags]
    paths = [Path(bag) for bag in bags]
    judge_options = from_dict(JudgeOptions, options, "judge")
    judge_bags(paths, Path(out), judge_options, course, overwrite=overwrite)
    return Results(Path(out))
