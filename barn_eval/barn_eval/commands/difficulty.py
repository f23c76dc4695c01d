"""`barn difficulty`: predict how difficult worlds are, by a learned model."""

from pathlib import Path

import click

from barn_eval.api.difficulty import predict_rows
from barn_eval.commands.options import (
    file_option,
    json_option,
    print_output,
    source_argument,
    worlds_option,
)
from barn_eval.commands.tables import table

# Columns of every prediction; those of single planners follow them.
_COLUMNS = ("difficulty_s_per_m", "std_s_per_m")


@click.group("difficulty")
def command() -> None:
    """Predict how difficult worlds are.

    Difficulty is the mean time per meter of path over planners and repetitions.
    A failure counts as the protocol's penalty.
    """


@command.command()
@source_argument
@worlds_option
@file_option("--weights", help="Weights of the model [default: those of the suite].")
@json_option
def predict(source: str, select: str, weights: Path | None, as_json: bool) -> None:
    """Predict how difficult the worlds of SOURCE are.

    SOURCE is the name of a data set, or a file or folder with worlds or your own maps.
    """
    model, name, predictions = predict_rows(source, select, weights)
    planner_columns = []
    # Each model knows its own planners, so columns come from the prediction.
    for column in predictions[0]:
        if column.endswith("_s_per_m") and column not in _COLUMNS:
            planner_columns.append(column)
    rows = []
    for prediction in predictions:
        numbers = [
            f"{prediction[column]:.2f}" for column in (*_COLUMNS, *planner_columns)
        ]
        rows.append((prediction["name"], *numbers))
    headings = [
        f">{column.removesuffix('_s_per_m')} [s/m]" for column in planner_columns
    ]
    print_output(
        as_json,
        {"source": name, "about": dict(model.about), "worlds": predictions},
        table(("world", ">difficulty [s/m]", ">+-", *headings), rows),
    )
