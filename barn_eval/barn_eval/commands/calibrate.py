"""`barn calibrate`: planners against published trials of the same worlds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.table import Table

from barn_eval.commands.options import console, json_option, notes, print_json, row, table
from barn_metrics.bootstrap import number
from barn_worlds.config import as_dict

if TYPE_CHECKING:
    from barn_eval.studies.calibration import Calibration, CalibrationReport


@click.command("calibrate")
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--reference",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="Table of published times: world, path_length_m, dwa_1, ..., eband_1, ...",
)
@click.option(
    "--figure", type=click.Path(path_type=Path, dir_okay=False), help="Scatter to write, ending in .png, .svg or .pdf."
)
@json_option
def calibrate_command(folders: tuple[Path, ...], reference: Path, figure: Path | None, as_json: bool) -> None:
    """Compare the planners of FOLDERS of runs or campaigns with published times of the same worlds.

    A published time of 30.000 s, or of 50 s and more, is a failure that counts with that time. Intervals are of 95 %,
    over worlds.
    """
    from barn_eval.studies.calibration import calibrate  # noqa: PLC0415 (scipy)
    from barn_eval.studies.calibration_figure import SUFFIXES, write_scatter  # noqa: PLC0415 (matplotlib)

    if figure is not None and figure.suffix not in SUFFIXES:
        raise click.UsageError(f"--figure {figure}: must end in {', '.join(SUFFIXES)}")
    report = calibrate(folders, reference)
    if figure is not None:
        write_scatter(report, figure)
    if as_json:
        print_json(as_dict(report))
    else:
        _print(report)
    if figure is not None:
        notes.print(str(figure), markup=False, soft_wrap=True)


def _print(report: CalibrationReport) -> None:
    for one in report.planners:
        console.print(_table(one))
    for joint in report.joint:
        names = " and ".join(joint.labels)
        text = f"Spearman correlation of the mean of {names} over {joint.worlds} worlds: {joint.correlation.text()}"
        console.print(text, markup=False, highlight=False)


def _table(one: Calibration) -> Table:
    made = table("", ">ours", ">published", title=f"{one.label}, {one.protocol} protocol, {len(one.worlds)} worlds")
    sides = (one.ours, one.published)
    row(made, "trials", *(str(side.trials) for side in sides))
    row(made, "failures [%]", *(side.failure_share.scaled(100.0).text(1) for side in sides))
    row(made, "mean time per metre [s/m]", *(side.normalised_s_per_m.text() for side in sides))
    row(made, "its bias [%]", one.bias_percent.text(1), "")
    row(made, "its bias, each failure as 30 s [%]", one.bias_percent_of_equal_failures.text(1), "")
    row(made, "its spread in a world [s/m]", *(number(side.spread_s_per_m) for side in sides))
    row(made, "time in easy worlds [s]", *(side.easy_s.text() for side in sides))
    row(made, "lowest, highest of these [s]", *(", ".join(map(number, side.easy_range_s)) for side in sides))
    row(made, "Spearman, failures counted", one.correlation.text(), "")
    row(made, "Spearman, each failure as 30 s", one.correlation_of_equal_failures.text(), "")
    row(made, "Spearman, successes only", one.correlation_of_successes.text(), "")
    easy = ", ".join(map(str, one.easy_worlds))
    made.caption = f"easy: the {len(one.easy_worlds)} worlds with the shortest published times, {easy}"
    made.caption_justify = "left"
    return made
