"""`barn precision`: how many worlds a wanted precision needs."""

from pathlib import Path

import click

from barn_eval.analysis.compare import selected_results
from barn_eval.analysis.precision import figures_table, needs_table, precision, ranking_power, ranking_table
from barn_eval.commands.options import COUNT, PATH, json_option, tell
from barn_eval.commands.tables import rich_table
from barn_eval.trials.identity import task_line
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError

_ABOVE_ZERO = click.FloatRange(0.0, min_open=True)


@click.command("precision")
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option("--half-width", type=_ABOVE_ZERO, help="Half the 95 % interval wanted of a mean [default: 5 % of it].")
@click.option(
    "--difference",
    type=_ABOVE_ZERO,
    help="Difference of two planners to be found 8 times in 10 [default: 5 % of the first one's mean].",
)
@click.option(
    "--measure",
    "measures",
    multiple=True,
    help="A column of the results, with --ranking repeatable [default: the metric of the protocol].",
)
@click.option("--repetitions", type=COUNT, help="Trials per world [default: 1, 2, 3, 5 and 10].")
@click.option("--ranking", is_flag=True, help="Say how many worlds bring planners into the right order; many FOLDERS.")
@json_option
def command(
    folders: tuple[Path, ...],
    half_width: float | None,
    difference: float | None,
    measures: tuple[str, ...],
    repetitions: int | None,
    ranking: bool,
    as_json: bool,
) -> None:
    """Say how many worlds a wanted precision needs, from the results in FOLDERS, one unless --ranking is given.

    FOLDER:PLANNER, or FOLDER:PLANNER,PLANNER, chooses one or two of several planners. Wanted values are in the unit of
    the measure, of success as a share such as 0.05.
    """
    if ranking:
        powers = [one for folder in folders for one in ranking_power(selected_results(folder)[1], measures)]
        tell(as_json, list(map(as_dict, powers)), rich_table(ranking_table(powers)))
        return
    if len(folders) > 1 or len(measures) > 1:
        raise ConfigError("only --ranking takes several folders or measures")
    _, results = selected_results(folders[0])
    found = precision(results, half_width, difference, measure="".join(measures), repetitions=repetitions)
    first = next(iter(results.values()))[0]
    tables = map(rich_table, (figures_table(found), needs_table(found)))
    tell(as_json, as_dict(found), task_line(first.protocol, first.task), *tables)
