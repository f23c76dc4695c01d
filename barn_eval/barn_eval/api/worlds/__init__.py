"""Worlds: data sets, generated worlds, files for other programs, pictures, and the five difficulty metrics."""

from barn_eval.api.worlds.generated import generate, generate_moving
from barn_eval.api.worlds.sets import (
    datasets,
    draw,
    load,
    metrics,
    resize,
    save,
    write_figure,
)

__all__ = [
    "datasets",
    "draw",
    "generate",
    "generate_moving",
    "load",
    "metrics",
    "resize",
    "save",
    "write_figure",
]
