"""`barn run`: trials of one planner, in one process or over ROS."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from barn_eval.commands.experiment import carry_out, experiment_options, options_of
from barn_eval.commands.options import console, parse_settings, print_json, rich_table, say
from barn_worlds.config import as_dict

if TYPE_CHECKING:
    from barn_eval.experiments.request import Request

# What a run does that a campaign does not, unless it is told otherwise.
DEFAULTS = {"bags": "all", "pictures": True, "workers": 1, "trial_limit_s": 0.0}


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
    **options: Any,
) -> None:
    """Run trials of a planner and score them.

    Results go to OUT/results.jsonl one by one, bags to OUT/bags, pictures to OUT/pictures. The same command resumes a
    run that was interrupted.
    """
    from barn_eval.experiments.folder import new_folder  # noqa: PLC0415 (worlds and their kernels)
    from barn_eval.experiments.request import read_request  # noqa: PLC0415

    asked = DEFAULTS | options_of(options)
    asked["out"] = out or new_folder()
    own = {"preset": preset, "overrides": parse_settings(settings, "--set")}
    if planner or preset or settings or not options["planner_command"]:
        asked["planners"] = [{"name": planner or "dwa"} | own]
    carry_out_run(read_request(None, asked), overwrite=overwrite, dry_run=dry_run, as_json=as_json)


def carry_out_run(request: Request, *, overwrite: bool, dry_run: bool, as_json: bool) -> None:
    """Run an experiment of one planner and print all its results."""
    results = carry_out(request, overwrite=overwrite, dry_run=dry_run, as_json=as_json)
    if results is None:
        return
    from barn_eval.analysis.sources import spelling  # noqa: PLC0415
    from barn_eval.analysis.summary import summarise  # noqa: PLC0415 (scipy)
    from barn_eval.analysis.tables import summary_table, trials_table  # noqa: PLC0415

    if as_json:
        print_json({"results": [as_dict(one) for one in results], "summary": summarise(results).scores()})
        return
    experiment = request.experiment
    title = f"{spelling(experiment.planners[0].name)}, {experiment.protocol.name} protocol, {experiment.mode} mode"
    console.print(rich_table(trials_table(results, title)), rich_table(summary_table([summarise(results)])))
    where = [name for name in ("bags", "pictures") if (request.out / name).is_dir()]
    say(", ".join(f"{name} in {request.out / name}" for name in where))
