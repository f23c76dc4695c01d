"""`barn difficulty`: train, judge and use the learned difficulty of worlds."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from barn_eval import models
from barn_eval.commands.options import FILE, PATH, SEED, console, json_option, print_json, say, worlds_option
from barn_eval.commands.tables import FittedTable, table
from barn_worlds.base.config import as_dict

if TYPE_CHECKING:
    from barn_metrics.model.evaluation import Evaluation

# Columns of every prediction; those of planners come beside them.
_OWN = ("difficulty_s_per_m", "std_s_per_m")

seed_option = click.option("--seed", default=0, show_default=True, type=SEED, help="Of training.")
planner_option = click.option("--planner", help="Learn the times of one planner alone, not the mean of all.")
dataset_option = click.option("--dataset", help="Where the worlds are, if not where the results say.")
weights_option = click.option("--weights", type=FILE, help="Weights [default: the shipped ones].")
source_argument = click.argument("source", type=PATH)


@click.group()
def difficulty() -> None:
    """Train, judge and use a model of how difficult worlds are.

    Difficulty is the normalised time of trials: seconds per metre of path, failures as they count, averaged over
    planners and repetitions.
    """


@difficulty.command()
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, type=PATH)
@click.option("--out", required=True, type=FILE, help="Weights to write, .npz.")
@click.option("--recipe", default="routes", show_default=True, help="What is trained; paper: the paper's network.")
@planner_option
@dataset_option
@seed_option
@json_option
def train(
    sources: tuple[Path, ...],
    out: Path,
    recipe: str,
    planner: str | None,
    dataset: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Train a model on the trials of all SOURCEs and write its weights.

    SOURCE is the folder of a campaign, its results.parquet or results.csv, or a table of published times (world,
    path_length_m, dwa_1, ...).
    """
    if out.suffix != ".npz":
        raise click.UsageError(f"--out {out}: must end in .npz")
    model = models.train_difficulty(sources, out, recipe=recipe, planner=planner, dataset=dataset, seed=seed)
    about = model.about
    if as_json:
        print_json({"weights": str(out), "recipe": recipe, **about})
        return
    console.print(
        f"{about['title']}: {about['training_worlds']} worlds, {about['training_trials']} trials of "
        f"{', '.join(about['planners'])}",
        f"training error {about['training_mse']:.3f} (s/m)^2; for that of worlds not seen: barn difficulty evaluate",
        sep="\n",
        markup=False,
        highlight=False,
    )
    say(out)


@difficulty.command()
@source_argument
@click.option("--folds", default=10, show_default=True, type=click.IntRange(2, 1000), help="Parts of the worlds.")
@click.option("--repeats", default=5, show_default=True, type=click.IntRange(1, 1000), help="Divisions into folds.")
@click.option("--recipe", "recipes", multiple=True, help="What is judged; may be repeated [default: all].")
@click.option(
    "--card", type=FILE, help="Model card to write, .md; of the weights beside it (same name, .npz), if there are any."
)
@click.option(
    "--further",
    multiple=True,
    type=PATH,
    help="Trials in other worlds, a source as SOURCE is; may be repeated. Judge models trained on these alone, too.",
)
@planner_option
@dataset_option
@seed_option
@json_option
def evaluate(
    source: Path,
    folds: int,
    repeats: int,
    recipes: tuple[str, ...],
    further: tuple[Path, ...],
    card: Path | None,
    planner: str | None,
    dataset: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Judge models on worlds that they were not trained on: repeated k-fold over the worlds of SOURCE.

    Worlds of barn_test stay whole: they judge models trained on --further.
    Errors are in (s/m)^2 with intervals of 95 % over worlds. Successful trials are also judged alone.
    """
    found = models.evaluate_difficulty(
        source,
        recipes=recipes,
        folds=folds,
        repeats=repeats,
        further=further,
        card=card,
        planner=planner,
        dataset=dataset,
        seed=seed,
        progress=not as_json,
    )
    if card is not None:
        say(card)
    if as_json:
        print_json({name: as_dict(part) if part else None for name, part in vars(found).items()})
        return
    parts = (
        (found.all_trials, "all trials"),
        (found.trained_elsewhere, "all trials"),
        (found.successful_trials, "successful trials alone"),
    )
    for part, title in parts:
        if part:
            console.print(_scores_table(part, title))
    for note in dict.fromkeys(note for part, _ in parts if part for note in part.notes):
        say(note)


@difficulty.command()
@source_argument
@weights_option
@planner_option
@dataset_option
@json_option
def check(source: Path, weights: Path | None, planner: str | None, dataset: str | None, as_json: bool) -> None:
    """Compare trained weights with the trials of SOURCE, such as published ones, in worlds not trained on."""
    found = models.check_difficulty(source, weights=weights, planner=planner, dataset=dataset)
    if as_json:
        print_json(as_dict(found))
        return
    rows = (
        ("mean squared error [(s/m)^2]", found.mse.text()),
        ("R2", found.r2.text()),
        ("Spearman", found.spearman.text()),
        ("bias [s/m]", found.bias_s_per_m.text()),
        ("within two standard deviations [%]", f"{100.0 * found.within_two_std:.0f}"),
    )
    console.print(table(("", ">"), rows, title=f"{found.worlds} worlds, {found.trials} trials"))


@difficulty.command()
@click.argument("source", default="barn300")
@worlds_option
@weights_option
@click.option("--csv", "csv_path", type=FILE, help="Write a line per world here.")
@json_option
def predict(source: str, spec: str, weights: Path | None, csv_path: Path | None, as_json: bool) -> None:
    """Predict how difficult the worlds of SOURCE are: a data set, a folder or a file, maps of one's own included.

    The CSV file is one that `barn worlds order --scores FILE --by difficulty_s_per_m` takes.
    """
    from barn_worlds.base.files import write_bytes  # noqa: PLC0415

    model, name, lines = models.predictions(source, spec, weights)
    if csv_path is not None:
        write_bytes(csv_path, _as_csv(lines).encode())
        say(csv_path)
    if as_json:
        print_json({"source": name, "recipe": model.recipe, "about": dict(model.about), "worlds": lines})
    else:
        console.print(_predictions_table(lines))


def _as_csv(lines: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def _predictions_table(lines: list[dict[str, Any]]) -> FittedTable:
    planners = [name for name in lines[0] if name.endswith("_s_per_m") and name not in _OWN]
    columns = [f">{name.removesuffix('_s_per_m')} [s/m]" for name in planners]
    rows = []
    for line in lines:
        failures = line["failure_probability"]
        numbers = [f"{line[name]:.2f}" for name in (*_OWN, *planners)]
        rows.append((line["name"], *numbers, "-" if failures is None else f"{100.0 * failures:.0f}"))
    return table(("world", ">difficulty [s/m]", ">+-", *columns, ">failures [%]"), rows)


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
