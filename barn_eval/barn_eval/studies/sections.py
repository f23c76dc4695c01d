"""The sections of the page: tables of ours beside the published numbers, figures, and what is to be said of both."""

from __future__ import annotations

from barn_eval.analysis.planner_style import spelling
from barn_eval.studies import learning, metrics, paper
from barn_eval.studies.findings import Findings
from barn_eval.studies.markdown import listed, table
from barn_eval.studies.remarks import remarks_on_metrics, remarks_on_models, remarks_on_transfer, remarks_on_trials
from barn_eval.studies.transfer import Regression
from barn_eval.studies.verdict import contains
from barn_metrics.bootstrap import Interval, number


def metrics_section(findings: Findings) -> list[str]:
    """Return Table II beside the published one."""
    rows = []
    for row in findings.metrics.rows:
        published = metrics.published(row.name)
        rows.append(
            (
                row.title,
                f"{published.minimum:.2f} / {row.minimum:.2f}",
                f"{published.maximum:.2f} / {row.maximum:.2f}",
                f"{published.mean:.2f} / {row.mean.text()}",
                f"{published.std:.2f} / {row.std.text()}",
                f"{row.corrected_mean:.2f} ± {row.corrected_std:.2f}",
            )
        )
    return [
        f"## Table II: the data set ({findings.metrics.worlds} worlds)",
        "",
        "Published / ours. Minimum and maximum are over the cells of all paths, for tortuosity over paths. The last"
        " column takes the corrected formulas, which `docs/metrics.md` explains.",
        "",
        *table(("metric", "min.", "max.", "mean", "std.", "corrected"), rows),
        "",
        *listed(remarks_on_metrics(findings)),
    ]


def trials_section(findings: Findings) -> list[str]:
    """Return times and failures of both planners, and Fig. 6."""
    trials = findings.trials
    lines = ["## The trials", ""]
    for one in trials.planners:
        published = paper.TRIALS[one.planner]
        pairs: list[tuple[str, float, Interval, int]] = [
            ("time per metre as counted [s/m]", published.normalised_s_per_m, one.normalised_s_per_m, 2),
            ("its ±: over a world's trials [s/m]", published.spread_s_per_m, one.spread_s_per_m, 2),
            ("its deviation over worlds [s/m]", published.over_worlds_s_per_m, one.over_worlds_s_per_m, 2),
            ("time as counted [s]", published.time_s, one.time_s, 2),
            ("time of successes [s]", published.success_time_s, one.success_time_s, 2),
            ("failures [%]", 100.0 * published.failure_share, one.failure_share.scaled(100.0), 1),
        ]
        rows = [_compared(*pair) for pair in pairs]
        rows += [
            _plain("time that a failure counts [s]", published.failure_time_s, one.failure_time_s, 1),
            _plain("time in the easiest tenth of the worlds [s]", published.easy_s, one.easy_s, 1),
            _plain("time in the most difficult tenth [s]", published.hard_s, one.hard_s, 1),
            _plain("repeatability: two trials against the others, Spearman", published.halves, one.halves, 2),
        ]
        head = (f"{spelling(one.planner)}, {one.trials} trials", "published", "ours", "difference", "within ours")
        lines += [*table(head, rows), ""]
    rows = [
        _compared("DWA's means against E-Band's", paper.PLANNERS_CORRELATION, trials.planners_correlation, 2),
        _plain("one half of a world's trials against the other", paper.HALVES, trials.halves, 2),
    ]
    head = ("Spearman correlation over worlds", "published", "ours", "difference", "within ours")
    outcomes = "; ".join(
        f"{spelling(one.planner)} " + ", ".join(f"{name} {count}" for name, count in one.outcomes.items())
        for one in trials.planners
    )
    return [
        *lines,
        *table(head, rows),
        "",
        f"Outcomes of ours: {outcomes}.",
        "",
        *listed(remarks_on_trials(findings)),
        "### Fig. 6: worlds from easy to difficult",
        "",
        "![Time per metre of each world](figures/results_worlds.png)",
        "",
        "Worlds are in the order of the mean over both planners' trials, as in the paper. The band is the standard"
        " deviation over a world's trials. The paper draws the prediction of a network that was trained on the same"
        " worlds; beside it stands that of a model that had not seen the world.",
        "",
    ]


def models_section(findings: Findings) -> list[str]:
    """Return losses in training and on held-out worlds."""
    found = findings.learning
    rows = [
        (
            "published: the paper's network",
            number(paper.MODEL.training_mse),
            number(paper.MODEL.mse),
            number(paper.MODEL.mae_s_per_m),
            number(paper.MODEL.r2),
            number(paper.MODEL.spearman),
            "",
        )
    ]
    rows += [
        (
            _recipe_title(one),
            number(one.training_mse),
            one.mse.text(),
            one.mae_s_per_m.text(),
            one.r2.text(),
            one.spearman.text(),
            "" if one.improvement is None else one.improvement.text(),
        )
        for one in found.recipes
    ]
    head = (
        "model",
        "training loss",
        "held-out loss",
        "MAE [s/m]",
        "R2",
        "Spearman",
        "loss below the paper's network's",
    )
    return [
        "## The difficulty model",
        "",
        "Loss is the mean squared error in (s/m)^2. The training loss is that of a model trained on all worlds, on"
        f" these; everything else is of worlds held out, {found.folds}-fold, {found.repeats} times. The suite's"
        " model is the shipped one: it was not trained here, and its training loss is that of its own worlds, with one"
        " trial per planner. The published held-out figures were measured later, on the published trial table.",
        "",
        *table(head, rows),
        "",
        "![Measured against predicted difficulty](figures/results_model.png)",
        "",
        *listed(remarks_on_models(findings)),
    ]


def transfer_section(findings: Findings) -> list[str]:
    """Return Fig. 8 and the lines through it."""
    found = findings.transfer
    before = findings.scope.simulator
    changes = [
        (f"`{name}`", _value(before[name.split(".")[0]][name.split(".")[1]]), _value(value))
        for name, value in findings.scope.sensor.items()
    ]
    shown = findings.scope.config.transfer_worlds
    published = ("published (Fig. 8, real robot)", *(f"{paper.SLOPES[name]:.2f}" for name in ("both", "dwa", "eband")))
    rows = [(*published, f"{paper.SLOPES['dwa'] - paper.SLOPES['eband']:.2f}", "almost 0", "")]
    rows += [_line_row(one, f"{shown} worlds") for one in found.figure]
    rows += [_line_row(one, f"all {len(found.worlds)}") for one in found.all_worlds]
    head = ("predicted by, in", "slope, both", "DWA", "E-Band", "DWA - E-Band", "intercept [s/m]", "Spearman")
    return [
        "## Fig. 8: new worlds, no map, another sensor",
        "",
        f"{found.generated} worlds from another seed, of which {len(found.worlds)} were driven. Each model's figure"
        f" has the {shown} in the middle of each part of their order by its prediction, chosen by nothing else. The"
        " planners get no map, sensor and noise differ as below. The paper's network was trained on the trials"
        " above, the suite's model in other worlds; lines are fitted to single trials, in the figure to those of its"
        " worlds. The paper's experiment was with a real robot among boxes; this one asks the same of the predictions"
        " within simulation.",
        "",
        "![Measured against predicted time per metre](figures/results_transfer.png)",
        "",
        *table(head, rows),
        "",
        *listed(remarks_on_transfer(findings)),
        *table(("simulator", "trials above", "new worlds"), changes),
        "",
    ]


def _compared(name: str, published: float, ours: Interval, digits: int) -> tuple[str, ...]:
    inside = "yes" if contains(ours, published) else "no"
    return (
        name,
        number(published, digits),
        ours.text(digits),
        f"{ours.estimate - published:+.{digits}f}",
        inside,
    )


def _plain(name: str, published: float, ours: float | None, digits: int) -> tuple[str, ...]:
    difference = "" if ours is None else f"{ours - published:+.{digits}f}"
    return name, number(published, digits), number(ours, digits), difference, ""


def _line_row(found: Regression, where: str) -> tuple[str, ...]:
    lines = found.lines
    return (
        f"{learning.TITLES[found.model]}, {where}",
        *(lines[name].slope.text() for name in ("both", "dwa", "eband")),
        found.steeper.text(),
        lines["both"].intercept_s_per_m.text(),
        found.correlation.text(),
    )


def _recipe_title(one: learning.RecipeFinding) -> str:
    return f"the suite's model: {one.title}" if one.recipe == learning.SHIPPED else one.title


def _value(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
