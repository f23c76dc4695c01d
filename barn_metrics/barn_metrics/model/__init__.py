"""The learned difficulty of a world: time per meter, predicted from its grid and path.

The label is the paper's (Sec. III-C). Training is a tool in qa/studies/difficulty.
"""

from barn_metrics.model.predictor import DifficultyModel, Prediction
from barn_metrics.model.weights import load_model, save_model
from barn_worlds.base.errors import ModelError

__all__ = ["DifficultyModel", "ModelError", "Prediction", "load_model", "save_model"]
