"""Results at a glance, for notebooks and scripts."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from barn_eval.analysis.difficulty import by_world
from barn_eval.analysis.measures import MEASURES, metric_of
from barn_eval.analysis.planner_style import colours, spelling
from barn_eval.analysis.sources import by_planner
from barn_eval.analysis.summary import summarise
from barn_eval.pages import drawing
from barn_eval.trials.result import TrialResult


def plot_results(results: Sequence[TrialResult]) -> Figure:
    """Draw at least one result, of one protocol: its metric and success by planner, and time by world.

    Bars are 95 % intervals over worlds.
    """
    groups = by_planner(results)
    names, time = list(groups), MEASURES["normalised_time_s_per_m"]
    with drawing.style():
        figure = drawing.new_figure(2.4 + 0.3 * len(names))
        figure.patch.set_facecolor("white")
        *left, right = figure.subplots(1, 3, width_ratios=(1, 1, 2))
        for axes, measure in zip(left, (metric_of(results[0].protocol), MEASURES["success"]), strict=True):
            for place, (name, colour) in enumerate(zip(names, colours(names), strict=True)):
                mean = measure.shown(summarise(groups[name], (measure.key,))[measure.key])
                drawing.points(axes, [place], [mean], colour, drawing.marker_of(place), flat=True)
            drawing.label_axes(axes, measure.heading, "")
            axes.set_yticks(range(len(names)), [drawing.plain(spelling(name)) for name in names])
            axes.set_ylim(len(names) - 0.5, -0.5)
            axes.set_xlim(left=0)
        for place, (name, colour) in enumerate(zip(names, colours(names), strict=True)):
            worlds = by_world(groups[name])
            means = [np.mean(time.values(trials)) for trials in worlds.values()]
            marker = drawing.marker_of(place)
            right.plot(list(worlds), means, linestyle="", marker=marker, color=colour, alpha=0.8, label=spelling(name))
        drawing.label_axes(right, "world", time.heading)
        right.xaxis.set_major_locator(MaxNLocator(integer=True))
        right.set_ylim(bottom=0)
    return figure
