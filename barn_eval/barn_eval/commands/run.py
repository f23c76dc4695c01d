"""`barn run`, also called `barn campaign`, and `barn demo`: trials in one process, on workers or over ROS."""

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import click

from barn_eval.analysis.leaderboard import make_sweep_board, sweep_rows, sweep_table
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.summary import summarize, summarize_run
from barn_eval.analysis.tables import comparison_table, summary_table, trials_table
from barn_eval.analysis.verdict import conclude_ranking
from barn_eval.commands.options import (
    FILE,
    FOLDER,
    SEED,
    course_option,
    json_option,
    notes,
    say,
    settings_option,
    tell,
)
from barn_eval.commands.tables import FittedTable, rich_table, table
from barn_eval.commands.watch import viewed
from barn_eval.ros.work import run_request
from barn_eval.running.request import Request, read_request
from barn_eval.running.run import MOST_LINES, Plan, clock, plan_experiment
from barn_eval.running.sweep import LATENCY, Setting, grid, parse_sweep, sweep_of
from barn_eval.trials.outcome import UNDRIVEN_OUTCOMES
from barn_eval.trials.result import Rows
from barn_eval.trials.ros_config import BAGS, MODES, RosConfig
from barn_eval.trials.run_config import ExecutionConfig
from barn_sim.config import SimulatorConfig
from barn_worlds.base.config import as_dict
from barn_worlds.datasets.dataset import open_dataset

NOT_SCORED = 3  # the exit code


@click.command("run")
@click.argument("file", required=False, type=FILE)
@click.option(
    "--planners",
    "--planner",
    help="Planners, as NAME or NAME:PRESET, joined by commas [default: dwa, or of commands].",
)
@click.option(
    "--worlds", help="Which worlds: 0, 0-49, 0:300:6, 1,4,7-9 or all [default: all]."
)
@click.option("--dataset", help="Data set: a name, folder or file [default: barn300].")
@click.option(
    "--protocol",
    help="challenge, dynabarn, known_map, paper2020 or a YAML file [default: challenge].",
)
@click.option(
    "--robot", help="A name (see barn robots) or a YAML file [default: jackal]."
)
@course_option
@click.option(
    "--repetitions",
    type=click.IntRange(1, 99),
    help="Trials per world and planner [default: 1].",
)
@click.option("--seed", type=SEED, help="Seed of everything random [default: 0].")
@click.option(
    "--mode",
    type=click.Choice(MODES),
    help="One process or ROS nodes [default: direct].",
)
@click.option(
    "--planner-command",
    multiple=True,
    metavar="[NAME=]COMMAND",
    help="Start a planner of your own (mode ros) [default name: of its script]; repeatable.",
)
@settings_option(
    "--set",
    "settings",
    "A planner's parameter (barn_planners/README.md lists them), its name without PLANNER where there is one planner",
    metavar="[PLANNER.]KEY=VALUE",
)
@click.option(
    "--sweep",
    multiple=True,
    metavar="KEY=V1,V2,...",
    help="Run each value of a parameter, and all combinations of several; repeatable.",
)
@click.option(
    "--latency",
    metavar="S1,S2,...",
    help="Drive each planner with commands that come so much late, in s.",
)
@settings_option("--sim", "simulator", "Of the simulator", SimulatorConfig())
@settings_option("--ros", "ros", "Of mode ros", RosConfig())
@settings_option(
    "--execution",
    "execution",
    "How it is run, which changes no result but by compute (declared or measured)",
    ExecutionConfig(),
)
@click.option(
    "--workers",
    type=click.IntRange(0),
    help="Trials at a time [default: as processors].",
)
@click.option(
    "--bags", type=click.Choice(BAGS), help="Which trials are recorded [default: none]."
)
@click.option(
    "--out",
    type=FOLDER,
    help="Folder of the results [default: a new one under out/, named by the time].",
)
@click.option(
    "--view",
    is_flag=True,
    help="Serve the trials to Foxglove, and a page, as they run; needs bags.",
)
@click.option(
    "--overwrite", is_flag=True, help="Remove other results from that folder first."
)
@click.option(
    "--dry-run",
    is_flag=True,
    help="Say what would run, how long and how large; run nothing.",
)
@json_option
def command(
    file: Path | None,
    settings: dict[str, Any],
    sweep: tuple[str, ...],
    latency: str | None,
    overwrite: bool,
    dry_run: bool,
    as_json: bool,
    view: bool,
    **options: object,
) -> int:
    """Run trials of one or several planners in worlds and score them.

    They are given by options, or by FILE (YAML) with options that count in place of what it says. The same command
    resumes what was interrupted. Results go to OUT/results.jsonl one by one, and to OUT/results.parquet and .csv at the
    end; bags to OUT/bags.
    """
    given = {
        key: value for key, value in options.items() if value not in (None, (), {})
    }
    if latency and sweep:
        raise click.UsageError("--latency is a sweep of its own, without --sweep")
    if (
        swept := parse_sweep([f"{LATENCY}={latency}"])
        if latency
        else sweep_of(file, sweep)
    ):
        if dry_run or view:
            raise click.UsageError("a sweep is run without --dry-run and --view")
        return _sweep(
            grid(swept, file, given, settings), overwrite=overwrite, as_json=as_json
        )
    request = read_request(file, given, settings)
    if not dry_run:
        return carry_out(request, overwrite=overwrite, as_json=as_json, view=view)
    found = plan_experiment(request, overwrite=overwrite)
    tell(as_json, as_dict(found), _plan_table(found))
    return 0


def carry_out(
    request: Request, *, overwrite: bool, as_json: bool, view: bool = False
) -> int:
    """Run an experiment, print what it says and return the exit code.

    view: serve it to those who watch, from a process beside it.
    """
    try:
        with viewed(request.out, request.experiment.bags) if view else nullcontext():
            results = run_request(request, notes, overwrite=overwrite)
    except KeyboardInterrupt:
        say(f"stopped; finished trials are in {request.out}, the same command resumes")
        raise
    _print(request, results, as_json)
    whole = all(result.is_scored for result in results)
    return (
        0
        if whole and any(result.outcome not in UNDRIVEN_OUTCOMES for result in results)
        else NOT_SCORED
    )


def _sweep(settings: Sequence[Setting], *, overwrite: bool, as_json: bool) -> int:
    """Run one setting after the other and print them in order."""
    for number, setting in enumerate(settings, 1):
        say(f"setting {number} of {len(settings)}: {setting.name}")
        setting.write_files()
        run_request(setting.request, notes, overwrite=overwrite)
    folder = settings[0].request.out.parent
    found = make_sweep_board(folder)
    told = conclude_ranking(found.ranking, found.measure)
    tell(
        as_json,
        {"verdict": told, "settings": sweep_rows(found)},
        str(told),
        rich_table(sweep_table(found)),
    )
    say(f"folders of settings in {folder}; barn report {folder} draws them")
    return 0


def _print(request: Request, results: Rows, as_json: bool) -> None:
    """Print trials unless they are many, what they say together, and where the rest is."""
    scored = [result for result in results if result.is_scored]
    found = summarize_run(scored) if scored else None
    shown: list[object] = []
    if len(results) <= MOST_LINES:
        shown.append(rich_table(trials_table(results, _title(request))))
    if found is not None and found.comparisons:
        tables = (
            summary_table(found.planners),
            *map(comparison_table, found.comparisons),
        )
        shown += [found.verdict, *map(rich_table, tables)]
    elif scored:
        shown.append(rich_table(summary_table([summarize(scored)])))
    said = (
        found.as_json() if found else {"planners": [], "comparisons": [], "verdict": ""}
    )
    tell(as_json, {"results": [as_dict(one) for one in results]} | said, *shown)
    bags = request.out / "bags"
    if not as_json:
        say(f"tables in {request.out}" + (f", bags in {bags}" if bags.is_dir() else ""))


def _title(request: Request) -> str:
    experiment = request.experiment
    names = ", ".join(spelling(one.name) for one in experiment.planners)
    return f"{names}, {experiment.protocol.name} protocol, {experiment.mode} mode"


def _plan_table(found: Plan) -> FittedTable:
    worlds = ", ".join(map(str, found.worlds[:12])) + (
        ", ..." if len(found.worlds) > 12 else ""
    )
    rows = (
        ("worlds", f"{len(found.worlds)}: {worlds}"),
        ("planners", ", ".join(found.planners)),
        ("trials per world and planner", str(found.repetitions)),
        ("mode, workers", f"{found.mode}, {found.workers}"),
        ("there already", str(found.there)),
        ("time", f"about {clock(found.wall_s)}"),
        ("disk", f"about {found.disk_bytes / 1e6:.0f} MB"),
    )
    title = (
        f"{found.trials - found.there} of {found.trials} trials to run, in {found.out}"
    )
    return table(
        ("dry run", ""), rows, title=title, caption=f"estimated from {found.basis}"
    )


SHARES = (
    5,
    40,
    70,
)  # percent of the worlds that are easier; they are numbered by difficulty


@click.command("demo")
@click.option(
    "--dataset", default="barn300", help="Data set that the three worlds are from."
)
@click.option(
    "--mode", type=click.Choice(MODES), default="ros", help="One process or ROS nodes."
)
@click.option("--out", default="out/demo", type=FOLDER, help="Results.")
@json_option
def demo(dataset: str, mode: str, out: Path, as_json: bool) -> int:
    """Drive an easy, a medium and a harder world under DWA with the challenge's protocol, and show the scores.

    Simulator, planner and evaluator are three ROS 2 nodes in processes of their own. Earlier results in the folder are
    replaced.
    """
    indices = open_dataset(dataset).world_numbers
    worlds = ",".join(str(indices[len(indices) * share // 100]) for share in SHARES)
    say(f"worlds {worlds} of {dataset}")
    kept = {"bags": "all", "workers": 1, "trial_limit_s": 0.0}
    request = read_request(
        None, {"dataset": dataset, "worlds": worlds, "mode": mode, "out": out} | kept
    )
    return carry_out(request, overwrite=True, as_json=as_json)
