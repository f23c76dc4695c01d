"""Difficulty models from Python, as `barn difficulty` has them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import track

from barn_worlds.base.config import Checked, quantity
from barn_worlds.base.errors import ConfigError

if TYPE_CHECKING:
    from barn_metrics.model import DifficultyModel
    from barn_metrics.model.evaluation import Evaluation, WeightsCheck


@dataclass(frozen=True)
class Training(Checked):
    """How a model of difficulty is trained."""

    planner: str = quantity("", "planner whose times alone are learned, empty for the mean of all")
    dataset: str = quantity("", "where the worlds are, empty for where the results say")
    seed: int = quantity(0, "seed of training", minimum=0, maximum=2**62)


@dataclass(frozen=True)
class Judging(Training):
    """How models of difficulty are judged."""

    folds: int = quantity(10, "parts of the worlds", minimum=2, maximum=1000)
    repeats: int = quantity(5, "divisions into folds", minimum=1, maximum=1000)


Sources = str | Path | Sequence[str | Path]


@dataclass(frozen=True)
class Judged:
    """What `evaluate_difficulty` found; errors are in (s/m)^2, intervals of 95 % over worlds.

    on_folds: models trained on folds; None for worlds of `barn_test`, which are never trained on.
    trained_elsewhere: models trained on further sources alone; None without any.
    """

    on_folds: "Evaluation | None"
    trained_elsewhere: "Evaluation | None"


def train_difficulty(
    sources: Sources,
    out: str | Path,
    *,
    planner: str = "",
    dataset: str = "",
    seed: int = 0,
) -> "DifficultyModel":
    """Train a model of how difficult worlds are on trials, write its weights and return it.

    - sources: folders of results, their results.parquet or results.csv, or tables of published times
    - out: weights to write, .npz
    - planner: learn the times of this one alone, not the mean of all
    - dataset: where the worlds are, if not where the results say

    Raises BarnError in one line for what is not possible.
    """
    from barn_eval.learning.difficulty import read_samples  # noqa: PLC0415 (pyarrow)
    from barn_metrics.model import save_model  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.model.training import train  # noqa: PLC0415

    if Path(out).suffix != ".npz":
        raise ConfigError(f"out {out}: must end in .npz")
    model = train(*read_samples(_paths(sources), planner, dataset), seed)
    save_model(model, Path(out))
    return model


def evaluate_difficulty(
    source: str | Path,
    *,
    folds: int = 10,
    repeats: int = 5,
    further: Sources = (),
    card: str | Path | None = None,
    planner: str = "",
    dataset: str = "",
    seed: int = 0,
    progress: bool = True,
) -> Judged:
    """Judge the model in worlds that it was not trained on, beside ridge regression on the paper's five metrics.

    It is repeated k-fold over the worlds of a source.

    Worlds of `barn_test` are left whole; they judge models that were trained on further sources.

    - source, planner, dataset: as for `train_difficulty`
    - further: sources with other worlds; models trained on these alone are judged too
    - card: model card to write, .md; of the weights of the same name beside it, if there are any

    Raises BarnError in one line for what is not possible.
    """
    from barn_eval.learning.difficulty import model_card, read_samples  # noqa: PLC0415 (pyarrow)
    from barn_metrics.model import evaluation  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.model.training import HELD_OUT, held_out  # noqa: PLC0415
    from barn_worlds.base.files import write_bytes  # noqa: PLC0415

    config = evaluation.EvaluationConfig(folds=folds, repeats=repeats, seed=seed)
    sample = read_samples([Path(source)], planner, dataset)
    other = read_samples(_paths(further), planner) if further else None
    whole = held_out(sample[0].values()) is not None
    if whole and other is None:
        raise ConfigError(f"{source}: {HELD_OUT} is never trained on; name trials in other worlds (--further)")
    if whole and card is not None:
        raise ConfigError(f"card {card}: a card needs trials of another data set than {HELD_OUT}")
    shown = partial(track, description="models", console=Console(stderr=True), transient=True, disable=not progress)
    judge = partial(evaluation.evaluate, *sample, config, track=shown)
    found = Judged(
        on_folds=None if whole else judge(),
        trained_elsewhere=judge(further=other) if other else None,
    )
    if card is not None and found.on_folds is not None:
        weights = Path(card).with_suffix(".npz")
        text = model_card(found.on_folds, weights, found.trained_elsewhere)
        write_bytes(Path(card), text.encode())
    return found


def check_difficulty(
    source: str | Path, *, weights: str | Path | None = None, planner: str = "", dataset: str = ""
) -> "WeightsCheck":
    """Compare trained weights [the shipped ones] with the trials of a source, in worlds not trained on."""
    from barn_eval.learning.difficulty import read_samples  # noqa: PLC0415 (pyarrow)
    from barn_metrics.model import load_model  # noqa: PLC0415 (compiled kernels)
    from barn_metrics.model.evaluation import check_weights  # noqa: PLC0415

    model = load_model(Path(weights) if weights else None)
    return check_weights(model, *read_samples([Path(source)], planner, dataset))


def difficulty(source: str | Path = "barn300", select: str = "all", *, weights: str | Path | None = None) -> Any:
    """Return how difficult the model predicts worlds to be, a row per world.

    Columns: world, name, difficulty_s_per_m (time per metre of path that trials under the paper's protocol count on
    average), std_s_per_m (of trials in a new world around it), the same per planner as PLANNER_s_per_m, and
    failure_probability. weights: file of a model [the shipped one].
    """
    from barn_eval.results import frame_of  # noqa: PLC0415 (pyarrow)

    return frame_of(predictions(source, select, weights)[2])


def predictions(
    source: str | Path, select: str, weights: str | Path | None
) -> "tuple[DifficultyModel, str, list[dict[str, Any]]]":
    """Return the model, the data set's name and what is predicted of each world."""
    from barn_metrics.model import load_model  # noqa: PLC0415 (compiled kernels)
    from barn_worlds.worlds.dataset import open_dataset  # noqa: PLC0415

    model, dataset = load_model(Path(weights) if weights else None), open_dataset(source)
    found = model.predict_dataset(dataset, select)
    rows = [{"world": one, "name": dataset.load(one).name, **made.columns()} for one, made in found.items()]
    return model, dataset.name, rows


def _paths(sources: Sources) -> list[Path]:
    return [Path(sources)] if isinstance(sources, str | Path) else [Path(source) for source in sources]
