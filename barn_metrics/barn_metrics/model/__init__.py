"""The learned difficulty of a world: normalised time, predicted from its grid and path (paper, Sec. III-C).

Prediction needs numpy, scipy and numba alone; training needs PyTorch.
"""

from barn_metrics.model.predictor import DifficultyModel, Prediction
from barn_metrics.model.weights import load_model, save_model
from barn_worlds.base.errors import ModelError

__all__ = ["DifficultyModel", "ModelError", "Prediction", "load_model", "save_model"]
