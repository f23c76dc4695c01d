"""`barn difficulty train`."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from barn_eval import difficulty
from barn_eval.commands.options import FILE, PATH, console, json_option, print_json, say, settings_option
from barn_worlds.base.config import replace_dotted


@click.command("train")
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, type=PATH)
@click.option("--out", required=True, type=FILE, help="Weights to write, .npz.")
@settings_option("--set", "settings", "Of training", difficulty.Training())
@json_option
def command(sources: tuple[Path, ...], out: Path, settings: dict[str, Any], as_json: bool) -> None:
    """Train a model on the trials of all SOURCEs and write its weights.

    SOURCE is the folder of an experiment, or a table of published times (world, path_length_m, dwa_1, ...), .csv.
    """
    training = replace_dotted(difficulty.Training(), settings, "--set")
    model = difficulty.train(sources, out, **asdict(training))
    about = model.about
    if as_json:
        print_json({"weights": str(out), **about})
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
