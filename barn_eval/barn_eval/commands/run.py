"""`barn run`, also called `barn campaign`, and `barn demo`: run trials."""

import shlex
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import click

from barn_eval.analysis.entries import entries_of
from barn_eval.analysis.leaderboard import make_sweep_board, sweep_rows, sweep_table
from barn_eval.analysis.notes import list_notes
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import read_source
from barn_eval.analysis.summary import RunSummary, summarize_run
from barn_eval.analysis.tables import (
    FEWEST_WORLDS,
    comparison_table,
    describe_failures,
    ranked_table,
    summary_table,
    trials_table,
)
from barn_eval.analysis.text_table import count_noun
from barn_eval.analysis.verdict import conclude_ranking
from barn_eval.commands.options import (
    DATASET,
    FILE,
    PLANNER,
    PROTOCOL,
    ROBOT,
    courses_option,
    dataset_option,
    field_option,
    file_option,
    flag_option,
    folder_option,
    help_keys_option,
    json_option,
    make_console_reporter,
    parameters_option,
    print_json,
    print_notes,
    print_output,
    quiet_option,
    reporter,
    verbose_option,
)
from barn_eval.commands.tables import FittedTable, rich_table, table
from barn_eval.ros.isolation import ros_problem
from barn_eval.ros.work import run_request
from barn_eval.running.dry_run import DryRun, estimate_run
from barn_eval.running.reporting import Reporter, format_duration
from barn_eval.running.request import RunRequest, read_request
from barn_eval.running.setting_folders import LATENCY
from barn_eval.running.settings import Setting, grid, read_sweep
from barn_eval.trials.result import Rows, TrialResult, exit_code
from barn_eval.trials.ros_config import MODES, RosConfig
from barn_eval.trials.run_config import ExecutionConfig, RunConfig
from barn_sim.config import SimulatorConfig
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import BarnError, ConfigError
from barn_worlds.datasets.dataset import open_dataset

_RUN = RunConfig()
_EXECUTION = ExecutionConfig()


@click.command("run")
@click.argument("file", required=False, type=FILE)
@click.option(
    "--planners",
    "--planner",
    type=PLANNER,
    help="Planners, separated by commas: NAME, NAME:PRESET or NEW_NAME=NAME:PRESET to use a"
    " planner twice [default: dwa, or the planners of --planner-command].",
)
@field_option(_RUN, "worlds")
@field_option(_RUN, "dataset", kind=DATASET)
@click.option(
    "--protocol",
    type=PROTOCOL,
    help="Protocol: challenge, dynabarn, known_map, paper2020 or a YAML file [default: challenge].",
)
@click.option(
    "--robot",
    type=ROBOT,
    help="Robot: a name (see barn robots) or a YAML file [default: jackal].",
)
@courses_option
@field_option(_RUN, "routes")
@field_option(_RUN, "repetitions")
@field_option(_RUN, "seed")
@field_option(_RUN, "mode")
@click.option(
    "--planner-command",
    multiple=True,
    metavar="[NAME=]COMMAND",
    help="Command that starts your own planner (mode ros); repeatable. {goal_x}, {goal_y}, {goal_yaw} and"
    " {frame} are replaced by the trial's goal [default NAME: the script's name].",
)
@click.option(
    "--planner-package",
    multiple=True,
    metavar="[NAME=]DIR[:EXECUTABLE] [ARGUMENT]...",
    help="Start a planner's executable or launch file from the source of its ROS package,"
    " without building the package; repeatable.",
)
@click.option(
    "--planner-input",
    multiple=True,
    metavar="[NAME=]TEXT",
    help="Text for the planner's standard input, with the placeholders of --planner-command; \\n ends a line.",
)
@parameters_option(
    "--set",
    "settings",
    "Parameter of a planner (barn planners NAME lists them); omit PLANNER if there is only one planner",
    metavar="[PLANNER.]KEY=VALUE",
)
@click.option(
    "--sweep",
    multiple=True,
    metavar="KEY=V1,V2,...",
    help="Run once with each value of a parameter; repeatable, for all combinations of values.",
)
@click.option(
    "--latency",
    metavar="S1,S2,...",
    help="Run each planner with its commands delayed by each of these times [s].",
)
@parameters_option("--sim", "simulator", "Setting of the simulator", SimulatorConfig())
@parameters_option("--ros", "ros", "Setting of mode ros", RosConfig())
@parameters_option(
    "--execution",
    "execution",
    "How trials are executed; only the key compute (declared or measured) changes results",
    _EXECUTION,
)
@field_option(_EXECUTION, "workers", default="one per processor", short="-w")
@field_option(_RUN, "bags")
@folder_option(
    "-o",
    "--out",
    help="Folder for the results [default: a new folder in out/, named after the time].",
)
@file_option(
    "--system",
    help="Judge trials of your own simulator or robot, described in this YAML file. You start the"
    " simulator, and also the planner unless you give --planner or --planner-command.",
)
@flag_option("--view", help="Show trials live in Foxglove and on a page (needs bags).")
@flag_option("--overwrite", help="Delete other results in that folder first.")
@flag_option(
    "--dry-run",
    help="Show what the command would run and estimate time and disk space, without running it.",
)
@flag_option("--all", "show_all", help="Also print each trial and all measures.")
@quiet_option
@verbose_option
@json_option
@help_keys_option
def command(
    file: Path | None,
    sweep: tuple[str, ...],
    latency: str | None,
    system: Path | None,
    overwrite: bool,
    dry_run: bool,
    as_json: bool,
    view: bool,
    show_all: bool,
    quiet: bool,
    verbose: bool,
    **values: Any,
) -> int:
    """Run trials of planners in worlds and score them.

    Describe the run with options, a FILE in YAML, or both. Options override the file.
    To resume an interrupted run, type the same command again. The command writes one
    row per trial to OUT/results.jsonl, the same rows to results.parquet and
    results.csv, and bags.
    """
    run_reporter = make_console_reporter(quiet, verbose)
    # click passes all options; those left out must not replace values of the file.
    options = {
        name: value for name, value in values.items() if value not in (None, (), {})
    }
    if latency and sweep:
        raise click.UsageError("--latency and --sweep cannot be used together")
    if latency:
        # A latency study is a sweep over one key that no planner has.
        sweep = (f"{LATENCY}={latency}",)

    if system is not None:
        has_course = bool(options.keys() & {"course", "simulator"})
        if file or sweep or overwrite or dry_run or view or has_course:
            raise click.UsageError(
                "--system cannot be used with FILE, --sweep, --latency, --overwrite,"
                " --dry-run, --view, --course or --sim"
            )
        return _run_observed(system, options, as_json, show_all)

    request = read_request(file, options)
    # The file may describe a sweep as well.
    parameters = read_sweep(file, sweep)
    if parameters:
        if dry_run or view:
            raise click.UsageError("a sweep cannot be used with --dry-run or --view")
        return _run_settings(
            grid(request, parameters),
            run_reporter,
            overwrite=overwrite,
            as_json=as_json,
        )

    if dry_run:
        estimate = estimate_run(request, overwrite=overwrite)
        print_output(as_json, as_dict(estimate), _dry_run_table(estimate))
        return 0
    return execute(
        request,
        run_reporter,
        overwrite=overwrite,
        as_json=as_json,
        view=view,
        show_all=show_all,
    )


def execute(
    request: RunRequest,
    reporter: Reporter,
    *,
    overwrite: bool,
    as_json: bool,
    view: bool = False,
    show_all: bool = False,
) -> int:
    """Run missing trials, print all results, return the exit code; re-raise Ctrl-C.

    Args:
        request: The run and its folder.
        reporter: Receives notices and progress.
        overwrite: Delete the results of a different run in the same folder.
        as_json: Print JSON instead of tables.
        view: Serve the trials to viewers, from a process beside the run.
        show_all: Print trials, all measures and all pairs of planners as well.
    """
    # The viewer starts before the run, so it shows the first trial.
    viewer: AbstractContextManager[None] = nullcontext()
    if view:
        # Only here: most runs need no reader of bags.
        from barn_eval.commands.watch import serve_view  # noqa: PLC0415

        viewer = serve_view(request.out, request.config.bags)
    try:
        with viewer:
            results = run_request(request, reporter, overwrite=overwrite)
    except KeyboardInterrupt:
        print_notes(
            f"stopped; finished trials are in {request.out}, and the same command"
            " resumes the run"
        )
        raise
    return print_results(request, results, as_json, show_all)


def _run_observed(
    system: Path, options: dict[str, Any], as_json: bool, show_all: bool
) -> int:
    """Judge trials of a system, print all, return exit code; ConfigError if no ROS."""
    problem = ros_problem()
    if problem:
        raise ConfigError(f"--system: {problem}; install ROS 2 for this Python")
    # Only here: trials in one process need no ROS.
    from barn_eval.ros.live import run_observed  # noqa: PLC0415

    starts = bool(options.keys() & {"planners", "planner_command"})
    if not starts:
        options["planner_command"] = ("planner=by hand",)
    request = read_request(None, {"bags": "all"} | options | {"mode": "ros"})
    results = run_observed(
        request,
        system,
        protocol=options.get("protocol", "challenge"),
        robot=options.get("robot", "jackal"),
        starts=starts,
    )
    return print_results(request, results, as_json, show_all)


def _run_settings(
    settings: Sequence[Setting], reporter: Reporter, *, overwrite: bool, as_json: bool
) -> int:
    """Run all settings, print their ranking, and return the exit code."""
    results: list[TrialResult] = []
    for number, setting in enumerate(settings, 1):
        print_notes(f"setting {number} of {len(settings)}: {setting.name}")
        setting.write_parameter_files()
        results += run_request(setting.request, reporter, overwrite=overwrite)

    # Settings are ranked from their folders, with those of earlier sessions.
    folder = settings[0].request.out.parent
    board = make_sweep_board(folder)
    conclusion = conclude_ranking(board.ranking, board.measure)
    print_output(
        as_json,
        {"verdict": conclusion, "settings": sweep_rows(board), "notes": board.notes},
        str(conclusion),
        *board.notes,
        rich_table(sweep_table(board)),
    )
    print_notes(f"settings in {folder}", f"next: barn report {folder}")
    return exit_code(results)


def print_results(
    request: RunRequest, results: Rows, as_json: bool, show_all: bool
) -> int:
    """Print rankings, conclusion and failures, or JSON; return the exit code.

    `show_all` adds a table of trials, all measures and all pairs of planners.
    """
    # A trial that failed through no fault of its planner says nothing about it.
    scored: Rows = []
    notes: list[str] = []
    if any(row.is_scored for row in results):
        source = read_source(request.out, results)
        scored = source.comparable_results
        notes = list_notes(entries_of([source]))
    summary = None
    if scored:
        try:
            summary = summarize_run(scored)
        except BarnError as error:
            # Such as for bags of planners that drove in different worlds.
            notes.append(f"planners cannot be compared: {error}")
    if as_json:
        content: dict[str, Any] = {"planners": [], "comparisons": [], "verdict": ""}
        if summary is not None:
            content = summary.as_json()
        rows = [as_dict(row) for row in results]
        print_json(content | {"results": rows, "notes": notes})
        return exit_code(results)

    lines: list[object] = list(notes)
    if show_all:
        lines.append(rich_table(trials_table(results, _title(request))))
    if summary is not None:
        lines.append(rich_table(ranked_table(summary)))
        if show_all:
            lines.append(rich_table(summary_table(summary.planners)))
            lines += map(rich_table, map(comparison_table, summary.comparisons))
        lines.append(conclude(summary, show_all=show_all))
    lines.append(describe_failures(results))
    print_output(False, None, *filter(None, lines))

    note = f"results in {request.out}"
    bags = request.out / "bags"
    if bags.is_dir():
        note += f", bags in {bags}"
    print_notes(note, f"next: barn report {shlex.quote(str(request.out))}")
    return exit_code(results)


def conclude(summary: RunSummary, *, show_all: bool) -> str:
    """Return a conclusion (if all, how sure); "" for one planner, note below 6 worlds.

    Args:
        summary: The run.
        show_all: Whether to say as well how sure the conclusion is.
    """
    if len(summary.planners) == 1:
        return ""
    worlds = summary.ranking.worlds
    if worlds < FEWEST_WORLDS:
        return (
            f"{count_noun(worlds, 'world')}: too few to compare planners; run at least"
            f" {FEWEST_WORLDS}, or better 20"
        )
    return summary.verdict if show_all else summary.conclusion.short


def _title(request: RunRequest) -> str:
    """Return the title of a run's table: planners, protocol and mode."""
    config = request.config
    names = ", ".join(spelling(planner.name) for planner in config.planners)
    return f"{names}, {config.protocol.name} protocol, {config.mode} mode"


def _dry_run_table(estimate: DryRun) -> FittedTable:
    """Return an estimate of a run as a table for the terminal."""
    worlds = ", ".join(map(str, estimate.worlds[:12]))
    if len(estimate.worlds) > 12:
        worlds += ", ..."
    rows = (
        ("worlds", f"{len(estimate.worlds)}: {worlds}"),
        ("planners", ", ".join(estimate.planners)),
        ("trials per world and planner", str(estimate.repetitions)),
        ("mode, workers", f"{estimate.mode}, {estimate.workers}"),
        ("there already", str(estimate.there)),
        ("time", f"about {format_duration(estimate.wall_s)}"),
        ("disk", f"about {estimate.disk_bytes / 1e6:.0f} MB"),
    )
    missing = estimate.trials - estimate.there
    return table(
        ("dry run", ""),
        rows,
        title=f"{missing} of {estimate.trials} trials to run, in {estimate.out}",
        caption=f"estimated from {estimate.basis}",
    )


# Worlds are numbered by difficulty: percentage of the worlds that are easier.
_DEMO_PERCENTAGES = (5, 40, 70)


@click.command("demo")
@dataset_option(help="Data set to take the three worlds from.")
@click.option(
    "--mode",
    type=click.Choice(MODES),
    default="ros",
    help="Run trials in one process (direct) or with ROS nodes (ros).",
)
@folder_option("--out", default="out/demo", help="Folder for the results.")
@json_option
def demo(dataset: str, mode: Any, out: Path, as_json: bool) -> int:
    """Run DWA in an easy, a medium, and a harder world, and show the scores.

    The trials follow the challenge protocol. In mode ros, simulator, planner and
    evaluator are three ROS 2 nodes in three processes. The demo replaces earlier
    results in the folder.
    """
    # By place in the order, because a data set need not be numbered from 0.
    numbers = open_dataset(dataset).world_numbers
    worlds = ",".join(
        str(numbers[len(numbers) * percentage // 100])
        for percentage in _DEMO_PERCENTAGES
    )
    print_notes(f"worlds {worlds} of {dataset}")
    request = read_request(
        None,
        {
            "dataset": dataset,
            "worlds": worlds,
            "mode": mode,
            "out": out,
            "bags": "all",
            "workers": 1,
            # A slow machine may compile kernels for longer than any limit.
            "trial_limit_s": 0.0,
        },
    )
    return execute(request, reporter, overwrite=True, as_json=as_json)
