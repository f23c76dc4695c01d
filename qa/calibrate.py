"""Compare planners with published times of the same worlds: python qa/calibrate.py FOLDER... --reference TABLE.

A published time of 30.000 s, or of 50 s and more, is a failure that counts with that time. Intervals are of 95 %, over
worlds.
"""

from pathlib import Path

import click

from barn_eval.commands.options import FILE, PATH, console, json_option, print_json, say
from barn_eval.commands.tables import FittedTable, table
from barn_eval.studies.calibration import FIGURES, Calibration, calibrate
from barn_eval.studies.calibration_figure import write_scatter
from barn_metrics.bootstrap import number
from barn_worlds.base.config import as_dict


@click.command(help=__doc__)
@click.argument("folders", nargs=-1, required=True, type=PATH)
@click.option(
    "--reference",
    required=True,
    type=FILE,
    help="Table of published times: world, path_length_m, dwa_1, ..., eband_1, ...",
)
@click.option("--out", type=FILE, help="Scatter to write, ending in .png, .svg or .pdf.")
@json_option
def main(folders: tuple[Path, ...], reference: Path, out: Path | None, as_json: bool) -> None:
    """Print what there is to say, or write it."""
    if out is not None and out.suffix not in FIGURES:
        raise click.UsageError(f"--out {out}: must end in {', '.join(FIGURES)}")
    report = calibrate(list(folders), reference)
    if out is not None:
        write_scatter(report, out)
        say(out)
    if as_json:
        print_json(as_dict(report))
        return
    console.print(*map(_table, report.planners))
    for joint in report.joint:
        names = " and ".join(joint.labels)
        lines = (
            f"Spearman correlation of the mean of {names} over {joint.worlds} worlds: {joint.correlation.text()}",
            f"R2 of the same, each failure as 30 s: {joint.determination_of_equal_failures.text()}",
        )
        console.print(*lines, sep="\n", markup=False, highlight=False)


def _table(one: Calibration) -> FittedTable:
    sides = (one.ours, one.published)
    rows = (
        ("trials", *(str(side.trials) for side in sides)),
        ("failures [%]", *(side.failure_share.scaled(100.0).text(1) for side in sides)),
        ("mean time per metre [s/m]", *(side.normalised_s_per_m.text() for side in sides)),
        ("its bias [%]", one.bias_percent.text(1), ""),
        ("its bias, each failure as 30 s [%]", one.bias_percent_of_equal_failures.text(1), ""),
        ("mean of successes per metre [s/m]", *(number(side.successes_s_per_m) for side in sides)),
        ("its spread in a world [s/m]", *(number(side.spread_s_per_m) for side in sides)),
        ("time in easy worlds [s]", *(side.easy_s.text() for side in sides)),
        ("lowest, highest of these [s]", *(", ".join(map(number, side.easy_range_s)) for side in sides)),
        ("Spearman, failures counted", one.correlation.text(), ""),
        ("Spearman, each failure as 30 s", one.correlation_of_equal_failures.text(), ""),
        ("Spearman, successes only", one.correlation_of_successes.text(), ""),
        ("R2, each failure as 30 s", one.determination_of_equal_failures.text(), ""),
    )
    title = f"{one.label}, {one.protocol} protocol, {len(one.worlds)} worlds"
    easy = ", ".join(map(str, one.easy_worlds))
    caption = f"easy: the {len(one.easy_worlds)} worlds with the shortest published times, {easy}"
    return table(("", ">ours", ">published"), rows, title=title, caption=caption)


if __name__ == "__main__":
    main()
