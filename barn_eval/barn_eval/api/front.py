"""The functions and classes at the top of `barn_eval`."""

from barn_eval.api.results import Results, compare, load, replay, report
from barn_eval.api.run import judge, run, sweep
from barn_eval.running.dry_run import DryRun
from barn_eval.running.options import RunKeywords, RunOptions
from barn_eval.running.reporting import Reporter

__all__ = [
    "DryRun",
    "Reporter",
    "Results",
    "RunKeywords",
    "RunOptions",
    "compare",
    "judge",
    "load",
    "replay",
    "report",
    "run",
    "sweep",
]
