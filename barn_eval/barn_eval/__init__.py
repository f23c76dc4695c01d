"""BARN, a benchmark of ground-robot navigation, from Python and notebooks.

    import barn_eval as barn

    results = barn.run("0:300:100", ["gap", "dwa"], "challenge", workers=2)
    results.table
    results.replay("gap_w0100_r00")

Everything that the `barn` command does is here or in `barn.worlds`, `barn.robots`,
`barn.difficulty` (the difficulty model), `barn.results` (reading results) and
`barn.suite` (the suite itself). Nothing is imported until it is used. See
docs/python.md.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from barn_worlds import __version__ as __version__

if TYPE_CHECKING:
    from barn_eval.api import difficulty as difficulty
    from barn_eval.api import results as results
    from barn_eval.api import robots as robots
    from barn_eval.api import suite as suite
    from barn_eval.api import worlds as worlds
    from barn_eval.api.front import *
    from barn_eval.api.types import *
else:
    # The same for programs, imported at the first access.
    _SUBMODULES = ("difficulty", "results", "robots", "suite", "worlds")

    # Modules whose names are at the top; what loads fast comes first.
    _MODULES = ("api.types", "api.front")

    def __getattr__(name: str) -> object:
        """Return a submodule or public name, imported now; AttributeError if unknown."""
        if name in _SUBMODULES:
            return import_module(f"{__name__}.api.{name}")
        if not name.startswith("_"):
            for module_name in _MODULES:
                module = import_module(f"{__name__}.{module_name}")
                if hasattr(module, name):
                    return getattr(module, name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        """Import the modules of public names and return all names, for completion."""
        names = {"__version__", *_SUBMODULES}
        for module_name in _MODULES:
            names |= vars(import_module(f"{__name__}.{module_name}")).keys()
        return sorted(name for name in names if name == "__version__" or name[0] != "_")
