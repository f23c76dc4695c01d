"""The learned difficulty of a world: normalised time, predicted from its grid and path (paper, Sec. III-C).

Prediction needs numpy, scipy and numba alone; training needs PyTorch.
"""

from pathlib import Path

from barn_metrics.model.predictor import DifficultyModel, Prediction
from barn_metrics.model.weights import load_model, save_model
from barn_worlds.base.errors import ModelError
from barn_worlds.worlds.dataset import open_dataset

__all__ = ["DifficultyModel", "ModelError", "Prediction", "load_model", "predict_difficulty", "save_model"]


def predict_difficulty(
    source: str | Path, worlds: str = "all", weights: Path | str | None = None
) -> dict[int, Prediction]:
    """Return how difficult the worlds of a data set, folder or file are predicted to be, by number.

    worlds: which of them, such as "0-49" or "0:300:60"; weights: of a trained model, if not those that come with the
    package. Raises WorldError or ModelError in one line for what cannot be read or predicted.
    """
    return load_model(weights).predict_dataset(open_dataset(source), worlds)
