"""`barn run`: trials of one planner, in one process or over ROS."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from barn_eval.analysis.planner_style import spelling
from barn_eval.analysis.summary import summarise
from barn_eval.analysis.tables import summary_table, trials_table
from barn_eval.commands.options import console, json_option, notes, parse_settings, print_json, rich_table
from barn_eval.experiments.ros_config import RosSetup
from barn_eval.experiments.runs import MODES, RunFolder, RunPlan
from barn_eval.trials.protocol import load_protocol
from barn_eval.trials.result import TrialResult
from barn_eval.trials.spec import simulator_config
from barn_worlds.config import as_dict, replace_dotted


@click.command()
@click.option("--dataset", default="barn300", show_default=True, help="Data set: a name, folder or file.")
@click.option("--worlds", default="all", show_default=True, help="Which worlds: 0, 0-49, 0:300:6, 1,4,7-9 or all.")
@click.option("--planner", default="dwa", show_default=True, help="Name of the planner.")
@click.option("--preset", default="", help="Preset of the planner's parameters [default: the protocol's].")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="A planner parameter; may be repeated.")
@click.option("--sim", "sim_settings", multiple=True, metavar="KEY=VALUE", help="A simulator parameter; likewise.")
@click.option("--protocol", default="paper", show_default=True, help="paper, challenge or a YAML file.")
@click.option("--ros", "ros_settings", multiple=True, metavar="KEY=VALUE", help="A setting of mode ros; likewise.")
@click.option("--mode", type=click.Choice(MODES), default="direct", show_default=True, help="One process or ROS nodes.")
@click.option("--planner-command", default="", help="Start this instead of our planner node (mode ros).")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0, 2**62), help="Seed of the run.")
@click.option("--repetitions", default=1, show_default=True, type=click.IntRange(1, 99), help="Trials per world.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the results [default: a new one under out/, named by the time].",
)
@click.option("--overwrite", is_flag=True, help="Remove an earlier run from that folder first.")
@json_option
def run(
    protocol: str,
    settings: tuple[str, ...],
    sim_settings: tuple[str, ...],
    ros_settings: tuple[str, ...],
    out: Path | None,
    overwrite: bool,
    as_json: bool,
    **plan: Any,
) -> None:
    """Run trials of a planner and score them.

    Results go to OUT/results.jsonl, bags to OUT/bags, pictures to OUT/pictures. A run that was interrupted is
    completed by the same command.
    """
    rules = load_protocol(protocol)
    simulator = simulator_config(rules, parse_settings(sim_settings, "--sim"))
    overrides = parse_settings(settings, "--set")
    ros = replace_dotted(RosSetup(), parse_settings(ros_settings, "--ros"), "--ros")
    made = RunPlan(protocol=rules, simulator=simulator, overrides=overrides, ros=ros, **plan)
    execute(made, out or Path("out") / datetime.now().strftime("run_%Y%m%d_%H%M%S"), overwrite, as_json)


def execute(plan: RunPlan, out: Path, overwrite: bool, as_json: bool) -> None:
    """Run what a plan still lacks and print all its results."""
    total = plan.check()
    folder = RunFolder.create(out, plan, overwrite=overwrite)
    done = len(folder.results())
    if done:
        notes.print(f"{done} of {total} trials are there already")
    if done < total:
        _prepare(plan)
    for result in _run(folder):
        done += 1
        notes.print(f"[{done}/{total}] {result.trial_id}: {_ending(result)}", markup=False, soft_wrap=True)
    results = sorted(folder.results(), key=lambda result: result.trial_id)
    if as_json:
        print_json({"results": [as_dict(one) for one in results], "summary": summarise(results).scores()})
    else:
        title = f"{spelling(plan.planner)}, {plan.protocol.name} protocol, {plan.mode} mode"
        console.print(rich_table(trials_table(results, title)), rich_table(summary_table([summarise(results)])))
        notes.print(f"bags in {out / 'bags'}, pictures in {out / 'pictures'}", markup=False, soft_wrap=True)


def _prepare(plan: RunPlan) -> None:
    from barn_eval.experiments.warm_up import warm_up  # noqa: PLC0415 (loads simulator and planners)

    with notes.status("preparing simulator and planner; the first time their kernels are compiled"):
        warm_up(plan)


def _run(folder: RunFolder) -> Iterator[TrialResult]:
    if folder.plan.mode == "ros":
        from barn_eval.ros.supervision import run_ros_trials  # noqa: PLC0415 (starts processes that other modes do not need)

        return run_ros_trials(folder, lambda line: notes.print(line, markup=False, soft_wrap=True))
    from barn_eval.experiments.direct import run_direct_trials  # noqa: PLC0415 (loads simulator and planners)

    return run_direct_trials(folder)


def _ending(result: TrialResult) -> str:
    if result.scores.success:
        return f"success in {result.scores.traversal_time_s:.2f} s"
    return f"{result.outcome.value} ({result.detail})" if result.detail else result.outcome.value
