"""The page and its figures: all they show comes from the findings, so that they are made anew and never edited.

    python -m barn_eval.studies.reproduction.page docs

writes the page in a folder anew from the numbers there, after its wording or figures have changed.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from barn_eval.analysis.planners import assign_colors, spelling
from barn_eval.pages.figures import label_axes, new_figure, style, write_figure
from barn_eval.pages.template import render
from barn_eval.studies.reproduction.findings import (
    Findings,
    Origin,
    read_findings,
    to_json,
)
from barn_eval.studies.reproduction.trials import PLANNERS
from barn_eval.trials.outcome import Outcome
from barn_metrics.bootstrap import Interval, number
from barn_metrics.model.evaluation import RIDGE, RIDGE_TITLE, WEIGHTS
from barn_metrics.report import TABLE_II
from barn_worlds.base.config import as_dict, from_dict
from barn_worlds.base.files import write_durably
from barn_worlds.base.text_files import read_json, read_package_yaml
from barn_worlds.drawing.palette import INK
from barn_worlds.drawing.palette import PLANNERS as SHADES

NAME = "results"
HOLDS, FAILS, OPEN = "holds", "does not hold", "not decided"
_PLANNERS = (*PLANNERS, "both")
PAPER = read_package_yaml("barn_eval", "paper.yaml")
_COLOURS = dict(zip(_PLANNERS, assign_colors(_PLANNERS), strict=True))
_TITLES = {name: spelling(name) for name in PLANNERS} | {"both": "both planners"}


def write_results(findings: Findings, origin: Origin, folder: Path) -> Path:
    """Write results*.json, results.md and figures/results_*.png and return the page's path; StoreError if it fails."""
    write_figures(findings, folder / "figures")
    write_durably(folder / f"{NAME}.json", to_json(findings).encode())
    write_durably(folder / f"{NAME}_origin.json", to_json(origin).encode())
    path = folder / f"{NAME}.md"
    write_durably(path, page(findings, origin).encode())
    return path


def read_results(folder: Path) -> tuple[Findings, Origin]:
    """Return what `write_results` has written; ConfigError in one line if it cannot be read."""
    where = folder / f"{NAME}_origin.json"
    return read_findings(folder / f"{NAME}.json"), from_dict(
        Origin, read_json(where), str(where)
    )


def page(findings: Findings, origin: Origin) -> str:
    """Return the page as Markdown."""
    return render(
        "results.md",
        findings=findings,
        scope=findings.scope,
        settings=as_dict(findings.scope.config),
        origin=origin,
        paper=PAPER,
        table_ii=TABLE_II,
        outcomes=[one.value for one in Outcome],
        variance=float(np.var(findings.learning.difficulty)),
        above=above,
        compared=compared,
    )


def write_figures(findings: Findings, folder: Path) -> None:
    """Write results_*.png; StoreError if one cannot be written."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in (("worlds", worlds_figure), ("model", model_figure)):
        with style():
            figure = draw(findings)
        write_figure(figure, folder / f"results_{name}.png")


def worlds_figure(findings: Findings) -> Figure:
    """Return Fig. 6: worlds from easy to difficult, each planner and both with their spread, and predictions."""
    figure = new_figure(10.5)
    rows, found = findings.trials.worlds, findings.learning
    places = np.arange(1, len(rows) + 1)
    panels = figure.subplots(3, 1, sharex=True, sharey=True)
    for axes, name in zip(panels, ("dwa", "eband", "both"), strict=True):
        means = np.array([row.mean_s_per_m[name] for row in rows])
        spreads = np.array([row.spread_s_per_m[name] for row in rows])
        axes.fill_between(
            places,
            means - spreads,
            means + spreads,
            color=_COLOURS[name],
            alpha=0.25,
            lw=0,
            label="± spread of trials",
        )
        axes.plot(
            places,
            means,
            color=_COLOURS[name],
            lw=1.2,
            label="mean of a world's trials",
        )
        label_axes(axes, "", "time per metre [s/m]", _TITLES[name])
    place = {row.world: number for number, row in enumerate(rows, 1)}
    drawn_at = [place[world] for world in found.world_numbers]
    predicted = found.score(WEIGHTS).predictions
    panels[-1].scatter(
        drawn_at,
        predicted,
        marker=".",
        s=14,
        color=INK,
        zorder=3,
        label="the suite's model, held out",
    )
    panels[-1].set_xlabel(
        "worlds from easy to difficult, by the mean over both planners' trials"
    )
    panels[-1].set_xlim(0.5, len(rows) + 0.5)
    for axes in panels:
        axes.legend(loc="upper left")
    return figure


def model_figure(findings: Findings) -> Figure:
    """Return measured against predicted difficulty of worlds held out, by ridge regression and the suite's model."""
    figure = new_figure(5.6)
    found = findings.learning
    titles = {RIDGE: RIDGE_TITLE, WEIGHTS: "the suite's model"}
    for axes, (name, model) in zip(
        figure.subplots(1, 2, sharex=True, sharey=True), titles.items(), strict=True
    ):
        score = found.score(name)
        axes.scatter(
            score.predictions, found.difficulty, s=14, color=SHADES[0], label="held out"
        )
        axes.axline((3.0, 3.0), slope=1.0, color=INK, lw=1.0, ls="--", label="equal")
        held_out = f"{model}: held-out R2 {score.r2.estimate:.2f}"
        label_axes(
            axes, "predicted difficulty [s/m]", "measured difficulty [s/m]", held_out
        )
        axes.legend(loc="upper left")
    return figure


def above(interval: Interval, value: float = 0.0) -> str:
    """Return the verdict on whether a figure is above a value."""
    if interval.low is None or interval.high is None:
        return OPEN
    return HOLDS if interval.low > value else FAILS if interval.high < value else OPEN


def contains(interval: Interval, value: float) -> str:
    """Return whether a value lies within an interval, yes or no."""
    return (
        "yes" if interval.low is not None and above(interval, value) == OPEN else "no"
    )


def compared(published: float, ours: Interval | float | None, digits: int = 2) -> str:
    """Return four cells: a published number, ours, their difference, whether the published one is in our interval."""
    value = ours.estimate if isinstance(ours, Interval) else ours
    shown = ours.text(digits) if isinstance(ours, Interval) else number(value, digits)
    within = contains(ours, published) if isinstance(ours, Interval) else ""
    change = "" if value is None else f"{value - published:+.{digits}f}"
    return f"{number(published, digits)} | {shown} | {change} | {within}"


if __name__ == "__main__":
    for name in sys.argv[1:]:
        write_results(*read_results(Path(name)), Path(name))
