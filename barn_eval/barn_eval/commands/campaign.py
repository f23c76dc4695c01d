"""`barn campaign`: many trials of several planners on many workers, resumed where they stopped."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import click

from barn_eval.analysis.summary import summarise_campaign
from barn_eval.analysis.tables import comparison_table, summary_table
from barn_eval.commands.options import console, json_option, notes, parse_settings, print_json, rich_table
from barn_eval.experiments.config import ENGINES, read_campaign
from barn_eval.experiments.ros_config import BAGS, RESTARTS
from barn_eval.experiments.run import run_campaign
from barn_eval.experiments.runs import MODES
from barn_worlds.errors import ConfigError


@click.command()
@click.argument("file", required=False, type=click.Path(path_type=Path, dir_okay=False))
@click.option("--dataset", help="Data set: a name, folder or file [default: barn300].")
@click.option("--worlds", help="Which worlds: 0, 0-49, 0:300:6, 1,4,7-9 or all [default: all].")
@click.option("--planners", help="Planners, as NAME or NAME:PRESET, joined by commas [default: dwa].")
@click.option("--set", "settings", multiple=True, metavar="PLANNER.KEY=VALUE", help="A planner parameter; repeatable.")
@click.option("--sim", "sim_settings", multiple=True, metavar="KEY=VALUE", help="A simulator parameter; repeatable.")
@click.option("--repetitions", type=int, help="Trials per world and planner [default: 5].")
@click.option("--protocol", help="paper, challenge or a YAML file [default: paper].")
@click.option("--seed", type=int, help="Seed of the campaign [default: 0].")
@click.option("--mode", type=click.Choice(MODES), help="One process or ROS nodes [default: direct].")
@click.option("--planner-command", help="Start this instead of our planner node (mode ros).")
@click.option("--restart-planner", type=click.Choice(RESTARTS), help="When to start it afresh [default: on_fault].")
@click.option("--bags", type=click.Choice(BAGS), help="Which trials are recorded [default: none].")
@click.option("--engine", type=click.Choice(ENGINES), help="This machine or a cluster [default: local].")
@click.option("--address", help="Address of the Ray cluster; without, Ray is started on this machine.")
@click.option("--workers", type=int, help="Trials at a time [default: one per processor].")
@click.option("--trial-limit", "trial_limit_s", type=float, help="Wall-clock seconds a trial may take [default: 600].")
@click.option("--attempts", type=int, help="Attempts at a trial whose worker is lost [default: 3].")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder of the results.")
@json_option
def campaign(
    file: Path | None,
    settings: tuple[str, ...],
    sim_settings: tuple[str, ...],
    restart_planner: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Run a campaign, given by options, or by FILE (YAML) with options that count instead of what it says.

    The same command goes on with a campaign that was interrupted. Results go to OUT/results.jsonl one by one, and to
    OUT/results.parquet and .csv at the end.
    """
    asked = read_campaign(
        file,
        options
        | {"simulator": parse_settings(sim_settings, "--sim") or None}
        | {"ros": {"restart_planner": restart_planner} if restart_planner else None}
        | {"settings": _by_planner(parse_settings(settings, "--set")) or None},
    )
    with _interrupted_by_sigterm():
        try:
            results = run_campaign(asked, notes)
        except KeyboardInterrupt:
            notes.print(f"stopped; finished trials are in {asked.out}, the same command goes on", markup=False)
            raise
    found = summarise_campaign(results)
    if as_json:
        print_json(found.as_json())
        return
    for made in (summary_table(found.planners), *map(comparison_table, found.comparisons)):
        console.print(rich_table(made))
    notes.print(f"tables in {asked.out}", markup=False, soft_wrap=True)


def _by_planner(settings: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return parameters "planner.name" by planner."""
    overrides: dict[str, dict[str, Any]] = {}
    for name, value in settings.items():
        planner, dot, parameter = name.partition(".")
        if not dot:
            raise ConfigError(f"--set {name!r}: must be PLANNER.KEY=VALUE")
        overrides.setdefault(planner, {})[parameter] = value
    return overrides


@contextmanager
def _interrupted_by_sigterm() -> Iterator[None]:
    """Let SIGTERM, which batch systems send, stop a campaign as Ctrl-C does."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
