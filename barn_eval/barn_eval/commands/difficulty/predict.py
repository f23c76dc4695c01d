"""`barn difficulty predict`."""

from pathlib import Path
from typing import Any

import click

from barn_eval import difficulty
from barn_eval.commands.options import FILE, console, json_option, print_json, say, worlds_option
from barn_eval.commands.tables import FittedTable, table
from barn_eval.results.frames import frame_of
from barn_worlds.base.files import write_bytes

# Columns of every prediction; those of planners come beside them.
_OWN = ("difficulty_s_per_m", "std_s_per_m")


@click.command("predict")
@click.argument("source", default="barn300")
@worlds_option
@click.option("--weights", type=FILE, help="Weights [default: the shipped ones].")
@click.option("--out", type=FILE, help="Write a line per world here, as CSV.")
@json_option
def command(source: str, spec: str, weights: Path | None, out: Path | None, as_json: bool) -> None:
    """Predict how difficult the worlds of SOURCE are: a data set, a folder or a file, maps of one's own included.

    The CSV file is one that `barn worlds convert --order FILE:difficulty_s_per_m` takes.
    """
    model, name, lines = difficulty.predictions(source, spec, weights)
    if out is not None:
        write_bytes(out, frame_of(lines).to_csv(index=False).encode())
        say(out)
    if as_json:
        print_json({"source": name, "about": dict(model.about), "worlds": lines})
    else:
        console.print(_predictions_table(lines))


def _predictions_table(lines: list[dict[str, Any]]) -> FittedTable:
    planners = [name for name in lines[0] if name.endswith("_s_per_m") and name not in _OWN]
    columns = [f">{name.removesuffix('_s_per_m')} [s/m]" for name in planners]
    rows = []
    for line in lines:
        numbers = [f"{line[name]:.2f}" for name in (*_OWN, *planners)]
        rows.append((line["name"], *numbers, f"{100.0 * line['failure_probability']:.0f}"))
    return table(("world", ">difficulty [s/m]", ">+-", *columns, ">failures [%]"), rows)
