"""`barn difficulty`: how difficult worlds are, as learned."""

from collections.abc import Sequence
from pathlib import Path

import click

from barn_eval.api import difficulty
from barn_eval.commands.options import (
    FILE,
    PATH,
    json_option,
    notes,
    print_notes,
    print_output,
    worlds_option,
)
from barn_eval.commands.tables import table
from barn_worlds.base.config import as_dict

_OWN = (
    "difficulty_s_per_m",
    "std_s_per_m",
)  # columns of every prediction; those of planners come beside them


@click.group("difficulty")
def command() -> None:
    """Train, judge and use a model of how difficult worlds are.

    Difficulty is the normalised time of trials: seconds per metre of path, failures as they count, averaged over
    planners and repetitions.
    """


@command.command()
@click.argument("source", default="barn300")
@worlds_option
@click.option("--weights", type=FILE, help="Weights [default: the shipped ones].")
@json_option
def predict(source: str, select: str, weights: Path | None, as_json: bool) -> None:
    """Predict how difficult the worlds of SOURCE are: a data set, a folder or a file, maps of one's own included."""
    model, name, lines = difficulty.predictions(source, select, weights)
    planners = [
        name for name in lines[0] if name.endswith("_s_per_m") and name not in _OWN
    ]
    columns = [f">{name.removesuffix('_s_per_m')} [s/m]" for name in planners]
    rows = []
    for line in lines:
        numbers = [f"{line[name]:.2f}" for name in (*_OWN, *planners)]
        rows.append(
            (line["name"], *numbers, f"{100.0 * line['failure_probability']:.0f}")
        )
    shown = table(
        ("world", ">difficulty [s/m]", ">+-", *columns, ">failures [%]"), rows
    )
    print_output(
        as_json, {"source": name, "about": dict(model.about), "worlds": lines}, shown
    )


@command.command()
@click.argument("sources", nargs=-1, required=True, type=PATH)
@click.option("--out", required=True, type=FILE, help="Weights to write, .npz.")
@click.option("--seed", default=0, help="All randomness comes from it.")
def train(sources: Sequence[Path], out: Path, seed: int) -> None:
    """Train on the trials of SOURCES: folders of experiments."""
    with notes.status("training"):
        difficulty.train(sources, out, seed=seed)
    print_notes(out)


@command.command()
@click.argument("source", type=PATH)
@click.option("--weights", type=FILE, help="Weights [default: the shipped ones].")
@json_option
def evaluate(source: Path, weights: Path | None, as_json: bool) -> None:
    """Judge weights by the trials of SOURCE, beside ridge regression on the paper's five metrics in worlds held out.

    Errors are in (s/m)^2 with intervals of 95 % over worlds.
    """
    found = difficulty.evaluate(source, weights=weights)
    figures = (
        ">error",
        ">R2",
        ">Spearman",
        ">better than ridge by",
        ">within 1 std [%]",
    )
    rows = []
    for one in found.scores:
        texts = (
            "" if it is None else it.text()
            for it in (one.mse, one.r2, one.spearman, one.gain)
        )
        rows.append(
            (
                one.name,
                *texts,
                "" if one.within_std is None else f"{100.0 * one.within_std:.0f}",
            )
        )
    caption = (
        f"highest R2 that these trials allow, from split halves: {found.ceiling.text()}"
        if found.ceiling
        else ""
    )
    title = f"{found.worlds} worlds, {found.trials} trials"
    print_output(
        as_json,
        as_dict(found),
        table(("model", *figures), rows, title=title, caption=caption),
    )
