"""The model card: what weights are, and how well they predict, written from the figures of an evaluation."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from barn_eval.pages.markdown import markdown_table, render_markdown
from barn_metrics.bootstrap import Interval
from barn_metrics.model import DifficultyModel, load_model
from barn_metrics.model.evaluation import Evaluation
from barn_metrics.model.inputs import input_names
from barn_metrics.model.recipes import PAPER, REGULARISED, SHIPPED, recipe_named
from barn_metrics.model.scores import paired_gain


def model_card(
    found: Evaluation, successes: Evaluation | None, weights: Path, elsewhere: Evaluation | None = None
) -> str:
    """Return the card in Markdown; ModelError for weights that are there but cannot be read.

    found: of models trained on folds; successes: likewise, of successful trials alone; elsewhere: of models trained on
    further trials.
    """
    gains = markdown_table(
        (f"`{SHIPPED}` against", "trained", "error lower by [(s/m)^2]", "verdict"), _gains(found, elsewhere)
    )
    return render_markdown(
        "difficulty_card.md",
        found=found,
        successes=successes,
        elsewhere=elsewhere,
        gains=gains,
        inputs=recipe_named(SHIPPED).inputs,
        weights=_about(load_model(weights), weights) if weights.exists() else None,
        scores_table=_scores_table,
    )


def _about(model: DifficultyModel, weights: Path) -> str:
    about = model.about
    return markdown_table(
        ("", ""),
        [
            ("file", f"`{weights.name}`, SHA-256 `{hashlib.sha256(weights.read_bytes()).hexdigest()}`"),
            ("made by", f"`barn difficulty train SOURCE ... --recipe {model.recipe} --seed {about.get('seed')}`"),
            ("what it is", f"{about.get('title')}; {len(model.members)} members"),
            ("inputs", f"{len(input_names(model.inputs))} numbers: `{model.inputs}` of `barn_metrics.model.inputs`"),
            ("trained on", f"{about.get('training_worlds')} worlds, {about.get('training_trials')} trials"),
            ("their worlds", f"SHA-256 of sorted checksums `{about.get('worlds_sha256')}`"),
            ("training error", f"{about.get('training_mse', float('nan')):.3f} (s/m)^2; says nothing of other worlds"),
            ("uncertainty", f"{100.0 * model.relative_std:.0f} % of the prediction, and the members' disagreement"),
        ],
    )


def _scores_table(found: Evaluation) -> str:
    errors = ("training error", "held-out error", "mean absolute [s/m]", "R2", "Spearman")
    rows = []
    for one in found.scores:
        figures = (one.mse, one.mae, one.r2, one.spearman, one.improvement, one.improvement_regularised)
        rows.append((one.recipe, one.title, f"{one.training_mse:.3f}", *(_text(figure) for figure in figures)))
    return markdown_table(("model", "what it is", *errors, f"better than {PAPER}", f"than {REGULARISED}"), rows)


def _gains(found: Evaluation, elsewhere: Evaluation | None) -> Iterator[tuple[str, ...]]:
    evaluations = {"on folds of these worlds": found} | ({"in the other worlds": elsewhere} if elsewhere else {})
    scores = {where: {one.recipe: one for one in evaluation.scores} for where, evaluation in evaluations.items()}
    *_, last = scores.values()
    for where, others in scores.items():
        for name in [one for one in (PAPER, REGULARISED) if one in others and SHIPPED in last]:
            gain = paired_gain(others[name].predictions, last[SHIPPED].predictions, found.difficulty)
            verdict = "better" if gain.estimate > 0.0 else "worse"
            yield f"`{name}`", where, gain.text(), verdict if gain.excludes(0.0) else "not decided"


def _text(found: Interval | None) -> str:
    return "" if found is None else found.text()
