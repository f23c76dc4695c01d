"""The folder of a run: rows, tracks and bags, for readers who never run a trial.

`barn.results` offers the functions of `barn_eval.api.results` under the same names.
"""

from importlib import import_module


def __getattr__(name: str) -> object:
    """Return a function or class of `barn_eval.api.results`, or their names."""
    if name.startswith("_") and name != "__all__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("barn_eval.api.results"), name)
