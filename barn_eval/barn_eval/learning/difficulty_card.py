"""The model card: what weights are, and how well they predict, written from the figures of an evaluation."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from barn_eval.pages.page import render
from barn_metrics.bootstrap import Interval
from barn_metrics.model import load_model
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
    return render(
        "difficulty_card.md",
        found=found,
        successes=successes,
        elsewhere=elsewhere,
        gains=_gains(found, elsewhere),
        paper=PAPER,
        regularised=REGULARISED,
        shipped=SHIPPED,
        inputs=recipe_named(SHIPPED).inputs,
        weights=_about(weights) if weights.exists() else None,
    )


def _about(weights: Path) -> dict[str, Any]:
    model = load_model(weights)
    sha256 = hashlib.sha256(weights.read_bytes()).hexdigest()
    return {"file": weights.name, "sha256": sha256, "model": model, "inputs": len(input_names(model.inputs))}


def _gains(found: Evaluation, elsewhere: Evaluation | None) -> Iterator[tuple[str, str, Interval]]:
    """Yield each network, where it was trained, and by how much the shipped kind's error is lower."""
    evaluations = {"on folds of these worlds": found} | ({"in the other worlds": elsewhere} if elsewhere else {})
    scores = {where: {one.recipe: one for one in evaluation.scores} for where, evaluation in evaluations.items()}
    *_, last = scores.values()
    for where, others in scores.items():
        for name in [one for one in (PAPER, REGULARISED) if one in others and SHIPPED in last]:
            yield name, where, paired_gain(others[name].predictions, last[SHIPPED].predictions, found.difficulty)
