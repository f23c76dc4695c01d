"""The learned difficulty of a world: normalised time, predicted from its grid and path (paper, Sec. III-C).

Prediction needs numpy, scipy and numba alone; training needs PyTorch and, for its trees, scikit-learn.
"""

from barn_metrics.model.errors import ModelError
from barn_metrics.model.predictor import DifficultyModel, Prediction
from barn_metrics.model.weights import load_model, save_model

__all__ = ["DifficultyModel", "ModelError", "Prediction", "load_model", "save_model"]
