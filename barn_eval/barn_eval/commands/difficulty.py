"""`barn difficulty`: train, judge and use the learned difficulty of worlds."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import pandas as pd

from barn_eval import difficulty
from barn_eval.commands.options import FILE, PATH, json_option, say, settings_option, tell, worlds_option
from barn_eval.commands.tables import table
from barn_worlds.base.config import as_dict, replace_dotted
from barn_worlds.base.files import write_bytes

_OWN = ("difficulty_s_per_m", "std_s_per_m")  # columns of every prediction; those of planners come beside them


@click.group("difficulty")
def command() -> None:
    """Train, judge and use a model of how difficult worlds are.

    Difficulty is the normalised time of trials: seconds per metre of path, failures as they count, averaged over
    planners and repetitions.
    """


@command.command()
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, type=PATH)
@click.option("--out", required=True, type=FILE, help="Weights to write, .npz.")
@settings_option("--set", "settings", "Of training", difficulty.Training())
@json_option
def train(sources: tuple[Path, ...], out: Path, settings: dict[str, Any], as_json: bool) -> None:
    """Train a model on the trials of all SOURCEs and write its weights.

    SOURCE is the folder of an experiment, or a table of published times (world, path_length_m, dwa_1, ...), .csv.
    """
    training = replace_dotted(difficulty.Training(), settings, "--set")
    about = difficulty.train(sources, out, **asdict(training)).about
    trials = f"{about['training_worlds']} worlds, {about['training_trials']} trials of {', '.join(about['planners'])}"
    error = f"training error {about['training_mse']:.3f} (s/m)^2; for that of worlds not seen: barn difficulty evaluate"
    tell(as_json, {"weights": str(out), **about}, f"{about['title']}: {trials}", error)
    say(out)


@command.command()
@click.argument("source", type=PATH)
@click.option("--weights", type=FILE, help="Judge these, a file or 'shipped', in place of models trained on folds.")
@settings_option("--set", "settings", "Of judging", difficulty.Judging())
@json_option
def evaluate(source: Path, weights: Path | None, settings: dict[str, Any], as_json: bool) -> None:
    """Judge the model in worlds that it was not trained on, beside ridge regression on the paper's five metrics.

    It is repeated k-fold over the worlds of SOURCE. Worlds of barn_test are never trained on; they judge --weights.
    Errors are in (s/m)^2 with intervals of 95 % over worlds.
    """
    judging = replace_dotted(difficulty.Judging(), settings, "--set")
    found = difficulty.evaluate(source, weights=weights, **asdict(judging))
    figures = (">training error", ">held-out error", ">R2", ">Spearman", ">better than ridge by", ">within 1 std [%]")
    rows = []
    for one in found.scores:
        held_out = ("" if it is None else it.text() for it in (one.mse, one.r2, one.spearman, one.gain))
        within = "" if one.within_std is None else f"{100.0 * one.within_std:.0f}"
        rows.append((one.name, f"{one.training_mse:.3f}", *held_out, within))
    caption = f"highest R2 that these trials allow, from split halves: {found.ceiling.text()}" if found.ceiling else ""
    title = f"{found.worlds} worlds, {found.trials} trials: {found.repeats} x {found.folds} folds"
    tell(as_json, as_dict(found), table(("model", *figures), rows, title=title, caption=caption))


@command.command()
@click.argument("source", default="barn300")
@worlds_option
@click.option("--weights", type=FILE, help="Weights [default: the shipped ones].")
@click.option("--out", type=FILE, help="Write a line per world here, as CSV.")
@json_option
def predict(source: str, select: str, weights: Path | None, out: Path | None, as_json: bool) -> None:
    """Predict how difficult the worlds of SOURCE are: a data set, a folder or a file, maps of one's own included.

    The CSV file is one that `barn worlds convert --order FILE:difficulty_s_per_m` takes.
    """
    model, name, lines = difficulty.predictions(source, select, weights)
    if out is not None:
        write_bytes(out, pd.DataFrame(lines).to_csv(index=False).encode())
        say(out)
    planners = [name for name in lines[0] if name.endswith("_s_per_m") and name not in _OWN]
    columns = [f">{name.removesuffix('_s_per_m')} [s/m]" for name in planners]
    rows = []
    for line in lines:
        numbers = [f"{line[name]:.2f}" for name in (*_OWN, *planners)]
        rows.append((line["name"], *numbers, f"{100.0 * line['failure_probability']:.0f}"))
    shown = table(("world", ">difficulty [s/m]", ">+-", *columns, ">failures [%]"), rows)
    tell(as_json, {"source": name, "about": dict(model.about), "worlds": lines}, shown)
