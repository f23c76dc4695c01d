"""Results of experiments: tables, trials, comparisons, figures, replays and reports of what is in their folders."""

from barn_eval.experiments.submission import submit as submit
from barn_eval.experiments.submission import verify as verify
from barn_eval.results.folders import check as check
from barn_eval.results.folders import compare as compare
from barn_eval.results.folders import leaderboard as leaderboard
from barn_eval.results.folders import overlay as overlay
from barn_eval.results.folders import replay as replay
from barn_eval.results.folders import report as report
from barn_eval.results.folders import watch as watch
from barn_eval.results.results import Results as Results
from barn_eval.results.results import load as load
from barn_eval.results.trial import Trial as Trial
