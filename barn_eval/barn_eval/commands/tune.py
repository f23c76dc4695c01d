"""`barn tune`: tune a planner's parameters in some worlds, judge them in others."""

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import click

from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.tables import comparison_table
from barn_eval.analysis.text_table import count_noun
from barn_eval.commands.options import (
    PLANNER,
    console,
    count_option,
    folder_option,
    json_option,
    print_json,
    print_notes,
    reporter,
    run_option,
    split_names,
)
from barn_eval.commands.tables import FittedTable, rich_table, table
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError

if TYPE_CHECKING:
    from barn_eval.studies.tune import Tuning


@click.command("tune")
@click.argument("ranges", type=PLANNER)
@count_option(
    "--settings",
    default=30,
    help="Number of settings to try, including the default.",
)
@click.option("--worlds", default="0:300:10", help="Worlds to tune in.")
@click.option(
    "--unseen",
    help="Worlds to judge the best settings in [default: up to 100 other worlds].",
)
@click.option(
    "--planner-command",
    help="Command that starts your own planner. The parameters in its --params-file are tuned.",
)
@click.option(
    "--by",
    default="",
    show_default=False,
    help="Measures to optimize, such as challenge,min_clearance_m.",
)
@run_option
@folder_option(
    "--out",
    default="out/tune",
    help="Folder for all trials. The same command resumes an interrupted tuning run there.",
)
@json_option
def command(
    ranges: str,
    settings: int,
    unseen: str | None,
    by: str,
    run: dict[str, Any],
    as_json: bool,
    **options: Any,
) -> int:
    """Tune parameters within RANGES: a YAML file, or dwa, eband, gap, mppi, nav2_rpp, nav2_dwb or nav2_mppi.

    The command selects settings in some worlds and compares the best setting with the
    default in other worlds. With several measures, it keeps all Pareto-optimal
    settings. It writes their parameter files to OUT.
    """
    # First, so that a missing module does not look like a wrong option.
    if find_spec("optuna") is None:
        raise ConfigError("barn tune needs Optuna: make extras, or pip install optuna")
    # Optuna is an optional extra.
    from barn_eval.studies.tune import Ranges, Tuner  # noqa: PLC0415

    tuner = Tuner(Ranges.read(ranges), options | run, split_names(by), unseen, reporter)
    tuning = tuner.tune(settings)
    if as_json:
        print_json(as_dict(tuning))
        return 0

    settings_text = count_noun(tuning.settings, "setting")
    title = f"{settings_text} in {count_noun(tuning.worlds, 'world')}"
    if tuning.given_up:
        title += f", {tuning.given_up} of them stopped early"
    if not tuning.tuned:
        console.print(f"{title}: none has a better mean than the default")
        return 0
    console.print(_settings_table(tuning, title))
    console.print(
        f"In {count_noun(tuning.unseen, 'world')} that the tuning did not use:"
    )
    for setting in tuning.tuned:
        console.print(setting.verdict)
        console.print(rich_table(comparison_table(setting.unseen)))
        print_notes(*setting.files)
    return 0


def _settings_table(tuning: "Tuning", title: str) -> FittedTable:
    """Return a table of parameters and means, a column per setting, default first."""
    headings = ["parameter", ">default"]
    values = [tuning.default]
    means = [tuning.default_seen]
    for setting in tuning.tuned:
        headings.append(f">setting {setting.number}")
        values.append(setting.values)
        means.append(setting.seen)

    rows = []
    # Parameters first, then what they lead to.
    for key in tuning.default:
        texts = [
            f"{column[key]:.4g}" if isinstance(column[key], float) else str(column[key])
            for column in values
        ]
        rows.append((key, *texts))
    for key in tuning.default_seen:
        measure = MEASURES[key]
        numbers = [measure.number(column[key]) for column in means]
        rows.append((measure.heading, *numbers))
    return table(
        headings,
        rows,
        title=title,
        caption="Settings were selected in these worlds, so these means flatter them.",
    )
