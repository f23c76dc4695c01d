"""What is used most, at the top of `barn_eval`."""

from barn_eval.api.results import Results, compare, load, replay, report
from barn_eval.api.run import plan, run, sweep

__all__ = ["Results", "compare", "load", "plan", "replay", "report", "run", "sweep"]
