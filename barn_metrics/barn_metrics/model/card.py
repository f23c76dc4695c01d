"""The model card: what weights are, and what they are worth, written from the figures of an evaluation."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from barn_metrics.bootstrap import Interval
from barn_metrics.model.evaluation import (
    PAPER,
    REGULARISED,
    Evaluation,
    EvaluationConfig,
    RecipeScore,
    evaluate,
    paired_gain,
)
from barn_metrics.model.inputs import input_names
from barn_metrics.model.predictor import DifficultyModel
from barn_metrics.model.recipes import recipe_named
from barn_metrics.model.trials import Trials
from barn_metrics.model.weights import LARGEST_FILE, load_model
from barn_worlds.formats.files import read_bytes
from barn_worlds.world import World

# What is also judged on successful trials alone: how much of what is not explained comes from failures.
JUDGED_APART = ("linear", "paper_regularised", "rich_linear", "rich_trees", "rich", "routes")
SHIPPED = "routes"


def judge_successes(
    worlds: Mapping[int, World], trials: Trials, recipes: Sequence[str], config: EvaluationConfig
) -> Evaluation | None:
    """Return the evaluation of recipes on the time of successful trials, None where too few worlds have any."""
    successes = trials.successes()
    if successes is None or not recipes or successes.planner_names != trials.planner_names:
        return None
    if len(successes.world_numbers) < 2 * config.folds:
        return None
    return evaluate(worlds, successes, recipes, config)


def model_card(
    found: Evaluation, successes: Evaluation | None, weights: Path, elsewhere: Evaluation | None = None
) -> str:
    """Return the card in Markdown; ModelError for weights that are there but cannot be read.

    found: of models trained on folds; elsewhere: of models trained on further trials alone.
    """
    parts = ["# Difficulty of worlds: model card\n", _what(found)]
    if weights.exists():
        parts.append(_about(load_model(weights), weights))
    parts += ["## Held-out worlds, all trials\n", _how(found), _table(found), _ceiling(found)]
    if elsewhere is not None:
        parts += ["## The same worlds, models trained in other ones\n", _how(elsewhere), _table(elsewhere)]
    if successes is not None:
        parts += ["## Held-out worlds, successful trials alone\n", _table(successes), _ceiling(successes)]
    parts += [_verdict(found, successes, elsewhere), _limits(found), *(f"Note: {note}.\n" for note in found.notes)]
    return "\n".join(parts)


def _what(found: Evaluation) -> str:
    return (
        "The model predicts the difficulty of a world: the time per metre of path [s/m] that trials take there, "
        f"failures as the protocol counts them, averaged over {' and '.join(found.planners)} and over repetitions. "
        "Every figure of this page is written by `barn difficulty evaluate SOURCE --card FILE`; none is typed in.\n"
    )


def _about(model: DifficultyModel, weights: Path) -> str:
    about = model.about
    checksum = hashlib.sha256(read_bytes(weights, LARGEST_FILE)).hexdigest()
    facts = (
        ("file", f"`{weights.name}`, SHA-256 `{checksum}`"),
        ("made by", f"`barn difficulty train SOURCE ... --recipe {model.recipe} --seed {about.get('seed')}`"),
        ("what it is", f"{about.get('title')}; {len(model.members)} members"),
        (
            "inputs",
            f"{len(input_names(model.inputs))} numbers of the set `{model.inputs}` (`barn_metrics.model.inputs`)",
        ),
        ("trained on", f"{about.get('training_worlds')} worlds, {about.get('training_trials')} trials"),
        ("their worlds", f"SHA-256 of sorted checksums `{about.get('worlds_sha256')}`"),
        ("training error", f"{about.get('training_mse', float('nan')):.3f} (s/m)^2, no measure of what it is worth"),
        ("uncertainty", f"{100.0 * model.relative_std:.0f} % of the prediction, and the members' disagreement"),
    )
    return "\n".join(["## The weights\n", "| | |", "| --- | --- |", *(f"| {a} | {b} |" for a, b in facts), ""])


def _how(found: Evaluation) -> str:
    trained = (
        f"models trained {found.repeats} times, on {found.further_trials} trials in {found.further_worlds} other worlds"
        if found.further_worlds
        else f"{found.repeats} x {found.folds} folds over worlds"
    )
    return (
        f"{found.worlds} worlds, {found.trials} trials; {trained}, "
        f"seed {found.seed}. No model has seen the worlds it is judged on. Errors are mean squared errors in (s/m)^2; "
        "brackets are 95 % intervals over worlds (BCa). The last two columns are paired differences: above zero the "
        "model is better than the paper's network, trained until it overfits as the paper's did, and held back "
        "from it.\n"
    )


def _table(found: Evaluation) -> str:
    lines = [
        "| model | what it is | training error | held-out error | mean absolute [s/m] | R2 | Spearman "
        "| better than paper | than paper_regularised |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for score in found.scores:
        figures = (score.mse, score.mae, score.r2, score.spearman, score.improvement, score.improvement_regularised)
        cells = [score.recipe, score.title, f"{score.training_mse:.3f}", *map(_estimate, figures)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def _ceiling(found: Evaluation) -> str:
    ceiling = found.ceiling
    if ceiling.reliability is None or ceiling.half_spearman is None or ceiling.noise_mse is None:
        return "Worlds with one trial per planner give no noise ceiling.\n"
    return (
        f"Noise ceiling: halves of the repetitions agree with a rank correlation of {ceiling.half_spearman:.2f}; "
        "carried to all repetitions (Spearman-Brown) the highest R2 these trials allow is "
        f"{_estimate(ceiling.reliability)}. The true difficulty itself would have an error of "
        f"{ceiling.noise_mse:.3f} (s/m)^2.\n"
    )


def _verdict(found: Evaluation, successes: Evaluation | None, elsewhere: Evaluation | None) -> str:
    shipped = _found(elsewhere or found, SHIPPED)
    if shipped is None:
        return ""
    lines = ["## What this says\n"]
    judged = [(found, "on folds of these worlds"), *([(elsewhere, "in the other worlds")] if elsewhere else [])]
    for evaluation, where in judged:
        for name in (PAPER, REGULARISED):
            score = _found(evaluation, name)
            if score is not None:
                gain = paired_gain(score.predictions, shipped.predictions, found.difficulty)
                sure = "the interval excludes zero" if gain.excludes(0.0) else "it includes zero"
                lines.append(f"- Against `{name}`, trained {where}: error lower by {_estimate(gain)}; {sure}.")
    lines.append(f"- Trained {judged[-1][1]}, it explains {_share(shipped)} of the variance of what it has not seen.")
    alone = None if successes is None else _found(successes, SHIPPED)
    if alone is not None:
        lines.append(f"- Of the time of successes alone, its kind explains {_share(alone)}, trained on folds.")
    return "\n".join([*lines, ""])


def _found(evaluation: Evaluation, recipe: str) -> RecipeScore | None:
    return next((score for score in evaluation.scores if score.recipe == recipe), None)


def _share(score: RecipeScore) -> str:
    return score.r2.scaled(100.0).text(0, " %")


def _limits(found: Evaluation) -> str:
    inputs = recipe_named(SHIPPED).inputs
    return (
        "## For what it is meant\n\n"
        "For ordering worlds, drawing worlds of a wanted difficulty and placing new worlds beside known ones. It knows "
        f"worlds of cylinders as the generator makes them, {' and '.join(found.planners)} in one configuration, and "
        f"one protocol; its inputs (`{inputs}`) include start and goal of the paper's trials. For other robots, "
        "planners or protocols train it anew on their trials. Intervals are over worlds; that folds share training "
        "worlds is not in them.\n"
    )


def _estimate(found: Interval | None) -> str:
    return "" if found is None else found.text()
