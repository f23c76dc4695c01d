"""`barn reproduce`, `bench` and `info`: results, speed and state of the suite."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from barn_eval.api import suite
from barn_eval.commands.options import (
    PLANNER,
    file_option,
    flag_option,
    folder_option,
    json_option,
    notes,
    parameters_option,
    path_argument,
    print_notes,
    print_output,
    reporter,
)
from barn_eval.commands.tables import table
from barn_eval.results.provenance import provenance
from barn_eval.studies.bench import changes, read_figures
from barn_eval.studies.reproduction.findings import ReproduceConfig


@click.command("reproduce")
@path_argument("folders", nargs=-1)
@flag_option(
    "--physical",
    help="Instead, plot the difficulty measured in FOLDERS over the model's prediction (Fig. 8).",
)
@flag_option(
    "--quick",
    help="Use only some worlds, from easy to difficult. The run then takes minutes.",
)
@folder_option(
    "--out",
    help="Folder for trials and page [default: out/results, out/results_quick or"
    " out/physical].",
)
@parameters_option("--set", "settings", "Setting of the trials", ReproduceConfig())
@click.option(
    "--workers",
    type=click.IntRange(0),
    default=0,
    show_default=False,
    help="Trials to run at a time [default: one per processor].",
)
@folder_option("--docs", help="Second folder to write the page to.")
def reproduce(folders: tuple[Path, ...], physical: bool, **options: Any) -> None:
    """Run the paper's 3000 trials and write a page of the results.

    OUT/results.md shows Table II, times, failures, Fig. 6, and losses beside the
    published numbers. OUT/results.json contains every number. To resume an interrupted
    run, type the same command again.

    With --physical, FOLDERS hold trials of a robot or another simulator that `barn
    judge` has judged. For comparison, you can add folders of this simulator's trials in
    the same worlds.
    """
    if physical != bool(folders):
        raise click.UsageError("--physical and FOLDERS must be used together")
    if physical:
        out = options["out"] or "out/physical"
        print_notes(suite.reproduce_physical(folders, out))
        return
    print_notes(*suite.reproduce(**options, progress=reporter))


@click.command("bench")
@click.option(
    "--planners",
    type=PLANNER,
    default="dwa,eband",
    help="Planners to measure, separated by commas.",
)
@parameters_option(
    "--set", "settings", "Setting of the measurement", suite.BenchSetup()
)
@file_option(
    "--against",
    help="File with earlier --json output from this machine. The command prints each figure's ratio to it.",
)
@json_option
def bench(
    planners: str, settings: dict[str, Any], against: Path | None, as_json: bool
) -> None:
    """Measure the speed of the suite on this machine and compare it with earlier speeds.

    With --against, the output marks a figure as slower if it is worse by more than its
    noise.
    """
    earlier_figures = read_figures(against) if against is not None else []
    # Empty names stay, so that they are refused.
    names = [name.strip() for name in planners.split(",")]
    # `bench` measures while it is iterated over.
    with notes.status("measuring") as status:
        figures = list(suite.bench(names, settings, note=status.update))
    figure_changes = {
        change.name: change for change in changes(figures, earlier_figures)
    }
    for change in figure_changes.values():
        if change.slower:
            print_notes(
                f"slower: {change.name}, {change.ratio:.2f} ± {change.noise:.2f} times"
                " as good as before"
            )

    rows = []
    for figure in figures:
        ratio = ""
        remark = ""
        if figure.name in figure_changes:
            change = figure_changes[figure.name]
            ratio = f"{change.ratio:.2f} ± {change.noise:.2f}"
            remark = "slower" if change.slower else ""
        rows.append((figure.name, f"{figure.value:.3g}", figure.unit, ratio, remark))
    origin = provenance()
    machine = origin["machine"]
    content = {
        "schema_version": 1,
        "figures": [asdict(figure) for figure in figures],
        "changes": [
            {**asdict(change), "slower": change.slower}
            for change in figure_changes.values()
        ],
        **origin,
    }
    print_output(
        as_json,
        content,
        table(
            ("figure", ">value", "unit", ">times as good", ""),
            rows,
            title=f"{machine['processor']}, {machine['cores']} cores",
        ),
    )


@click.command("info")
@json_option
def info(as_json: bool) -> None:
    """Show what is installed, which ROS is used, and why optional parts are unavailable."""
    content = suite.info()
    # The full hash does not fit a terminal; --json has it. What follows a plus says
    # that files differ from the commit.
    commit, plus, changes_text = content["commit"].partition("+")
    versions = [
        *content["versions"].items(),
        ("commit", commit[:12] + plus + changes_text or "unknown"),
    ]

    parts = [
        (suite.OPTIONAL[name][0], state) for name, state in content["optional"].items()
    ]
    for name, value in content["ros"].items():
        # A path of ROS may have dozens of folders.
        folders = value.split(":") if name.endswith("_PATH") else [value]
        state = value or "not set"
        if len(folders) > 1:
            state = f"{len(folders)} folders"
        parts.append((name, state))
    machine = content["machine"]
    parts += [
        ("machine", f"{machine['processor']}, {machine['cores']} cores"),
        ("planners", ", ".join(content["planners"])),
        ("data sets", ", ".join(content["data_sets"])),
    ]
    print_output(
        as_json,
        content,
        table(("installed", "version"), versions),
        table(("part", "state"), parts),
    )
