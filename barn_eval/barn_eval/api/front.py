"""What is used most, at the top of `barn_eval`."""

from barn_eval.api.results import Results, compare, load, replay, report
from barn_eval.api.run import run, sweep

__all__ = ["Results", "compare", "load", "replay", "report", "run", "sweep"]
