"""BARN: a benchmark of ground-robot navigation. Everything the `barn` command does, for Python and notebooks.

    import barn_eval as barn

    results = barn.run(worlds="0:300:100", planners=["gap", "dwa"], protocol="challenge", workers=2)
    results.table
    results.replay("gap_w0100_r00")

Worlds are in `barn.worlds`, robots in `barn.robots`, the difficulty model in `barn.difficulty`, what reads results in
`barn.results`, and what concerns the suite itself in `barn.suite`. Nothing is imported until it is used. See
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
else:  # what type checkers are told above, found when it is asked for
    _NOUNS = ("difficulty", "results", "robots", "suite", "worlds")
    _NAMES = ("api.types", "api.front")  # what loads fast comes first

    def __getattr__(name: str) -> object:
        """Return a part of the front door, imported now."""
        if name in _NOUNS:
            return import_module(f"{__name__}.api.{name}")
        for module in () if name.startswith("_") else _NAMES:
            found = import_module(f"{__name__}.{module}")
            if hasattr(found, name):
                return getattr(found, name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        """Return what there is, for completion."""
        found = (
            name
            for module in _NAMES
            for name in vars(import_module(f"{__name__}.{module}"))
        )
        return sorted(
            {
                "__version__",
                *_NOUNS,
                *(name for name in found if not name.startswith("_")),
            }
        )
