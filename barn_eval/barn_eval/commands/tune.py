"""`barn tune`: parameters of a planner chosen by some worlds, and judged in others."""

from importlib.util import find_spec
from typing import Any

import click

from barn_eval.analysis.measures import MEASURES
from barn_eval.analysis.tables import comparison_table
from barn_eval.analysis.text_table import count_noun
from barn_eval.commands.options import (
    COUNT,
    FOLDER,
    console,
    json_option,
    keys_of,
    notes,
    print_json,
    run_option,
    say,
)
from barn_eval.commands.tables import rich_table, table
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import ConfigError

OPTUNA = find_spec("optuna") is not None
if OPTUNA:
    from barn_eval.studies.tune import Ranges, tune


@click.command("tune")
@click.argument("ranges")
@click.option(
    "--settings",
    default=30,
    type=COUNT,
    help="Settings to try, the default among them.",
)
@click.option("--worlds", default="0:300:10", help="Which settings are chosen by.")
@click.option(
    "--unseen", help="Which the best is judged in [default: up to 100 of the others]."
)
@click.option(
    "--planner-command",
    help="Starts a planner of your own, with the --params-file that is tuned.",
)
@click.option(
    "--by",
    default="",
    show_default=False,
    help="Measures, such as challenge,min_clearance_m.",
)
@run_option
@click.option(
    "--out",
    default="out/tune",
    type=FOLDER,
    help="Folder of all that was driven; the same command resumes.",
)
@json_option
def command(
    ranges: str,
    settings: int,
    unseen: str | None,
    by: str,
    run: dict[str, Any],
    as_json: bool,
    **options: object,
) -> int:
    """Tune parameters over RANGES: a YAML file, or those of dwa, eband, gap, mppi, nav2_rpp, nav2_dwb or nav2_mppi.

    Settings are chosen by some worlds, and the best is judged by others that it has not seen, against the default. By
    several measures, those are kept that no other is as good as by each. Parameters ready to use go to OUT.
    """
    if not OPTUNA:
        raise ConfigError("barn tune needs Optuna: make extras, or pip install optuna")
    found = tune(
        Ranges.read(ranges), options | run, unseen, keys_of(by), settings, notes
    )
    if as_json:
        print_json(as_dict(found))
        return 0
    early = f", {found.given_up} of them given up early" if found.given_up else ""
    text = f"{count_noun(found.settings, 'setting')} in {count_noun(found.worlds, 'world')}{early}"
    if not found.tuned:
        console.print(f"{text}: none is better there than the default", highlight=False)
        return 0
    columns = {"default": (found.default, found.default_seen)}
    columns |= {f"setting {one.number}": (one.values, one.seen) for one in found.tuned}
    rows = [
        (key, *(_text(values[key]) for values, _ in columns.values()))
        for key in found.default
    ]
    for measure in (MEASURES[key] for key in found.default_seen):
        rows += [
            (
                measure.heading,
                *(measure.number(seen[measure.key]) for _, seen in columns.values()),
            )
        ]
    heads = ("parameter", *(f">{name}" for name in columns))
    console.print(
        table(
            heads,
            rows,
            title=text,
            caption="Means of these worlds flatter what was chosen by them.",
        )
    )
    console.print(
        f"In {count_noun(found.unseen, 'world')} that no setting was chosen by:",
        highlight=False,
    )
    for one in found.tuned:
        console.print(one.verdict, markup=False, highlight=False)
        console.print(rich_table(comparison_table(one.unseen)))
        say(*one.files)
    return 0


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
