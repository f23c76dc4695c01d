"""`barn difficulty`: train, judge and use the learned difficulty of worlds."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.progress import Progress
from rich.table import Table

from barn_eval.commands.options import console, json_option, notes, print_json, row, table, worlds_option
from barn_worlds.config import as_dict
from barn_worlds.dataset import open_dataset
from barn_worlds.errors import WorldError
from barn_worlds.spec import select_worlds

if TYPE_CHECKING:
    from barn_metrics.model import Prediction
    from barn_metrics.model.evaluation import Evaluation, RecipeScore
    from barn_metrics.model.intervals import Interval

# Columns of every prediction; those of planners come beside them.
_OWN = ("difficulty_s_per_m", "std_s_per_m")

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
@source_argument
@click.option("--out", required=True, type=click.Path(path_type=Path, dir_okay=False), help="Weights to write, .npz.")
@click.option("--recipe", default="rich", show_default=True, help="What is trained; paper: the paper's network.")
@planner_option
@dataset_option
@seed_option
@json_option
def train(
    source: Path, out: Path, recipe: str, planner: str | None, dataset: str | None, seed: int, as_json: bool
) -> None:
    """Train a model on the trials of SOURCE and write its weights.

    SOURCE is the folder of a campaign, its results.parquet or results.csv, or a table of published times (world,
    path_length_m, dwa_1, ...).
    """
    from barn_eval.difficulty import read_trials  # noqa: PLC0415 (pyarrow)
    from barn_metrics.model import save_model  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.model.training import train as train_model  # noqa: PLC0415

    if out.suffix != ".npz":
        raise click.UsageError(f"--out {out}: must end in .npz")
    worlds, trials = read_trials(source, dataset)
    model = train_model(recipe, worlds, trials if planner is None else trials.of(planner), seed)
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
@planner_option
@dataset_option
@seed_option
@json_option
def evaluate(
    source: Path,
    folds: int,
    repeats: int,
    recipes: tuple[str, ...],
    card: Path | None,
    planner: str | None,
    dataset: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Judge models on worlds that they were not trained on: repeated k-fold over the worlds of SOURCE.

    Errors are in (s/m)^2 with intervals of 95 % over worlds. Successful trials are also judged alone.
    """
    from barn_eval.difficulty import read_trials  # noqa: PLC0415 (pyarrow)
    from barn_metrics.model.card import JUDGED_APART, judge_successes, model_card  # noqa: PLC0415
    from barn_metrics.model.evaluation import EvaluationConfig  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.model.evaluation import evaluate as evaluate_recipes  # noqa: PLC0415
    from barn_metrics.model.recipes import RECIPES  # noqa: PLC0415
    from barn_worlds.formats.files import write_bytes  # noqa: PLC0415

    config = EvaluationConfig(folds=folds, repeats=repeats, seed=seed)
    worlds, trials = read_trials(source, dataset)
    trials = trials if planner is None else trials.of(planner)
    chosen = recipes or RECIPES
    with _bar(as_json) as progress:
        found = evaluate_recipes(worlds, trials, chosen, config, progress)
        successes = judge_successes(worlds, trials, [one for one in chosen if one in JUDGED_APART], config)
    if card is not None:
        write_bytes(card, model_card(found, successes, card.with_suffix(".npz")).encode())
        notes.print(str(card), markup=False, soft_wrap=True)
    if as_json:
        print_json({"all_trials": as_dict(found), "successful_trials": as_dict(successes) if successes else None})
        return
    console.print(_scores_table(found, "all trials"))
    if successes:
        console.print(_scores_table(successes, "successful trials alone"))
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
    from barn_eval.difficulty import read_trials  # noqa: PLC0415 (pyarrow)
    from barn_metrics.model import load_model  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.model.transfer import transfer  # noqa: PLC0415

    worlds, trials = read_trials(source, dataset)
    found = transfer(load_model(weights), worlds, trials if planner is None else trials.of(planner))
    if as_json:
        print_json(as_dict(found))
        return
    made = table("", ">", title=f"{found.worlds} worlds, {found.trials} trials")
    row(made, "mean squared error [(s/m)^2]", _estimate(found.mse))
    row(made, "R2", _estimate(found.r2))
    row(made, "Spearman", _estimate(found.spearman))
    row(made, "bias [s/m]", _estimate(found.bias_s_per_m))
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
        console.print(_predictions_table(lines))


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


def _predictions_table(lines: list[dict[str, Any]]) -> Table:
    planners = [name for name in lines[0] if name.endswith("_s_per_m") and name not in _OWN]
    columns = [f">{name.removesuffix('_s_per_m')} [s/m]" for name in planners]
    made = table("world", ">difficulty [s/m]", ">+-", *columns, ">failures [%]")
    for line in lines:
        failures = line["failure_probability"]
        numbers = [f"{line[name]:.2f}" for name in (*_OWN, *planners)]
        row(made, line["name"], *numbers, "-" if failures is None else f"{100.0 * failures:.0f}")
    return made


def _scores_table(found: Evaluation, title: str) -> Table:
    made = table(
        "model",
        ">training error",
        ">held-out error",
        ">R2",
        ">Spearman",
        ">better than the paper's network by",
        ">than the same, regularised, by",
        title=f"{found.worlds} worlds, {title}: {found.repeats} x {found.folds} folds",
    )
    for score in found.scores:
        row(made, score.recipe, f"{score.training_mse:.3f}", *map(_estimate, _figures(score)))
    ceiling = found.ceiling
    if ceiling.reliability is not None:
        made.caption = f"highest R2 that these trials allow, from split halves: {_estimate(ceiling.reliability)}"
        made.caption_justify = "left"
    return made


def _figures(score: RecipeScore) -> tuple[Interval | None, ...]:
    return score.mse, score.r2, score.spearman, score.improvement, score.improvement_regularised


def _estimate(found: Interval | None) -> str:
    return "" if found is None else f"{found.estimate:.2f} [{found.low:.2f}, {found.high:.2f}]"


class _Bar(AbstractContextManager["_Bar"]):
    """A bar on standard error that an evaluation moves on."""

    def __init__(self) -> None:
        self._bar = Progress(console=notes, transient=True)
        self._task = self._bar.add_task("models")

    def __enter__(self) -> _Bar:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def __call__(self, done: int, total: int) -> None:
        self._bar.update(self._task, completed=done, total=total)


def _bar(quiet: bool) -> AbstractContextManager[Callable[[int, int], None] | None]:
    return nullcontext() if quiet else _Bar()
