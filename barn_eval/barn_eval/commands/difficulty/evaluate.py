"""`barn difficulty evaluate`."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from barn_eval import difficulty
from barn_eval.commands.options import FILE, PATH, console, json_option, print_json, say, settings_option
from barn_eval.commands.tables import FittedTable, table
from barn_metrics.model.evaluation import Evaluation, WeightsCheck
from barn_worlds.base.config import as_dict, replace_dotted

SHIPPED = "shipped"


@click.command("evaluate")
@click.argument("source", type=PATH)
@click.option("--weights", type=FILE, help=f"Judge these, a file or {SHIPPED!r}, in place of models trained on folds.")
@click.option(
    "--further",
    multiple=True,
    type=PATH,
    help="Trials in other worlds, a source as SOURCE is; repeatable. Judge models trained on these alone, too.",
)
@click.option(
    "--out", type=FILE, help="Model card to write, .md; of the weights beside it (same name, .npz), if there are any."
)
@settings_option("--set", "settings", "Of judging", difficulty.Judging())
@json_option
def command(
    source: Path,
    weights: Path | None,
    further: tuple[Path, ...],
    out: Path | None,
    settings: dict[str, Any],
    as_json: bool,
) -> None:
    """Judge the model in worlds that it was not trained on, beside ridge regression on the paper's five metrics.

    It is repeated k-fold over the worlds of SOURCE. Worlds of barn_test stay whole: they judge what is trained on
    --further. Errors are in (s/m)^2 with intervals of 95 % over worlds. With --weights these are compared with the
    trials, such as published ones.
    """
    judging = replace_dotted(difficulty.Judging(), settings, "--set")
    if weights is not None:
        if further or out is not None:
            raise click.UsageError("--further and --out are not for --weights")
        given = None if str(weights) == SHIPPED else weights
        found = difficulty.check(source, weights=given, planner=judging.planner, dataset=judging.dataset)
        print_json(as_dict(found)) if as_json else console.print(_check_table(found))
        return
    judged = difficulty.evaluate(source, further=further, card=out, progress=not as_json, **asdict(judging))
    if out is not None:
        say(out)
    if as_json:
        print_json({name: as_dict(part) if part else None for name, part in vars(judged).items()})
        return
    console.print(*(_scores_table(part) for part in (judged.on_folds, judged.trained_elsewhere) if part))


def _check_table(found: WeightsCheck) -> FittedTable:
    rows = (
        ("mean squared error [(s/m)^2]", found.mse.text()),
        ("R2", found.r2.text()),
        ("Spearman", found.spearman.text()),
        ("bias [s/m]", found.bias_s_per_m.text()),
        ("within two standard deviations [%]", f"{100.0 * found.within_two_std:.0f}"),
    )
    return table(("", ">"), rows, title=f"{found.worlds} worlds, {found.trials} trials")


def _scores_table(found: Evaluation) -> FittedTable:
    trained = f"{found.repeats} x {found.folds} folds"
    if found.further_worlds:
        trained = f"trained in {found.further_worlds} others, {found.repeats} x"
    columns = ("model", ">training error", ">held-out error", ">R2", ">Spearman", ">better than ridge by")
    rows = []
    for one in found.scores:
        figures = (one.mse, one.r2, one.spearman, one.gain)
        rows.append((one.name, f"{one.training_mse:.3f}", *("" if it is None else it.text() for it in figures)))
    highest = found.ceiling.reliability
    caption = f"highest R2 that these trials allow, from split halves: {highest.text()}" if highest else ""
    return table(columns, rows, title=f"{found.worlds} worlds: {trained}", caption=caption)
