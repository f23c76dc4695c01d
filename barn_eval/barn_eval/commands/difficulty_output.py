"""What `barn difficulty` prints: tables of predictions and of scores, and a bar while models are trained."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

from rich.progress import Progress
from rich.table import Table

from barn_eval.commands.options import notes, row, table

if TYPE_CHECKING:
    from barn_metrics.bootstrap import Interval
    from barn_metrics.model.evaluation import Evaluation, RecipeScore

# Columns of every prediction; those of planners come beside them.
_OWN = ("difficulty_s_per_m", "std_s_per_m")


def predictions_table(lines: list[dict[str, Any]]) -> Table:
    """Return predictions, a line each as in the JSON, as a table."""
    planners = [name for name in lines[0] if name.endswith("_s_per_m") and name not in _OWN]
    columns = [f">{name.removesuffix('_s_per_m')} [s/m]" for name in planners]
    made = table("world", ">difficulty [s/m]", ">+-", *columns, ">failures [%]")
    for line in lines:
        failures = line["failure_probability"]
        numbers = [f"{line[name]:.2f}" for name in (*_OWN, *planners)]
        row(made, line["name"], *numbers, "-" if failures is None else f"{100.0 * failures:.0f}")
    return made


def scores_table(found: Evaluation, title: str) -> Table:
    """Return the scores of an evaluation as a table; title: which trials it judges by."""
    trained = f"trained in {found.further_worlds} others, {found.repeats} x"
    made = table(
        "model",
        ">training error",
        ">held-out error",
        ">R2",
        ">Spearman",
        ">better than the paper's network by",
        ">than the same, regularised, by",
        title=f"{found.worlds} worlds, {title}: "
        + (trained if found.further_worlds else f"{found.repeats} x {found.folds} folds"),
    )
    for score in found.scores:
        row(made, score.recipe, f"{score.training_mse:.3f}", *map(estimate, _figures(score)))
    ceiling = found.ceiling
    if ceiling.reliability is not None:
        made.caption = f"highest R2 that these trials allow, from split halves: {estimate(ceiling.reliability)}"
        made.caption_justify = "left"
    return made


def _figures(score: RecipeScore) -> tuple[Interval | None, ...]:
    return score.mse, score.r2, score.spearman, score.improvement, score.improvement_regularised


def estimate(found: Interval | None) -> str:
    """Return an estimate with its interval, nothing where there is none."""
    return "" if found is None else found.text()


class _Bar(AbstractContextManager["_Bar"]):
    """A bar on standard error that an evaluation moves on."""

    def __init__(self) -> None:
        self._bar = Progress(console=notes, transient=True)
        self._task = self._bar.add_task("models")

    def __enter__(self) -> _Bar:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def __call__(self, done: int, total: int) -> None:
        self._bar.update(self._task, completed=done, total=total)


def bar(quiet: bool) -> AbstractContextManager[Callable[[int, int], None] | None]:
    """Return a bar on standard error that shows how many recipes of how many are done, or none if quiet."""
    return nullcontext() if quiet else _Bar()
