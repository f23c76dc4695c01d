"""Results folders of runs: write and read them.

`barn.results` offers the functions of `barn_eval.api.results` under the same names.
"""

from importlib import import_module


def __getattr__(name: str) -> object:
    """Return an attribute of `barn_eval.api.results`; AttributeError if private."""
    if name.startswith("_") and name != "__all__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("barn_eval.api.results"), name)


def __dir__() -> list[str]:
    """Return the sorted names of this module and of `barn_eval.api.results`."""
    return sorted({*globals(), *import_module("barn_eval.api.results").__all__})
