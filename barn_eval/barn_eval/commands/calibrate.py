"""`barn calibrate`: planners against published trials of the same worlds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.table import Table

from barn_eval.commands.options import FILE, PATH, console, json_option, print_json, say, table
from barn_metrics.bootstrap import number
from barn_worlds.config import as_dict

if TYPE_CHECKING:
    from barn_eval.studies.calibration import Calibration


@click.command()
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option(
    "--reference",
    required=True,
    type=FILE,
    help="Table of published times: world, path_length_m, dwa_1, ..., eband_1, ...",
)
@click.option("--figure", type=FILE, help="Scatter to write, ending in .png, .svg or .pdf.")
@json_option
def calibrate(folders: tuple[Path, ...], reference: Path, figure: Path | None, as_json: bool) -> None:
    """Compare the planners of FOLDERS of runs or campaigns with published times of the same worlds.

    A published time of 30.000 s, or of 50 s and more, is a failure that counts with that time. Intervals are of 95 %,
    over worlds.
    """
    from barn_eval.studies import calibration  # noqa: PLC0415 (scipy)
    from barn_eval.studies.calibration_figure import SUFFIXES, write_scatter  # noqa: PLC0415 (matplotlib)

    if figure is not None and figure.suffix not in SUFFIXES:
        raise click.UsageError(f"--figure {figure}: must end in {', '.join(SUFFIXES)}")
    report = calibration.calibrate(folders, reference)
    if figure is not None:
        write_scatter(report, figure)
        say(figure)
    if as_json:
        print_json(as_dict(report))
        return
    console.print(*map(_table, report.planners))
    for joint in report.joint:
        names = " and ".join(joint.labels)
        text = f"Spearman correlation of the mean of {names} over {joint.worlds} worlds: {joint.correlation.text()}"
        console.print(text, markup=False, highlight=False)


def _table(one: Calibration) -> Table:
    sides = (one.ours, one.published)
    rows = (
        ("trials", *(str(side.trials) for side in sides)),
        ("failures [%]", *(side.failure_share.scaled(100.0).text(1) for side in sides)),
        ("mean time per metre [s/m]", *(side.normalised_s_per_m.text() for side in sides)),
        ("its bias [%]", one.bias_percent.text(1), ""),
        ("its bias, each failure as 30 s [%]", one.bias_percent_of_equal_failures.text(1), ""),
        ("its spread in a world [s/m]", *(number(side.spread_s_per_m) for side in sides)),
        ("time in easy worlds [s]", *(side.easy_s.text() for side in sides)),
        ("lowest, highest of these [s]", *(", ".join(map(number, side.easy_range_s)) for side in sides)),
        ("Spearman, failures counted", one.correlation.text(), ""),
        ("Spearman, each failure as 30 s", one.correlation_of_equal_failures.text(), ""),
        ("Spearman, successes only", one.correlation_of_successes.text(), ""),
    )
    title = f"{one.label}, {one.protocol} protocol, {len(one.worlds)} worlds"
    easy = ", ".join(map(str, one.easy_worlds))
    caption = f"easy: the {len(one.easy_worlds)} worlds with the shortest published times, {easy}"
    return table(("", ">ours", ">published"), rows, title=title, caption=caption)
