"""The folder of a run, for readers who never run a trial.

`barn.results` offers the functions of `barn_eval.api.results` under the same names.
"""

from importlib import import_module


def __getattr__(name: str) -> object:
    """Return a function or class of `barn_eval.api.results`."""
    if name.startswith("_"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("barn_eval.api.results"), name)
