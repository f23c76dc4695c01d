"""Running experiments from Python, as `barn run` does."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, Literal, ParamSpec

import pandas as pd
from rich.console import Console

from barn_eval.analysis.leaderboard import make_sweep_board, sweep_rows
from barn_eval.api.results import Results
from barn_eval.ros.work import run_request
from barn_eval.running.planner_objects import LivePlanner, Planners, split_planners
from barn_eval.running.request import Given, Values, read_request
from barn_eval.running.run import Plan, plan_experiment
from barn_eval.running.sweep import Sweep, grid
from barn_eval.trials.protocol import Protocol
from barn_worlds.base.errors import ConfigError, format_value
from barn_worlds.robots.robot import Robot
from barn_worlds.worlds.world import World

P = ParamSpec("P")

Worlds = str | int | World | Iterable[int] | Iterable[World] | Mapping[int, World]
Settings = Mapping[str, object]


def run(
    worlds: Worlds | None = None,
    planners: Planners | None = None,
    protocol: str | Path | Protocol | None = None,
    *,
    file: str | Path | None = None,
    dataset: str | Path | None = None,
    robot: str | Path | Robot | None = None,
    course: Sequence[float] | None = None,
    repetitions: int | None = None,
    seed: int | None = None,
    settings: Settings | None = None,
    compute: Literal["declared", "measured"] | None = None,
    simulator: Settings | None = None,
    mode: Literal["direct", "ros"] | None = None,
    planner_command: str | Sequence[str] | None = None,
    ros: Settings | None = None,
    bags: Literal["all", "failed", "none"] | None = None,
    workers: int | None = None,
    engine: Literal["local", "ray", "inline"] | None = None,
    address: str | None = None,
    trial_limit_s: float | None = None,
    attempts: int | None = None,
    losses: int | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: bool = True,
) -> Results:
    """Run an experiment, or what is still missing of it, and return its results.

    For instance, with a function as one of two planners:

        def my_planner(observation, task):               # or of the observation alone
            return 0.5, 0.0                              # m/s forward, rad/s to the left
        results = barn.run(worlds="0:300:60", planners=["gap", my_planner], protocol="challenge", workers=2)

    Args:
        worlds: Which of the data set: a number, several, or a text such as "0-49", "0:300:60", "1,4,7-9", "all"
            (default). Or a `World`, several, numbered from 0, or a mapping of numbers to them, kept with the results.
        planners: One or several, each a name ("dwa", or "eband:challenge" with a preset), a `PlannerChoice`, a planner
            class (made anew for each trial), an object of one (which drives them all), or a function that returns
            (m/s, rad/s), a `Velocity2D`, or None for no command; or a mapping of names to these. Default: "dwa".
        protocol: "challenge" (default), "challenge_2022", "challenge_2022_03", "dynabarn", "known_map", "paper2020", a
            YAML file or a `Protocol`.
        file: A YAML file that says all this; arguments count in place of what it says.
        dataset: A name ("barn300" is the default), a folder or a file of worlds.
        robot: A name ("jackal" is the default), a YAML file or a `Robot`.
        course: Start x, y, yaw and goal x, y of every world [m, rad], in place of its own or the protocol's.
        repetitions: Trials per world and planner, 1 to 99. Default: 1.
        seed: Seed that all others come from; equal seeds give equal trials. Default: 0.
        settings: Parameters by planner, as {"dwa": {"dwa.max_speed_mps": 0.4}}.
        compute: What trials charge for computing: what planners declare ("declared", the default) or what is measured.
        simulator: Parameters of the simulator by dotted name.
        mode: "direct" (default), all in one process, or "ros", nodes of ROS 2.
        planner_command: In mode ros, the command that starts a planner of one's own, or several "NAME=COMMAND".
        ros: Settings of mode ros by dotted name.
        bags: Which trials keep a bag. Default: "none".
        workers: Trials at a time; 0 (default) is one per processor.
        engine: What runs the trials: workers here ("local", the default), a Ray cluster, or this process ("inline").
        address: Address of the Ray cluster; without, Ray is started on this machine.
        trial_limit_s: Wall-clock time after which a trial is given up [s], 0 for never. Default: 600.
        attempts: Attempts at a trial whose worker dies or exceeds that time. Default: 3.
        losses: Trials lost one after the other before it stops. Default: 20.
        out: Folder of the results; with the same one, what was interrupted is resumed. Default: a new one under out/.
        overwrite: Replace other results there.
        progress: Show how far it is, on standard error.

    Returns:
        The results, also of trials that were there before.

    Raises:
        BarnError: Something is not possible as it was asked for; one line says what.
    """
    options, live = _options(dict(locals()))
    run_request(
        request := read_request(*options),
        Console(stderr=True, quiet=not progress),
        live,
        overwrite=overwrite,
    )
    return Results(request.out, live)


def _given(*args: object, **kwargs: object) -> dict[str, Any]:
    """Return the arguments of a call of `run`, with its defaults."""
    given = inspect.signature(run).bind(*args, **kwargs)
    given.apply_defaults()
    return given.arguments


def _plan_of(call: Callable[P, Results]) -> Callable[P, Plan]:
    """Return the function that says what a call of `run` would do."""

    @wraps(call)
    def plan(*args: P.args, **kwargs: P.kwargs) -> Plan:
        given = _given(*args, **kwargs)
        return plan_experiment(
            read_request(*_options(given)[0]), overwrite=given["overwrite"]
        )

    plan.__doc__ = """Return what `run` would do with the same arguments, and about how long it would take.

    Nothing is written. Its fields are those of `barn_eval.running.run.Plan`.

    Raises:
        BarnError: Something is not possible as it was asked for; one line says what.
    """
    return plan


plan = _plan_of(run)


def _sweep_of(
    call: Callable[P, Results],
) -> Callable[Concatenate[Sweep, P], pd.DataFrame]:
    """Return the function that calls `run` for each of several settings."""

    @wraps(call)
    def sweep(parameters: Sweep, /, *args: P.args, **kwargs: P.kwargs) -> pd.DataFrame:
        given = _given(*args, **kwargs)
        options, live = _options(given)
        made, console = (
            grid(parameters, *options),
            Console(stderr=True, quiet=not given["progress"]),
        )
        for setting in made:
            setting.write_files()
            run_request(setting.request, console, live, overwrite=given["overwrite"])
        return pd.DataFrame(sweep_rows(make_sweep_board(made[0].request.out.parent)))

    sweep.__doc__ = """Run every combination of values of a planner's parameters, and return them, best first.

    Each setting has a folder of its own below `out`.

    Args:
        parameters: Values by parameter, as {"dwa.path_weight": [0.3, 0.6, 1.2]}; of the only planner.
            {"latency": [0, 0.1, 0.3]} is the delay in s of the commands of all planners.
        {of_run}

    Returns:
        A row per setting: rank, `level_with_best` (not clearly worse than the best), a column per parameter, the metric
        and other figures with their 95 % intervals, and its folder.

    Raises:
        BarnError: Something is not possible as it was asked for; one line says what.
    """.replace(
        "{of_run}",
        (call.__doc__ or "").partition("Args:")[2].partition("\n\n")[0].strip(),
    )
    signature = inspect.signature(call)
    first = inspect.Parameter(
        "parameters", inspect.Parameter.POSITIONAL_ONLY, annotation=Sweep
    )
    sweep.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[first, *signature.parameters.values()],
        return_annotation=pd.DataFrame,
    )
    return sweep


sweep = _sweep_of(run)


def _options(
    arguments: Values,
) -> tuple[tuple[Path | None, Values, Values | None, Given], dict[str, LivePlanner]]:
    """Return the arguments of `read_request` for those of `run`, and the planners that are Python objects."""
    given = {
        name: value
        for name, value in arguments.items()
        if name not in ("overwrite", "progress")
    }
    file, settings, planners = (
        given.pop(name) for name in ("file", "settings", "planners")
    )
    chosen, live = split_planners(planners) if planners is not None else (None, {})
    if live and given["workers"] == 1 and given["engine"] is None:
        given["engine"] = "inline"
    for name in ("dataset", "protocol"):
        given[name] = str(given[name]) if isinstance(given[name], Path) else given[name]
    worlds, given_worlds = given.pop("worlds"), None
    if not (worlds is None or isinstance(worlds, str)):
        worlds, given_worlds = _numbers(worlds)
    options = given | {"worlds": worlds, "planners": chosen}
    return (Path(file) if file else None, options, settings, given_worlds), live


def _numbers(worlds: object) -> tuple[str, dict[int, World] | None]:
    """Return numbers of worlds as a text, and the worlds themselves if it is them that are given."""
    several = [worlds] if isinstance(worlds, int | World) else worlds
    listed = several if isinstance(several, Iterable) else ()
    pairs = list(listed.items() if isinstance(listed, Mapping) else enumerate(listed))
    if pairs and all(
        isinstance(world, World) and isinstance(number, int) for number, world in pairs
    ):
        return "all", dict(pairs)
    if (
        not pairs
        or isinstance(several, Mapping)
        or not all(isinstance(number, int) for _, number in pairs)
    ):
        raise ConfigError(
            f"worlds must be numbers, a text or worlds, got {format_value(worlds)}"
        )
    return ",".join(str(number) for _, number in pairs), None
