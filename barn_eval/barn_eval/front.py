"""What is used most, at the top of `barn_eval`."""

from barn_eval.api import plan, run, sweep
from barn_eval.results import Results, compare, load, replay, report

__all__ = ["Results", "compare", "load", "plan", "replay", "report", "run", "sweep"]
