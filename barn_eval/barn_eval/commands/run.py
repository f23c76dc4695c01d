"""`barn run`, `barn campaign` and `barn demo`: trials in one process, on many workers or over ROS."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from barn_eval.commands.experiment import carry_out, exit_code, experiment_options, options_of
from barn_eval.commands.options import FILE, FOLDER, SEED, console, json_option, parse_settings, print_json, say
from barn_eval.commands.tables import rich_table
from barn_eval.experiments.ros_config import MODES
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError

if TYPE_CHECKING:
    from barn_eval.experiments.request import Request

# What each does that the other does not, unless it is told otherwise.
RUN_DEFAULTS = {"bags": "all", "pictures": True, "workers": 1, "trial_limit_s": 0.0}
CAMPAIGN_DEFAULTS = {"repetitions": 5}


@click.command()
@click.option("--planner", help="Name of the planner [default: dwa, or that of its command].")
@click.option("--preset", default="", help="Preset of the planner's parameters [default: the protocol's].")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="A planner parameter; repeatable.")
@experiment_options(
    bags="all", pictures="yes", workers="1", trial_limit_s="0", out="a new one under out/, named by the time"
)
def run(
    planner: str | None,
    preset: str,
    settings: tuple[str, ...],
    out: Path | None,
    overwrite: bool,
    dry_run: bool,
    as_json: bool,
    view: bool,
    **options: Any,
) -> int:
    """Run trials of a planner and score them.

    Results go to OUT/results.jsonl one by one, bags to OUT/bags, pictures to OUT/pictures. The same command resumes a
    run that was interrupted.
    """
    from barn_eval.experiments.folder import new_folder  # noqa: PLC0415 (worlds and their kernels)
    from barn_eval.experiments.request import read_request  # noqa: PLC0415

    asked = RUN_DEFAULTS | options_of(options)
    asked["out"] = out or new_folder()
    own = {"preset": preset, "overrides": parse_settings(settings, "--set")}
    if planner or preset or settings or not options["planner_command"]:
        asked["planners"] = [{"name": planner or "dwa"} | own]
    request = read_request(None, asked)
    return carry_out_run(request, overwrite=overwrite, dry_run=dry_run, as_json=as_json, view=view)


def carry_out_run(request: Request, *, overwrite: bool, dry_run: bool, as_json: bool, view: bool = False) -> int:
    """Run an experiment of one planner, print all its results and return the exit code."""
    results = carry_out(request, overwrite=overwrite, dry_run=dry_run, as_json=as_json, view=view)
    if results is None:
        return 0
    scored = [result for result in results if result.counts]
    from barn_eval.analysis.planners import spelling  # noqa: PLC0415
    from barn_eval.analysis.summary import summarise  # noqa: PLC0415 (scipy)
    from barn_eval.analysis.tables import summary_table, trials_table  # noqa: PLC0415

    if as_json:
        summary = summarise(scored).scores() if scored else None
        print_json({"results": [as_dict(one) for one in results], "summary": summary})
        return exit_code(results)
    experiment = request.experiment
    title = f"{spelling(experiment.planners[0].name)}, {experiment.protocol.name} protocol, {experiment.mode} mode"
    console.print(rich_table(trials_table(results, title)))
    if scored:
        console.print(rich_table(summary_table([summarise(scored)])))
    where = [name for name in ("bags", "pictures") if (request.out / name).is_dir()]
    say(", ".join(f"{name} in {request.out / name}" for name in where))
    return exit_code(results)


@click.command()
@click.argument("file", required=False, type=FILE)
@click.option("--planners", help="Planners, as NAME or NAME:PRESET, joined by commas [default: dwa].")
@click.option("--set", "settings", multiple=True, metavar="PLANNER.KEY=VALUE", help="A planner parameter; repeatable.")
@experiment_options(repetitions="5")
def campaign(
    file: Path | None,
    settings: tuple[str, ...],
    overwrite: bool,
    dry_run: bool,
    as_json: bool,
    view: bool,
    **options: Any,
) -> int:
    """Run a campaign, given by options, or by FILE (YAML) with options that count instead of what it says.

    The same command resumes a campaign that was interrupted. Results go to OUT/results.jsonl one by one, and to
    OUT/results.parquet and .csv at the end.
    """
    from barn_eval.experiments.request import read_request  # noqa: PLC0415 (worlds and their kernels)

    by_planner = _by_planner(parse_settings(settings, "--set"))
    request = read_request(file, options_of(options), by_planner, CAMPAIGN_DEFAULTS)
    results = carry_out(request, overwrite=overwrite, dry_run=dry_run, as_json=as_json, view=view)
    if results is None:
        return 0
    from barn_eval.analysis.summary import summarise_campaign  # noqa: PLC0415 (scipy)
    from barn_eval.analysis.tables import comparison_table, summary_table  # noqa: PLC0415

    scored = [result for result in results if result.counts]
    found = summarise_campaign(scored) if scored else None
    if as_json:
        print_json(found.as_json() if found else {"planners": [], "comparisons": [], "verdict": ""})
    if as_json or found is None:
        return exit_code(results)
    console.print(found.verdict, markup=False, highlight=False)
    console.print(*map(rich_table, (summary_table(found.planners), *map(comparison_table, found.comparisons))))
    say(f"tables in {request.out}")
    return exit_code(results)


def _by_planner(settings: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return parameters "planner.name" by planner."""
    overrides: dict[str, dict[str, Any]] = {}
    for name, value in settings.items():
        planner, dot, parameter = name.partition(".")
        if not dot:
            raise ConfigError(f"--set {name!r}: must be PLANNER.KEY=VALUE")
        overrides.setdefault(planner, {})[parameter] = value
    return overrides


@click.command()
@click.option("--dataset", default="barn300", show_default=True, help="Data set that the three worlds are from.")
@click.option("--mode", type=click.Choice(MODES), default="ros", show_default=True, help="One process or ROS nodes.")
@click.option("--seed", default=0, show_default=True, type=SEED, help="Seed of the run.")
@click.option("--out", default="out/demo", show_default=True, type=FOLDER, help="Results.")
@json_option
def demo(dataset: str, mode: str, seed: int, out: Path, as_json: bool) -> int:
    """Drive an easy, a medium and a harder world under DWA with the challenge's protocol, and show the scores.

    Simulator, planner and evaluator are three ROS 2 nodes in processes of their own. Earlier results in the folder are
    replaced.
    """
    from barn_eval.experiments.request import read_request  # noqa: PLC0415 (worlds and their kernels)
    from barn_worlds.worlds.dataset import open_dataset  # noqa: PLC0415

    indices = open_dataset(dataset).indices
    # Worlds are numbered by difficulty, easiest first.
    worlds = ",".join(str(indices[len(indices) * share // 100]) for share in (5, 40, 70))
    say(f"worlds {worlds} of {dataset}")
    asked = {"dataset": dataset, "worlds": worlds, "mode": mode, "seed": seed, "out": out}
    return carry_out_run(read_request(None, RUN_DEFAULTS | asked), overwrite=True, dry_run=False, as_json=as_json)
