"""Running experiments from Python, as `barn run` and `barn campaign` do; these are wrapped around what is here."""

from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from barn_eval.experiments.engine import DirectWork, Work
from barn_eval.experiments.experiment import Execution, Experiment
from barn_eval.experiments.live import LivePlanner, split_planners
from barn_eval.experiments.request import Request, read_request
from barn_eval.experiments.run import Plan, plan_experiment, run_experiment
from barn_eval.experiments.store import Store
from barn_eval.results import Results
from barn_eval.trials.protocol import Protocol
from barn_eval.trials.result import TrialResult

Worlds = str | int | Iterable[int]


def run(
    worlds: Worlds | None = None,
    planners: Any = None,
    protocol: str | Protocol | None = None,
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: bool = True,
    **options: Any,
) -> Results:
    """Run an experiment, or what is still missing of it, and return its results.

    For instance, with a function as one of two planners:

        def my_planner(observation, task):               # or of the observation alone
            return 0.5, 0.0                              # m/s forward, rad/s to the left

        results = barn.run(worlds="0:300:60", planners=["gap", my_planner], protocol="challenge", workers=2)

    Equal seeds give equal trials, however many workers there are. The same call with the same `out` resumes what was
    interrupted.

    - worlds: which of the data set: a number, several, or a text such as "0-49", "0:300:60", "1,4,7-9", "all" (default)
    - planners: one or several, each a name ("dwa", or "eband:challenge" with a preset), a `PlannerChoice`, a planner
      class (made anew for each trial), an object of one (which drives them all), or a function that returns (m/s,
      rad/s), a Velocity2D, or None for no command; or a mapping of names to these
    - protocol: "challenge" (default), "dynabarn", "known_map", "paper2020", a YAML file or a Protocol
    - out: folder of the results [a new one under out/]
    - overwrite: replace other results there
    - progress: show how far it is

    Options go by the names of the command's:

    - file: a campaign's YAML file; arguments count in place of what it says
    - dataset ("barn300"), repetitions (1), seed (0)
    - robot ("jackal"): a name, a YAML file or a Robot
    - settings: parameters by planner, as {"dwa": {"dwa.max_speed_mps": 0.4}}; simulator: parameters by dotted name
    - mode ("direct" or "ros"), planner_command, ros: settings of mode ros
    - bags ("all", "failed", or "none", the default), pictures (False)
    - workers (0: one per processor), trial_limit_s (600, of wall-clock time), attempts (3)
    - engine ("local", "ray", or "inline": in this process), address

    Raises BarnError in one line for what is not possible. Finished trials are kept in any case.
    """
    request, live = asked(worlds, planners, protocol, out, options)
    run_request(request, Console(stderr=True, quiet=not progress), live, overwrite=overwrite)
    return Results(request.out, live)


def plan(
    worlds: Worlds | None = None,
    planners: Any = None,
    protocol: str | Protocol | None = None,
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Plan:
    """Return what `run` would do with the same arguments, and about how long it would take; nothing is written."""
    return plan_experiment(asked(worlds, planners, protocol, out, options)[0], overwrite=overwrite)


def load(folder: str | Path, planners: Any = None) -> Results:
    """Return the results in a folder of `run`, `barn run` or `barn campaign`, finished or not, of any version.

    planners: those that were given as Python objects, should one of their trials have to be driven again for a replay.
    Raises BarnError in one line if there are none.
    """
    return Results(Path(folder), split_planners(planners)[1] if planners is not None else {})


def asked(
    worlds: Worlds | None,
    planners: Any,
    protocol: str | Protocol | None,
    out: str | Path | None,
    options: Mapping[str, Any],
) -> tuple[Request, dict[str, LivePlanner]]:
    """Return what arguments of `run` ask for, and the planners among them that are Python objects."""
    given = dict(options)
    file, settings = given.pop("file", None), given.pop("settings", None)
    chosen, live = split_planners(planners) if planners is not None else (None, {})
    if live and given.get("workers") == 1:
        given.setdefault("engine", "inline")
    if worlds is not None and not isinstance(worlds, str):
        worlds = ",".join(map(str, [worlds] if isinstance(worlds, int) else worlds))
    given |= {"worlds": worlds, "planners": chosen, "protocol": protocol, "out": out}
    return read_request(Path(file) if file else None, given, settings), live


def run_request(
    request: Request, console: Console, live: Mapping[str, LivePlanner] | None = None, *, overwrite: bool = False
) -> list[TrialResult]:
    """Run what an experiment still lacks and return all its results; BarnError in one line for what is not possible.

    live: its planners that are Python objects, by name.
    """
    return run_experiment(request, console, partial(work_of, live=live or {}), overwrite=overwrite)


def work_of(experiment: Experiment, execution: Execution, store: Store, live: Mapping[str, LivePlanner]) -> Work:
    """Return what workers of an experiment are handed."""
    if experiment.mode == "direct":
        return DirectWork(store, live)
    from barn_eval.ros.work import ros_work  # noqa: PLC0415 (needs sockets and locks of POSIX)

    return ros_work(experiment, execution, store)
