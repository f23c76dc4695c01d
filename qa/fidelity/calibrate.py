"""Compare planners with published times of the same worlds.

The figures of docs/fidelity.md.

    python qa/fidelity/calibrate.py FOLDER ... --reference
    ../shared/barn_original/trials.csv --figure scatter.png

FOLDERs hold runs or campaigns. A published time of 30.000 s, or of 50 s and more, is a
failure that counts with it. Intervals are of 95%, over worlds. The figure has our mean
times over the published ones, world by world.
"""

import json
import sys
from pathlib import Path

import click
from matplotlib.axes import Axes
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parents[1] / "studies/difficulty"))

from calibration import FIGURES, Calibration, CalibrationReport, calibrate

from barn_eval.commands.options import console
from barn_eval.commands.tables import FittedTable, table
from barn_eval.pages.figures import (
    label_axes,
    new_figure,
    plain_text,
    style,
    write_figure,
)
from barn_metrics.bootstrap import number
from barn_worlds.base.config import as_dict
from barn_worlds.base.errors import BarnError
from barn_worlds.base.files import make_json_safe
from barn_worlds.drawing.palette import FAINT, INK, PLANNERS

# By which side has failures among its trials of the world: (ours, published).
_KINDS = {
    (False, False): ("no failure", "o", PLANNERS[0]),
    (True, False): ("failures of ours", "^", PLANNERS[5]),
    (False, True): ("published failures", "s", PLANNERS[3]),
    (True, True): ("failures of both", "D", INK),
}
_COLUMNS = 2


def write_scatter(report: CalibrationReport, path: Path) -> None:
    """Write a panel per planner to a file ending in one of `FIGURES`.

    Raises:
        StoreError: If it cannot be written.
    """
    with style():
        figure = scatter(report)
    write_figure(figure, path)


def scatter(report: CalibrationReport) -> Figure:
    """Return the figure; all panels have the same limits."""
    columns = min(_COLUMNS, len(report.planners))
    rows = -(-len(report.planners) // columns)
    figure = new_figure(5.0 * rows + 0.8, 4.8 * columns)
    times = [
        time
        for calibration in report.planners
        for world in calibration.worlds
        for time in (world.ours_s, world.published_s)
    ]
    limits = (0.95 * min(times), 1.05 * max(times))
    for index, calibration in enumerate(report.planners):
        axes = figure.add_subplot(rows, columns, index + 1)
        _panel(axes, calibration, limits)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _panel(axes: Axes, calibration: Calibration, limits: tuple[float, float]) -> None:
    axes.axline(
        (limits[0], limits[0]), slope=1.0, color=FAINT, lw=1.0, label="equal times"
    )
    for kind, (label, marker, color) in _KINDS.items():
        worlds = [
            world
            for world in calibration.worlds
            if (world.our_failures > 0, world.published_failures > 0) == kind
        ]
        axes.scatter(
            [world.published_s for world in worlds],
            [world.ours_s for world in worlds],
            marker=marker,
            s=34,
            facecolor="none" if kind[1] else color,
            edgecolor=color,
            label=label,
        )
    rank_correlation = calibration.correlation.estimate
    subject = f"{plain_text(calibration.label)}: Spearman {rank_correlation:.2f}"
    title = f"{subject} over {len(calibration.worlds)} worlds"
    label_axes(axes, "published mean time of a world [s]", "our mean time [s]", title)
    axes.set(xlim=limits, ylim=limits, box_aspect=1.0)


def _table(calibration: Calibration) -> FittedTable:
    sides = (calibration.ours, calibration.published)
    rows = (
        ("trials", *(str(side.trials) for side in sides)),
        ("failures [%]", *(side.failure_share.scale(100.0).text(1) for side in sides)),
        (
            "mean time per meter [s/m]",
            *(side.normalised_s_per_m.text() for side in sides),
        ),
        ("its bias [%]", calibration.bias_percent.text(1), ""),
        (
            "its bias, each failure as 30 s [%]",
            calibration.bias_percent_of_equal_failures.text(1),
            "",
        ),
        (
            "mean of successes per meter [s/m]",
            *(number(side.successes_s_per_m) for side in sides),
        ),
        (
            "its spread in a world [s/m]",
            *(number(side.spread_s_per_m) for side in sides),
        ),
        ("time in easy worlds [s]", *(side.easy_s.text() for side in sides)),
        (
            "lowest, highest of these [s]",
            *(", ".join(map(number, side.easy_range_s)) for side in sides),
        ),
        ("Spearman, failures counted", calibration.correlation.text(), ""),
        (
            "Spearman, each failure as 30 s",
            calibration.correlation_of_equal_failures.text(),
            "",
        ),
        ("Spearman, successes only", calibration.correlation_of_successes.text(), ""),
        (
            "R2, each failure as 30 s",
            calibration.determination_of_equal_failures.text(),
            "",
        ),
    )
    title = f"{calibration.label}, {calibration.protocol} protocol, {len(calibration.worlds)} worlds"
    easy = ", ".join(map(str, calibration.easy_worlds))
    caption = f"easy: the {len(calibration.easy_worlds)} worlds with the shortest published times, {easy}"
    return table(("", ">ours", ">published"), rows, title=title, caption=caption)


@click.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--reference",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="Table of published times: world, path_length_m, dwa_1, ..., eband_1, ...",
)
@click.option(
    "--figure",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Scatter to write, .png, .svg or .pdf.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def main(
    folders: tuple[Path, ...], reference: Path, figure: Path | None, *, as_json: bool
) -> None:
    """Compare the planners of FOLDERS of runs or campaigns with published times of the same worlds."""
    if figure is not None and figure.suffix not in FIGURES:
        raise click.UsageError(f"--figure {figure}: must end in {', '.join(FIGURES)}")
    try:
        report = calibrate(folders, reference)
        if figure is not None:
            write_scatter(report, figure)
    except BarnError as error:
        raise click.ClickException(str(error)) from None
    if as_json:
        click.echo(json.dumps(make_json_safe(as_dict(report)), indent=2))
        return
    console.print(*map(_table, report.planners))
    for joint in report.joint:
        names = " and ".join(joint.labels)
        click.echo(
            f"Spearman correlation of the mean of {names} over {joint.worlds} worlds: {joint.correlation.text()}"
        )
        click.echo(
            f"R2 of the same, each failure as 30 s: {joint.determination_of_equal_failures.text()}"
        )


if __name__ == "__main__":
    main()
