"""Study what rests on an ideal tire and on ideal sensors.

The table of docs/ideal_robot.md.

    python qa/studies/ideal_robot.py docs/ideal_robot.csv
    python qa/studies/ideal_robot.py out/one_ideal out/one_tire --csv docs/ideal_robot.csv

Runs whose names begin alike, up to the first _, are of one speed class. Each planner is
compared with itself in the first of them, by pairs of trials in the same world. A run
may be of fewer worlds than the first.
"""

import csv
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from io import StringIO
from pathlib import Path

import click
import numpy as np

from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import read_source
from barn_eval.analysis.statistics import TrialValues, difference
from barn_worlds.base.errors import BarnError
from barn_worlds.base.files import markdown_table, write_bytes


@dataclass(frozen=True)
class Trial:
    """A trial: its run's name, planner and world, and how it ended."""

    run: str
    planner: str
    world: int
    success: int
    efficiency: float


def read_folders(folders: Sequence[Path]) -> list[Trial]:
    """Return the trials of folders of results."""
    trials = []
    for folder in folders:
        for result in read_source(folder).results:
            efficiency = round(result.scores.efficiency or 0.0, 4)
            success = int(result.scores.success)
            trial = Trial(
                folder.name, result.planner, result.world, success, efficiency
            )
            trials.append(trial)
    return sorted(trials, key=lambda trial: (trial.planner, trial.world))


def read_trials(path: Path) -> list[Trial]:
    """Return the trials of a CSV file that `csv_text` made."""
    with path.open(newline="") as file:
        return [
            Trial(
                row["run"],
                row["planner"],
                int(row["world"]),
                int(row["success"]),
                float(row["efficiency"]),
            )
            for row in csv.DictReader(file)
        ]


def csv_text(trials: Sequence[Trial]) -> str:
    """Return the trials as CSV."""
    file = StringIO()
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow(item.name for item in fields(Trial))
    rows.writerows(map(astuple, trials))
    return file.getvalue()


def values_of(trials: Sequence[Trial], run: str, planner: str) -> TrialValues:
    """Return the efficiencies of a planner in a run [%], 0 for failures."""
    own = [trial for trial in trials if (trial.run, trial.planner) == (run, planner)]
    own.sort(key=lambda trial: trial.world)
    return TrialValues(
        np.array([100.0 * trial.efficiency for trial in own]),
        np.array([trial.world for trial in own]),
        np.zeros(len(own), np.int64),
        np.array([1 - trial.success for trial in own]),
        np.zeros(len(own)),
        100.0,
    )


def results_table(trials: Sequence[Trial]) -> str:
    """Return success, efficiency and its change of each planner and run."""
    rows = []
    for planner in dict.fromkeys(trial.planner for trial in trials):
        runs = {trial.run for trial in trials if trial.planner == planner}
        first: dict[str, TrialValues] = {}
        for run in sorted(runs):
            values = values_of(trials, run, planner)
            base = first.setdefault(run.partition("_")[0], values)
            success = 100.0 * (1.0 - values.failures.mean())
            change = ["", ""]
            if base is not values:
                shared = np.flatnonzero(np.isin(base.worlds, values.worlds))
                test = difference(values, base.at(shared))
                p = f"{test.p:.3f}" if test.p >= 0.001 else "< 0.001"
                change = [test.interval.text(1), p]
            cells = [f"`{run}`", f"{success:.0f}", values.mean().text(1), *change]
            rows.append([spelling(planner), *cells])
    return markdown_table(
        ["planner", "run", "success [%]", "efficiency [%]", "change [points]", "p"],
        rows,
    )


@click.command()
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--csv", "target", type=click.Path(path_type=Path), help="Write the trials here."
)
def main(sources: Sequence[Path], target: Path | None) -> None:
    """Print the table, of a CSV file of trials or of folders of results."""
    try:
        is_file = sources[0].suffix == ".csv"
        trials = read_trials(sources[0]) if is_file else read_folders(sources)
        if target is not None:
            write_bytes(target, csv_text(trials).encode())
        click.echo(results_table(trials))
    except BarnError as error:
        raise click.ClickException(str(error)) from None


if __name__ == "__main__":
    main()
