"""`barn difficulty`: train, judge and use the learned difficulty of worlds."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from barn_eval.commands.difficulty_output import bar, estimate, predictions_table, scores_table
from barn_eval.commands.options import console, json_option, notes, print_json, row, table, worlds_option
from barn_worlds.config import as_dict
from barn_worlds.dataset import open_dataset
from barn_worlds.errors import WorldError
from barn_worlds.spec import select_worlds

if TYPE_CHECKING:
    from barn_metrics.model import Prediction
    from barn_metrics.model.trials import Trials
    from barn_worlds.world import World

seed_option = click.option("--seed", default=0, show_default=True, type=click.IntRange(0, 2**62), help="Of training.")
planner_option = click.option("--planner", help="Learn the times of one planner alone, not the mean of all.")
dataset_option = click.option("--dataset", help="Where the worlds are, if not where the results say.")
weights_option = click.option(
    "--weights", type=click.Path(path_type=Path, dir_okay=False), help="Weights [default: the shipped ones]."
)
source_argument = click.argument("source", type=click.Path(path_type=Path))


@click.group()
def difficulty() -> None:
    """Train, judge and use a model of how difficult worlds are.

    Difficulty is the normalised time of trials: seconds per metre of path, failures as they count, averaged over
    planners and repetitions.
    """


@difficulty.command()
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path, dir_okay=False), help="Weights to write, .npz.")
@click.option("--recipe", default="rich", show_default=True, help="What is trained; paper: the paper's network.")
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
    from barn_metrics.model import save_model  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.model.training import train as train_model  # noqa: PLC0415

    if out.suffix != ".npz":
        raise click.UsageError(f"--out {out}: must end in .npz")
    worlds, trials = _samples(sources, planner, dataset)
    model = train_model(recipe, worlds, trials, seed)
    save_model(model, out)
    if as_json:
        print_json({"weights": str(out), "recipe": recipe, **model.about})
        return
    about = model.about
    console.print(
        f"{about['title']}: {about['training_worlds']} worlds, {about['training_trials']} trials of "
        f"{', '.join(about['planners'])}",
        f"training error {about['training_mse']:.3f} (s/m)^2; for that of worlds not seen: barn difficulty evaluate",
        sep="\n",
        markup=False,
        highlight=False,
    )
    notes.print(str(out), markup=False, soft_wrap=True)


@difficulty.command()
@source_argument
@click.option("--folds", default=10, show_default=True, type=click.IntRange(2, 1000), help="Parts of the worlds.")
@click.option("--repeats", default=5, show_default=True, type=click.IntRange(1, 1000), help="Divisions into folds.")
@click.option("--recipe", "recipes", multiple=True, help="What is judged; may be repeated [default: all].")
@click.option(
    "--card",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Model card to write, .md; of the weights beside it (same name, .npz), if there are any.",
)
@click.option(
    "--further",
    multiple=True,
    type=click.Path(path_type=Path),
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

    Errors are in (s/m)^2 with intervals of 95 % over worlds. Successful trials are also judged alone.
    """
    from barn_metrics.model.card import JUDGED_APART, judge_successes, model_card  # noqa: PLC0415
    from barn_metrics.model.evaluation import EvaluationConfig  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.model.evaluation import evaluate as evaluate_recipes  # noqa: PLC0415
    from barn_metrics.model.recipes import RECIPES  # noqa: PLC0415
    from barn_worlds.formats.files import write_bytes  # noqa: PLC0415

    config = EvaluationConfig(folds=folds, repeats=repeats, seed=seed)
    worlds, trials = _samples([source], planner, dataset)
    other = _samples(further, planner, None) if further else None
    chosen = recipes or RECIPES
    with bar(as_json) as progress:
        found = evaluate_recipes(worlds, trials, chosen, config, progress)
        elsewhere = evaluate_recipes(worlds, trials, chosen, config, progress, other) if other else None
        successes = judge_successes(worlds, trials, [one for one in chosen if one in JUDGED_APART], config)
    if card is not None:
        write_bytes(card, model_card(found, successes, card.with_suffix(".npz"), elsewhere).encode())
        notes.print(str(card), markup=False, soft_wrap=True)
    if as_json:
        parts = {"all_trials": found, "successful_trials": successes, "trained_elsewhere": elsewhere}
        print_json({name: as_dict(part) if part else None for name, part in parts.items()})
        return
    console.print(scores_table(found, "all trials"))
    if elsewhere:
        console.print(scores_table(elsewhere, "all trials"))
    if successes:
        console.print(scores_table(successes, "successful trials alone"))
    for note in found.notes:
        notes.print(note, markup=False, soft_wrap=True)


@difficulty.command()
@source_argument
@weights_option
@planner_option
@dataset_option
@json_option
def check(source: Path, weights: Path | None, planner: str | None, dataset: str | None, as_json: bool) -> None:
    """Compare trained weights with the trials of SOURCE, such as published ones, in worlds not trained on."""
    from barn_metrics.model import load_model  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.model.transfer import transfer  # noqa: PLC0415

    found = transfer(load_model(weights), *_samples([source], planner, dataset))
    if as_json:
        print_json(as_dict(found))
        return
    made = table("", ">", title=f"{found.worlds} worlds, {found.trials} trials")
    row(made, "mean squared error [(s/m)^2]", estimate(found.mse))
    row(made, "R2", estimate(found.r2))
    row(made, "Spearman", estimate(found.spearman))
    row(made, "bias [s/m]", estimate(found.bias_s_per_m))
    row(made, "within two standard deviations [%]", f"{100.0 * found.within_two_std:.0f}")
    console.print(made)


@difficulty.command()
@click.argument("source", default="barn300")
@worlds_option
@weights_option
@click.option("--csv", "csv_path", type=click.Path(path_type=Path, dir_okay=False), help="Write a line per world here.")
@json_option
def predict(source: str, spec: str, weights: Path | None, csv_path: Path | None, as_json: bool) -> None:
    """Predict how difficult the worlds of SOURCE are: a data set, a folder or a file, maps of one's own included.

    The CSV file is one that `barn worlds order --scores FILE --by difficulty_s_per_m` takes.
    """
    from barn_metrics.model import load_model  # noqa: PLC0415 (compiled kernels)
    from barn_worlds.formats.files import write_bytes  # noqa: PLC0415

    model = load_model(weights)
    opened = open_dataset(source)
    numbers = select_worlds(spec, opened.indices)
    lines = []
    for number in numbers:
        world = opened.load(number)
        try:
            lines.append({"world": number, "name": world.name, **_flat(model.predict(world))})
        except WorldError as error:
            raise WorldError(f"{source}: world {number}: {error}") from None
    if csv_path is not None:
        write_bytes(csv_path, _as_csv(lines).encode())
        notes.print(str(csv_path), markup=False, soft_wrap=True)
    if as_json:
        print_json({"source": opened.name, "recipe": model.recipe, "about": dict(model.about), "worlds": lines})
    else:
        console.print(predictions_table(lines))


def _samples(sources: Sequence[Path], planner: str | None, dataset: str | None) -> tuple[Mapping[int, World], Trials]:
    """Return worlds and trials of all sources, of one planner if it is named."""
    from barn_eval.learning.difficulty import read_trials  # noqa: PLC0415 (pyarrow)
    from barn_metrics.model.training import joined  # noqa: PLC0415 (compiled kernels)

    parts = [read_trials(source, dataset) for source in sources]
    worlds, trials = parts[0] if len(parts) == 1 else joined(parts)
    return worlds, trials if planner is None else trials.of(planner)


def _flat(prediction: Prediction) -> dict[str, Any]:
    planners = {f"{name}_s_per_m": value for name, value in prediction.per_planner_s_per_m.items()}
    return {
        "difficulty_s_per_m": prediction.difficulty_s_per_m,
        "std_s_per_m": prediction.std_s_per_m,
        **planners,
        "failure_probability": prediction.failure_probability,
    }


def _as_csv(lines: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()
