"""The hardest worlds with everything that was driven in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from barn_eval.analysis.difficulty import Difficulty
from barn_eval.analysis.sources import Entry
from barn_eval.experiments.track import Track
from barn_eval.pages import drawing
from barn_eval.trials.result import TrialResult
from barn_worlds.world import World

_PER_ROW = 4


@dataclass(frozen=True, eq=False)
class DrivenTrial:
    """A trial on a map: the number of its entry, its result and its track, None if there is none."""

    entry: int
    result: TrialResult
    track: Track | None


def hardest_figure(
    entries: Sequence[Entry],
    order: Difficulty,
    worlds: Mapping[int, World],
    drives: Mapping[int, Sequence[DrivenTrial]],
) -> Figure:
    """Draw each world (by its number, hardest first) with its trails; a cross is where a trial ended that failed."""
    rows = -(-len(worlds) // _PER_ROW)
    figure = drawing.new_figure(4.9 * rows + 0.5)
    panels = figure.subplots(rows, _PER_ROW, squeeze=False).ravel()
    for axes in panels[len(worlds) :]:
        axes.set_axis_off()
    for axes, (number, world) in zip(panels, worlds.items(), strict=False):
        _draw(axes, entries, world, drives[number])
        difficulty = order.mean_s_per_m[order.worlds.index(number)]
        good = sum(drive.result.scores.success for drive in drives[number])
        axes.set_title(f"world {number}: {difficulty:.2f} s/m\n{good} of {len(drives[number])} trials succeed")
    handles = [
        Line2D([], [], color=entry.colour, linewidth=2, marker=drawing.marker_of(index))
        for index, entry in enumerate(entries)
    ]
    failed = Line2D([], [], color=drawing.INK, marker="x", linestyle="", markersize=8, markeredgewidth=2)
    path = Line2D([], [], color=drawing.FAINT, linestyle="--")
    names = [*(entry.label for entry in entries), "end of a failed trial", "shortest path"]
    drawing.legend_below(figure, [*handles, failed, path], names)
    return figure


def _draw(axes: Axes, entries: Sequence[Entry], world: World, drives: Sequence[DrivenTrial]) -> None:
    drawing.discs(axes, world.cylinders_m, world.cylinder_radius_m, facecolor=drawing.FAINT)
    path = world.path_m()
    axes.plot(path[:, 0], path[:, 1], color=drawing.FAINT, linestyle="--", linewidth=1.4)
    for drive in drives:
        if drive.track is None:
            continue
        colour = entries[drive.entry].colour
        trail = drive.track.samples[:, 1:3]
        axes.plot(trail[:, 0], trail[:, 1], color=colour, linewidth=1.5, alpha=0.8)
        if not drive.result.scores.success:
            axes.plot(*trail[-1], color=colour, marker="x", markersize=9, markeredgewidth=2.4, zorder=5)
    left, below, right, above = world.bounds_m
    axes.set_xlim(left, right)
    lowest = min((float(drive.track.samples[:, 2].min()) for drive in drives if drive.track), default=path[0, 1])
    axes.set_ylim(max(below, lowest - 0.8), above + 0.6)
    axes.set_aspect("equal")
    drawing.label_axes(axes, "x [m]", "y [m]")
