"""`barn campaign`: many trials of several planners on many workers, resumed where they stopped."""

from pathlib import Path
from typing import Any

import click

from barn_eval.commands.experiment import carry_out, experiment_options, options_of
from barn_eval.commands.options import FILE, console, parse_settings, print_json, rich_table, say
from barn_worlds.errors import ConfigError

# What a campaign does that a run does not, unless it is told otherwise.
DEFAULTS = {"repetitions": 5}


@click.command()
@click.argument("file", required=False, type=FILE)
@click.option("--planners", help="Planners, as NAME or NAME:PRESET, joined by commas [default: dwa].")
@click.option("--set", "settings", multiple=True, metavar="PLANNER.KEY=VALUE", help="A planner parameter; repeatable.")
@experiment_options(repetitions="5")
def campaign(
    file: Path | None, settings: tuple[str, ...], overwrite: bool, dry_run: bool, as_json: bool, **options: Any
) -> None:
    """Run a campaign, given by options, or by FILE (YAML) with options that count instead of what it says.

    The same command resumes a campaign that was interrupted. Results go to OUT/results.jsonl one by one, and to
    OUT/results.parquet and .csv at the end.
    """
    from barn_eval.experiments.request import read_request  # noqa: PLC0415 (worlds and their kernels)

    by_planner = _by_planner(parse_settings(settings, "--set"))
    request = read_request(file, options_of(options), by_planner, DEFAULTS)
    results = carry_out(request, overwrite=overwrite, dry_run=dry_run, as_json=as_json)
    if results is None:
        return
    from barn_eval.analysis.summary import summarise_campaign  # noqa: PLC0415 (scipy)
    from barn_eval.analysis.tables import comparison_table, summary_table  # noqa: PLC0415

    found = summarise_campaign(results)
    if as_json:
        print_json(found.as_json())
        return
    console.print(found.verdict, markup=False, highlight=False)
    console.print(*map(rich_table, (summary_table(found.planners), *map(comparison_table, found.comparisons))))
    say(f"tables in {request.out}")


def _by_planner(settings: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return parameters "planner.name" by planner."""
    overrides: dict[str, dict[str, Any]] = {}
    for name, value in settings.items():
        planner, dot, parameter = name.partition(".")
        if not dot:
            raise ConfigError(f"--set {name!r}: must be PLANNER.KEY=VALUE")
        overrides.setdefault(planner, {})[parameter] = value
    return overrides
