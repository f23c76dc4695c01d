"""The scatter of our mean times against the published ones, world by world."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from barn_eval.pages.figures import label_axes, new_figure, plain, style, write_figure
from barn_eval.studies.calibration import Calibration, CalibrationReport
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
    """Write a panel per planner to a file ending in one of `FIGURES`; StoreError if it cannot be written."""
    with style():
        figure = scatter(report)
    write_figure(figure, path)


def scatter(report: CalibrationReport) -> Figure:
    """Return the figure; all panels have the same limits."""
    columns = min(_COLUMNS, len(report.planners))
    rows = -(-len(report.planners) // columns)
    figure = new_figure(5.0 * rows + 0.8, 4.8 * columns)
    times = [time for one in report.planners for world in one.worlds for time in (world.ours_s, world.published_s)]
    limits = (0.95 * min(times), 1.05 * max(times))
    for index, one in enumerate(report.planners):
        axes = figure.add_subplot(rows, columns, index + 1)
        _panel(axes, one, limits)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def _panel(axes: Axes, one: Calibration, limits: tuple[float, float]) -> None:
    axes.axline((limits[0], limits[0]), slope=1.0, color=FAINT, lw=1.0, label="equal times")
    for kind, (label, marker, colour) in _KINDS.items():
        worlds = [world for world in one.worlds if (world.our_failures > 0, world.published_failures > 0) == kind]
        axes.scatter(
            [world.published_s for world in worlds],
            [world.ours_s for world in worlds],
            marker=marker,
            s=34,
            facecolor="none" if kind[1] else colour,
            edgecolor=colour,
            label=label,
        )
    title = f"{plain(one.label)}: Spearman {one.correlation.estimate:.2f} over {len(one.worlds)} worlds"
    label_axes(axes, "published mean time of a world [s]", "our mean time [s]", title)
    axes.set(xlim=limits, ylim=limits, box_aspect=1.0)
