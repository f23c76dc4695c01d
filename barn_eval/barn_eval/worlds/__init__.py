"""Worlds: data sets, generated worlds, files for other programs, pictures, and the five difficulty metrics."""

from barn_eval.worlds.generated import generate, generate_moving
from barn_eval.worlds.measured import metrics, motion
from barn_eval.worlds.sets import datasets, draw, load, order, resize, save, write_figure

__all__ = ["datasets", "draw", "generate", "generate_moving", "load", "metrics", "motion", "order", "resize", "save"]
__all__ += ["write_figure"]
