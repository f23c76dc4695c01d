"""`barn difficulty evaluate`."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from barn_eval import difficulty
from barn_eval.commands.options import FILE, PATH, console, json_option, print_json, settings_option
from barn_eval.commands.tables import table
from barn_worlds.base.config import as_dict, replace_dotted


@click.command("evaluate")
@click.argument("source", type=PATH)
@click.option("--weights", type=FILE, help="Judge these, a file or 'shipped', in place of models trained on folds.")
@settings_option("--set", "settings", "Of judging", difficulty.Judging())
@json_option
def command(source: Path, weights: Path | None, settings: dict[str, Any], as_json: bool) -> None:
    """Judge the model in worlds that it was not trained on, beside ridge regression on the paper's five metrics.

    It is repeated k-fold over the worlds of SOURCE. Worlds of barn_test are never trained on; they judge --weights.
    Errors are in (s/m)^2 with intervals of 95 % over worlds.
    """
    judging = replace_dotted(difficulty.Judging(), settings, "--set")
    found = difficulty.evaluate(source, weights=weights, progress=not as_json, **asdict(judging))
    if as_json:
        print_json(as_dict(found))
        return
    columns = ("model", ">training error", ">held-out error", ">R2", ">Spearman", ">better than ridge by")
    rows = []
    for one in found.scores:
        figures = (one.mse, one.r2, one.spearman, one.gain)
        rows.append((one.name, f"{one.training_mse:.3f}", *("" if it is None else it.text() for it in figures)))
    caption = f"highest R2 that these trials allow, from split halves: {found.ceiling.text()}" if found.ceiling else ""
    title = f"{found.worlds} worlds, {found.trials} trials: {found.repeats} x {found.folds} folds"
    console.print(table(columns, rows, title=title, caption=caption))
