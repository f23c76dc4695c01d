"""`barn reproduce`, `bench` and `info`: the suite itself."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from barn_eval.api import suite
from barn_eval.commands.options import (
    FILE,
    FOLDER,
    json_option,
    notes,
    say,
    settings_option,
    tell,
)
from barn_eval.commands.tables import table
from barn_eval.results.provenance import provenance
from barn_eval.studies.bench import changes, read_figures
from barn_eval.studies.reproduction.findings import ReproduceConfig


@click.command("reproduce")
@click.option(
    "--quick",
    is_flag=True,
    help="Part of the worlds, spread over their order by difficulty; minutes.",
)
@click.option(
    "--out",
    type=FOLDER,
    help="Folder of trials and page [default: out/results, or out/results_quick].",
)
@settings_option("--set", "settings", "What is run", ReproduceConfig())
@click.option(
    "--workers",
    type=click.IntRange(0),
    default=0,
    show_default=False,
    help="Trials at a time [default: as processors].",
)
@click.option("--docs", type=FOLDER, help="Write the page into this folder as well.")
def reproduce(**options: Any) -> None:
    """Run the paper's 3000 trials and write all of it up.

    OUT/results.md has Table II, times, failures, Fig. 6 and losses beside the published numbers,
    OUT/results.json every number. The same command goes on where it was interrupted, in OUT/campaign,
    and when all is done writes the same bytes again.
    """
    say(*suite.reproduce(**options))


@click.command("bench")
@click.option(
    "--planners", default="dwa,eband", help="Planners to measure, joined by commas."
)
@settings_option("--set", "settings", "What is measured", suite.BenchSetup())
@click.option(
    "--against",
    type=FILE,
    help="Earlier result of --json from this machine: print how many times as good figures are.",
)
@json_option
def bench(
    planners: str, settings: dict[str, Any], against: Path | None, as_json: bool
) -> None:
    """Measure the speed of the suite on this machine, as ratios that can be followed over time.

    A figure that has become worse by more than its noise is called slower; the exit code stays 0.
    """
    before = read_figures(against) if against is not None else []
    names = [name.strip() for name in planners.split(",")]
    with notes.status("measuring") as status:
        figures = list(suite.bench(names, settings, note=status.update))
    about = provenance()
    compared = changes(figures, before)
    for change in compared:
        if change.slower:
            say(
                f"slower: {change.name}, {change.ratio:.2f} ± {change.noise:.2f} times as good as before"
            )
    changed = [{**asdict(one), "slower": one.slower} for one in compared]
    content = {
        "schema_version": 1,
        "figures": list(map(asdict, figures)),
        "changes": changed,
        **about,
    }
    ratios = {
        one.name: (f"{one.ratio:.2f} ± {one.noise:.2f}", "slower" if one.slower else "")
        for one in compared
    }
    rows = [
        (one.name, f"{one.value:.3g}", one.unit, *ratios.get(one.name, ("", "")))
        for one in figures
    ]
    title = f"{about['machine']['processor']}, {about['machine']['cores']} cores"
    tell(
        as_json,
        content,
        table(("figure", ">value", "unit", ">times as good", ""), rows, title=title),
    )


@click.command("info")
@json_option
def info(as_json: bool) -> None:
    """Show what is installed, which ROS there is, and which optional parts are off and why."""
    content = suite.info()
    number, plus, changes = content["commit"].partition(
        "+"
    )  # in the length that fits a terminal; --json has all
    installed = [
        *content["versions"].items(),
        ("commit", number[:12] + plus + changes or "not known"),
    ]
    parts = [
        (suite.OPTIONAL[name][0], state) for name, state in content["optional"].items()
    ]
    ros = content["ros"].items()
    folders = {
        name: value.split(":") if name.endswith("_PATH") else [value]
        for name, value in ros
    }
    parts += [
        (name, one[0] or "not set" if len(one) == 1 else f"{len(one)} folders")
        for name, one in folders.items()
    ]
    parts.append(
        (
            "machine",
            f"{content['machine']['processor']}, {content['machine']['cores']} cores",
        )
    )
    parts += [
        ("planners", ", ".join(content["planners"])),
        ("data sets", ", ".join(content["data_sets"])),
    ]
    tell(
        as_json,
        content,
        table(("installed", "version"), installed),
        table(("part", "state"), parts),
    )
