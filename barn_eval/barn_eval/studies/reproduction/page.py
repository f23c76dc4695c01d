"""Write the page of a reproduction and its figures from the findings."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from barn_eval.analysis.planners import assign_colors, spelling
from barn_eval.pages.figures import label_axes, new_figure, style, write_figure
from barn_eval.pages.template import render, write_page
from barn_eval.studies.reproduction.findings import Findings, Origin, to_json
from barn_eval.studies.reproduction.trials import PLANNERS
from barn_eval.trials.result import Outcome
from barn_metrics.bootstrap import Interval
from barn_metrics.report import TABLE_II
from barn_worlds.base.config import as_dict
from barn_worlds.base.files import read_package_yaml
from barn_worlds.drawing.palette import INK
from barn_worlds.drawing.palette import PLANNERS as SHADES

NAME = "results"
HOLDS = "holds"
FAILS = "does not hold"
OPEN = "not decided"
PAPER = read_package_yaml("barn_eval", "paper.yaml")
_PANELS = (*PLANNERS, "both")
_COLORS = dict(zip(_PANELS, assign_colors(_PANELS), strict=True))
_TITLES = {name: spelling(name) for name in PLANNERS} | {"both": "both planners"}
_MODEL_TITLE = "the suite's model"


def write_results(findings: Findings, origin: Origin, folder: Path) -> Path:
    """Write results.md, results*.json and figures/results_*.png; return the .md path.

    Args:
        findings: Findings of the reproduction.
        origin: Versions and machines.
        folder: Folder to write to.

    Raises:
        StoreError: If a file cannot be written.
    """
    write_figures(findings, folder / "figures")
    write_page(folder / f"{NAME}.json", to_json(findings))
    write_page(folder / f"{NAME}_origin.json", to_json(origin))
    path = folder / f"{NAME}.md"
    write_page(path, page(findings, origin))
    return path


def page(findings: Findings, origin: Origin) -> str:
    """Return the Markdown text of results.md, rendered from its template.

    Args:
        findings: Findings of the reproduction.
        origin: Versions and machines.
    """
    return render(
        "results.md",
        findings=findings,
        scope=findings.scope,
        settings=as_dict(findings.scope.config),
        origin=origin,
        paper=PAPER,
        table_ii=TABLE_II,
        outcomes=[outcome.value for outcome in Outcome],
        above=above,
        contains=contains,
    )


def write_figures(findings: Findings, folder: Path) -> None:
    """Write results_worlds.png and results_model.png; create the folder if missing.

    Args:
        findings: Findings of the reproduction.
        folder: Folder to write to.

    Raises:
        StoreError: If a file cannot be written.
    """
    # The style applies while a figure is drawn; writing applies it again.
    for name, draw in (("worlds", worlds_figure), ("model", model_figure)):
        with style():
            figure = draw(findings)
        write_figure(figure, folder / f"results_{name}.png")


def worlds_figure(findings: Findings) -> Figure:
    """Return Fig. 6: a panel per planner and of both, time [s/m] from easy to difficult."""
    rows = findings.trials.worlds
    places = np.arange(1, len(rows) + 1)
    figure = new_figure(10.5)
    panels = figure.subplots(3, 1, sharex=True, sharey=True)
    for axes, name in zip(panels, _PANELS, strict=True):
        color = _COLORS[name]
        means = np.array([row.mean_s_per_m[name] for row in rows])
        spreads = np.array([row.spread_s_per_m[name] for row in rows])
        axes.fill_between(
            places,
            means - spreads,
            means + spreads,
            color=color,
            alpha=0.25,
            lw=0,
            label="± spread of trials",
        )
        axes.plot(places, means, color=color, lw=1.2, label="mean of a world's trials")
        label_axes(axes, "", "time per meter [s/m]", _TITLES[name])

    panels[-1].scatter(
        places,
        findings.model.predicted_s_per_m,
        marker=".",
        s=14,
        color=INK,
        zorder=3,
        label=f"{_MODEL_TITLE}, held out",
    )
    panels[-1].set_xlabel(
        "worlds from easy to difficult, by the mean over both planners' trials"
    )
    panels[-1].set_xlim(0.5, len(rows) + 0.5)
    for axes in panels:
        axes.legend(loc="upper left")
    return figure


def model_figure(findings: Findings) -> Figure:
    """Return a plot of measured over predicted difficulty [s/m] of held-out worlds."""
    model = findings.model
    measured = [row.mean_s_per_m["both"] for row in findings.trials.worlds]
    figure = new_figure(5.6)
    axes = figure.subplots()
    axes.scatter(
        model.predicted_s_per_m, measured, s=14, color=SHADES[0], label="held out"
    )
    axes.axline((3.0, 3.0), slope=1.0, color=INK, lw=1.0, ls="--", label="equal")
    label_axes(
        axes,
        "predicted difficulty [s/m]",
        "measured difficulty [s/m]",
        f"{_MODEL_TITLE}: held-out R2 {model.r2.estimate:.2f}",
    )
    axes.legend(loc="upper left")
    return figure


def above(interval: Interval, value: float = 0.0) -> str:
    """Return HOLDS if both limits exceed `value`, FAILS if both are below, else OPEN.

    Args:
        interval: A figure with its 95% interval; without limits, it is OPEN.
        value: The value to compare with.
    """
    if interval.low is None or interval.high is None:
        return OPEN
    if interval.low > value:
        return HOLDS
    return FAILS if interval.high < value else OPEN


def contains(interval: Interval, value: float) -> str:
    """Return "yes" if `value` lies within the limits, inclusive, else "no".

    Args:
        interval: An interval; one without limits contains nothing.
        value: The value.
    """
    is_within = interval.low is not None and above(interval, value) == OPEN
    return "yes" if is_within else "no"
