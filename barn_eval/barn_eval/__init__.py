"""BARN: a benchmark of ground-robot navigation. Everything the `barn` command does, for Python and notebooks.

    import barn_eval as barn

    results = barn.run(worlds="0:300:100", planners=["gap", "dwa"], protocol="challenge", workers=2)
    results.table
    results.replay("gap_w0100_r00")

Nothing is imported until it is used. See docs/python.md.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from barn_worlds import __version__ as __version__

if TYPE_CHECKING:
    from barn_eval.api import load as load
    from barn_eval.api import plan as plan
    from barn_eval.api import run as run
    from barn_eval.experiments.experiment import PlannerChoice as PlannerChoice
    from barn_eval.known_robots import draw_robot as draw_robot
    from barn_eval.known_robots import robots as robots
    from barn_eval.models import check_difficulty as check_difficulty
    from barn_eval.models import difficulty as difficulty
    from barn_eval.models import evaluate_difficulty as evaluate_difficulty
    from barn_eval.models import train_difficulty as train_difficulty
    from barn_eval.moving_sets import generate_moving as generate_moving
    from barn_eval.results import Results as Results
    from barn_eval.results import check as check
    from barn_eval.results import compare as compare
    from barn_eval.results import leaderboard as leaderboard
    from barn_eval.results import overlay as overlay
    from barn_eval.results import replay as replay
    from barn_eval.results import report as report
    from barn_eval.results import watch as watch
    from barn_eval.suite import bench as bench
    from barn_eval.suite import info as info
    from barn_eval.suite import reproduce as reproduce
    from barn_eval.suite import validate as validate
    from barn_eval.world_sets import datasets as datasets
    from barn_eval.world_sets import draw as draw
    from barn_eval.world_sets import generate_worlds as generate_worlds
    from barn_eval.world_sets import metrics as metrics
    from barn_eval.world_sets import order_worlds as order_worlds
    from barn_eval.world_sets import resize_worlds as resize_worlds
    from barn_eval.world_sets import sample_worlds as sample_worlds
    from barn_eval.world_sets import save_worlds as save_worlds
    from barn_eval.world_sets import worlds as worlds
    from barn_planners.interface import Decision as Decision
    from barn_planners.interface import Observation as Observation
    from barn_planners.interface import Planner as Planner
    from barn_planners.interface import Task as Task
    from barn_worlds.base.errors import BarnError as BarnError
    from barn_worlds.base.types import Velocity2D as Velocity2D
    from barn_worlds.robots.files import load_robot as load_robot

_WHERE = {
    "barn_eval.api": ("run", "plan", "load"),
    "barn_eval.results": (
        *("Results", "check", "compare", "leaderboard", "overlay", "report", "replay"),
        "watch",
    ),
    "barn_eval.world_sets": (
        *("datasets", "worlds", "generate_worlds", "sample_worlds", "order_worlds", "save_worlds"),
        *("resize_worlds", "draw", "metrics"),
    ),
    "barn_eval.moving_sets": ("generate_moving",),
    "barn_eval.known_robots": ("robots", "draw_robot"),
    "barn_eval.models": ("difficulty", "train_difficulty", "evaluate_difficulty", "check_difficulty"),
    "barn_eval.suite": ("reproduce", "bench", "validate", "info"),
    "barn_eval.experiments.experiment": ("PlannerChoice",),
    "barn_planners.interface": ("Planner", "Task", "Observation", "Decision"),
    "barn_worlds.robots.files": ("load_robot",),
    "barn_worlds.base.types": ("Velocity2D",),
    "barn_worlds.base.errors": ("BarnError",),
}
_MODULES = {name: module for module, names in _WHERE.items() for name in names}

__all__ = [*_MODULES, "__version__"]  # noqa: PLE0604 (names of attributes, all of them text)


def __getattr__(name: str) -> Any:
    """Return a part of the front door, imported now."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """Return what there is, for completion."""
    return sorted({*globals(), *_MODULES})
