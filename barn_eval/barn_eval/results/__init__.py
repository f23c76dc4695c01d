"""The folder of a run, for readers who never run a trial.

`barn.results` offers the functions of `barn_eval.api.results` under the same names.
"""

from importlib import import_module


def __getattr__(name: str) -> object:
    """Return a function or class of `barn_eval.api.results`, or what it offers."""
    if name.startswith("_") and name != "__all__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("barn_eval.api.results"), name)


def __dir__() -> list[str]:
    """Return the modules of this folder and the names of `barn_eval.api.results`."""
    return sorted({*globals(), *import_module("barn_eval.api.results").__all__})
