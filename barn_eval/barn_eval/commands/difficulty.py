"""`barn difficulty`: how difficult worlds are, as learned."""

from pathlib import Path

import click

from barn_eval.api import difficulty
from barn_eval.commands.options import (
    FILE,
    json_option,
    tell,
    worlds_option,
)
from barn_eval.commands.tables import table

_OWN = (
    "difficulty_s_per_m",
    "std_s_per_m",
)  # columns of every prediction; those of planners come beside them


@click.group("difficulty")
def command() -> None:
    """Predict how difficult worlds are.

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
    tell(as_json, {"source": name, "about": dict(model.about), "worlds": lines}, shown)
