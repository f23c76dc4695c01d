"""`barn difficulty evaluate`."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from barn_eval import models
from barn_eval.commands.options import FILE, PATH, console, json_option, print_json, say, settings_option
from barn_eval.commands.tables import FittedTable, table
from barn_metrics.model.evaluation import Evaluation
from barn_metrics.model.scores import WeightsCheck
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
@settings_option("--set", "settings", "Of judging", models.Judging())
@json_option
def command(
    source: Path,
    weights: Path | None,
    further: tuple[Path, ...],
    out: Path | None,
    settings: dict[str, Any],
    as_json: bool,
) -> None:
    """Judge models on worlds that they were not trained on: repeated k-fold over the worlds of SOURCE.

    Worlds of barn_test stay whole: they judge models trained on --further. Errors are in (s/m)^2 with intervals of 95 %
    over worlds. Successful trials are also judged alone. With --weights these are compared with the trials, such as
    published ones.
    """
    judging = replace_dotted(models.Judging(), settings, "--set")
    if weights is not None:
        if further or out is not None:
            raise click.UsageError("--further and --out are not for --weights")
        given = None if str(weights) == SHIPPED else weights
        found = models.check_difficulty(source, weights=given, planner=judging.planner, dataset=judging.dataset)
        print_json(as_dict(found)) if as_json else console.print(_check_table(found))
        return
    options = asdict(judging) | {"recipes": list(filter(None, judging.recipes.split(",")))}
    judged = models.evaluate_difficulty(source, further=further, card=out, progress=not as_json, **options)
    if out is not None:
        say(out)
    if as_json:
        print_json({name: as_dict(part) if part else None for name, part in vars(judged).items()})
        return
    parts = (
        (judged.all_trials, "all trials"),
        (judged.trained_elsewhere, "all trials"),
        (judged.successful_trials, "successful trials alone"),
    )
    console.print(*(_scores_table(part, title) for part, title in parts if part))
    say(*dict.fromkeys(note for part, _ in parts if part for note in part.notes))


def _check_table(found: WeightsCheck) -> FittedTable:
    rows = (
        ("mean squared error [(s/m)^2]", found.mse.text()),
        ("R2", found.r2.text()),
        ("Spearman", found.spearman.text()),
        ("bias [s/m]", found.bias_s_per_m.text()),
        ("within two standard deviations [%]", f"{100.0 * found.within_two_std:.0f}"),
    )
    return table(("", ">"), rows, title=f"{found.worlds} worlds, {found.trials} trials")


def _scores_table(found: Evaluation, title: str) -> FittedTable:
    trained = f"{found.repeats} x {found.folds} folds"
    if found.further_worlds:
        trained = f"trained in {found.further_worlds} others, {found.repeats} x"
    errors = (">training error", ">held-out error", ">R2", ">Spearman")
    gains = (">better than the paper's network by", ">than the same, regularised, by")
    rows = []
    for one in found.scores:
        figures = (one.mse, one.r2, one.spearman, one.improvement, one.improvement_regularised)
        rows.append((one.recipe, f"{one.training_mse:.3f}", *("" if it is None else it.text() for it in figures)))
    highest = found.ceiling.reliability
    caption = f"highest R2 that these trials allow, from split halves: {highest.text()}" if highest else ""
    title = f"{found.worlds} worlds, {title}: {trained}"
    return table(("model", *errors, *gains), rows, title=title, caption=caption)
