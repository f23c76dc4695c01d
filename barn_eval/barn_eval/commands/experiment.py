"""What `barn run`, `barn campaign` and `barn demo` have in common: options, and carrying out what they ask for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import click

from barn_eval.commands.options import FOLDER, SEED, console, json_option, notes, parse_settings, print_json, say
from barn_eval.commands.tables import table
from barn_eval.commands.watch import viewed
from barn_eval.experiments.ros_config import BAGS, ENGINES, MODES, RESTARTS

if TYPE_CHECKING:
    from barn_eval.experiments.request import Request
    from barn_eval.experiments.run import Plan
    from barn_eval.trials.result import TrialResult

Command = TypeVar("Command", bound=Callable[..., Any])

NOT_SCORED = 3  # the exit code


def experiment_options(**defaults: str) -> Callable[[Command], Command]:
    """Return a decorator that gives a command the options of an experiment; those not given are None.

    defaults: what the help says that a command does without an option, in place of what is said here.
    """

    def about(name: str, text: str, default: str = "") -> str:
        default = defaults.get(name, default)
        return f"{text} [default: {default}]." if default else f"{text}."

    options = (
        click.option("--dataset", help=about("dataset", "Data set: a name, folder or file", "barn300")),
        click.option("--worlds", help=about("worlds", "Which worlds: 0, 0-49, 0:300:6, 1,4,7-9 or all", "all")),
        click.option(
            "--protocol",
            help=about("protocol", "challenge, dynabarn, known_map, paper2020 or a YAML file", "challenge"),
        ),
        click.option("--robot", help=about("robot", "A name (see barn robots list) or a YAML file", "jackal")),
        click.option(
            "--repetitions", type=click.IntRange(1, 99), help=about("repetitions", "Trials per world and planner", "1")
        ),
        click.option("--seed", type=SEED, help=about("seed", "Seed of everything random", "0")),
        click.option("--sim", "sim_settings", multiple=True, metavar="KEY=VALUE", help="Of the simulator; repeatable."),
        click.option("--mode", type=click.Choice(MODES), help=about("mode", "One process or ROS nodes", "direct")),
        click.option(
            "--planner-command",
            multiple=True,
            metavar="[NAME=]COMMAND",
            help="Start a planner of your own (mode ros) [default name: of its script]; repeatable.",
        ),
        click.option("--ros", "ros_settings", multiple=True, metavar="KEY=VALUE", help="Of mode ros; repeatable."),
        click.option("--restart-planner", type=click.Choice(RESTARTS), help="Same as --ros restart_planner=..."),
        click.option("--bags", type=click.Choice(BAGS), help=about("bags", "Which trials are recorded", "none")),
        click.option("--pictures/--no-pictures", default=None, help=about("pictures", "Draw each trial", "no")),
        click.option("--workers", type=click.IntRange(0), help=about("workers", "Trials at a time", "as processors")),
        click.option(
            "--engine", type=click.Choice(ENGINES), help="Workers here, of a cluster, or none [default: local]."
        ),
        click.option("--address", help="Address of the Ray cluster; without, Ray is started on this machine."),
        click.option(
            "--trial-limit",
            "trial_limit_s",
            type=float,
            help=about("trial_limit_s", "Wall-clock seconds a trial may take, 0 for any", "600"),
        ),
        click.option("--attempts", type=int, help="Attempts at a trial whose worker is lost [default: 3]."),
        click.option("--out", type=FOLDER, help=about("out", "Folder of the results")),
        click.option("--view", is_flag=True, help="Serve the trials to Foxglove, and a page, as they run; needs bags."),
        click.option("--overwrite", is_flag=True, help="Remove other results from that folder first."),
        click.option("--dry-run", is_flag=True, help="Say what would run, how long and how large; run nothing."),
        json_option,
    )

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def options_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of an experiment as a request takes them; ConfigError for a setting that is not key=value."""
    found = {key: value for key, value in values.items() if value not in (None, ())}
    simulator = parse_settings(found.pop("sim_settings", ()), "--sim")
    ros = parse_settings(found.pop("ros_settings", ()), "--ros")
    if restart := found.pop("restart_planner", None):
        ros["restart_planner"] = restart
    return found | ({"simulator": simulator} if simulator else {}) | ({"ros": ros} if ros else {})


def carry_out(
    request: Request, *, overwrite: bool, dry_run: bool, as_json: bool, view: bool = False
) -> list[TrialResult] | None:
    """Run an experiment and return its results; with `dry_run`, print what it would do and return None.

    view: serve it to those who watch, from a process beside it.
    """
    from barn_eval.api import run_request  # noqa: PLC0415 (worlds and their kernels)
    from barn_eval.experiments.run import plan_experiment  # noqa: PLC0415

    if dry_run:
        found = plan_experiment(request, overwrite=overwrite)
        print_json(asdict(found)) if as_json else console.print(_plan_table(found))
        return None
    try:
        with viewed(request.out, request.experiment.bags) if view else nullcontext():
            return run_request(request, notes, overwrite=overwrite)
    except KeyboardInterrupt:
        say(f"stopped; finished trials are in {request.out}, the same command resumes")
        raise


def exit_code(results: Sequence[TrialResult]) -> int:
    """Return 0, or NOT_SCORED where trials failed by no fault of the planner."""
    return 0 if all(result.counts for result in results) else NOT_SCORED


def _plan_table(found: Plan) -> Any:
    worlds = ", ".join(map(str, found.worlds[:12])) + (", ..." if len(found.worlds) > 12 else "")
    rows = (
        ("worlds", f"{len(found.worlds)}: {worlds}"),
        ("planners", ", ".join(found.planners)),
        ("trials per world and planner", str(found.repetitions)),
        ("mode, workers", f"{found.mode}, {found.workers}"),
        ("there already", str(found.there)),
        ("time", f"about {_duration(found.wall_s)}"),
        ("disk", f"about {found.disk_bytes / 1e6:.0f} MB"),
    )
    title = f"{found.trials - found.there} of {found.trials} trials to run, in {found.out}"
    return table(("dry run", ""), rows, title=title, caption=f"estimated from {found.basis}")


def _duration(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
